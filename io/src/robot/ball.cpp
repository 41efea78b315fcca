// Sets the properties of the BALL and FREE joints of a Robot.
#include <algorithm>

#include "robot.h"

namespace novaphy::detail {

void set_ball(const RobotJoint& joint, ModelBuilder& builder) {
  if (joint.type != JointType::BALL && joint.type != JointType::FREE) return;
  const ptrdiff_t dofs = joint.type == JointType::BALL ? 3 : 6;
  const auto set = [&](std::vector<float>& list, double value) {
    std::fill_n(list.end() - dofs, dofs, static_cast<float>(value));
  };
  set(builder.joint_damping, joint.damping);
  set(builder.joint_armature, joint.armature);
  set(builder.joint_friction, joint.friction);
  if (joint.type == JointType::FREE) return;
  set(builder.joint_target_ke, joint.stiffness);
  const float rest[] = {static_cast<float>(joint.rest.x), static_cast<float>(joint.rest.y),
                        static_cast<float>(joint.rest.z), static_cast<float>(joint.rest.w)};
  std::copy_n(rest, 4, builder.joint_target_q.end() - 4);
  if (joint.limit_angle == 0.0) return;
  set(builder.joint_limit_ke, double{builder.default_joint_cfg.limit_ke});
  set(builder.joint_limit_kd, double{builder.default_joint_cfg.limit_kd});
  *(builder.joint_limit_upper.end() - dofs) = static_cast<float>(joint.limit_angle);
}

}  // namespace novaphy::detail
