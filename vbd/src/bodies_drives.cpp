// The drives of joint axes (JointTargetMode).
#include "bodies_side.h"

namespace novaphy::vbd {

// Sets the row of a drive: a spring and a damper together, bounded by the effort limit.
void Bodies::put_drive(size_t dof, size_t coordinate, const Control* control,
                       VbdBodyJoint& to) const {
  const Model& m = model_;
  to.force = (control ? control->joint_f : m.joint_f).data()[dof];
  const auto mode = static_cast<JointTargetMode>(m.joint_target_mode.data()[dof]);
  const bool has_rate =
      mode == JointTargetMode::VELOCITY || mode == JointTargetMode::POSITION_VELOCITY;
  const bool has_spring =
      mode == JointTargetMode::POSITION || mode == JointTargetMode::POSITION_VELOCITY;
  const float ke = has_spring ? m.joint_target_ke.data()[dof] : 0.0f;
  const float kd = has_spring || has_rate ? m.joint_target_kd.data()[dof] : 0.0f;
  const float k = ke + kd / dt_;
  if (!(k > 0.0f)) return;
  const float target = (control ? control->joint_target_q : m.joint_target_q).data()[coordinate];
  const float rate =
      has_rate ? (control ? control->joint_target_qd : m.joint_target_qd).data()[dof] : 0.0f;
  const float limit = m.joint_effort_limit.data()[dof];
  put_row(to.rows[0], k, (ke * target + kd * (to.coordinate / dt_ + rate)) / k, -limit, limit);
}

}  // namespace novaphy::vbd
