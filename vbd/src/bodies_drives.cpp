// The drives of joint axes (JointTargetMode).
#include "bodies.h"

namespace novaphy::vbd {

void put_drive_of(const Model& m, const Control* control, size_t dof, size_t coordinate,
                  JointAxis<float>& to) {
  const DriveUse use = drive_use(m, dof);
  to.force = (control ? control->joint_f : m.joint_f).data()[dof];
  if (use.spring) to.ke = m.joint_target_ke.data()[dof];
  if (use.spring || use.rate) to.kd = m.joint_target_kd.data()[dof];
  to.target = (control ? control->joint_target_q : m.joint_target_q).data()[coordinate];
  if (use.rate)
    to.target_rate = (control ? control->joint_target_qd : m.joint_target_qd).data()[dof];
  to.effort = m.joint_effort_limit.data()[dof];
}

DriveUse drive_use(const Model& m, size_t dof) {
  const auto mode = static_cast<JointTargetMode>(m.joint_target_mode.data()[dof]);
  const bool both = mode == JointTargetMode::POSITION_VELOCITY;
  return {.spring = both || mode == JointTargetMode::POSITION,
          .rate = both || mode == JointTargetMode::VELOCITY};
}

}  // namespace novaphy::vbd
