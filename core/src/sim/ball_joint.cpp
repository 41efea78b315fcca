#include "ball_joint.h"

#include <algorithm>

#include "builder_checks.h"
#include "novaphy/core/error.h"

namespace novaphy::detail {

void check_ball(std::string_view name, const BallJointArgs& args) {
  check_not_negative({name, "damping"}, args.damping);
  check_not_negative({name, "armature"}, args.armature);
  check_not_negative({name, "friction"}, args.friction);
  check_not_negative({name, "target_ke"}, args.target_ke);
  check_not_negative({name, "target_kd"}, args.target_kd);
  check_not_negative({name, "limit_ke"}, args.limit_ke);
  check_not_negative({name, "limit_kd"}, args.limit_kd);
  check_finite({name, "limit_angle"}, args.limit_angle);
  require(args.limit_angle > 0.0f, ErrorKind::Value, name,
          ": limit_angle: expected an angle above 0, got ", args.limit_angle);
}

void set_ball(ModelBuilder& b, const BallJointArgs& args) {
  std::fill_n(b.joint_damping.end() - 3, 3, args.damping);
  std::fill_n(b.joint_armature.end() - 3, 3, args.armature);
  std::fill_n(b.joint_friction.end() - 3, 3, args.friction);
  std::fill_n(b.joint_target_ke.end() - 3, 3, args.target_ke);
  std::fill_n(b.joint_target_kd.end() - 3, 3, args.target_kd);
  std::fill_n(b.joint_limit_ke.end() - 3, 3, args.limit_ke);
  std::fill_n(b.joint_limit_kd.end() - 3, 3, args.limit_kd);
  *(b.joint_limit_upper.end() - 3) = args.limit_angle;
  const Quatf& q = args.target_q;  // a common check of all joints checks the length
  const float target[4] = {q.x, q.y, q.z, q.w};
  std::copy_n(target, 4, b.joint_target_q.end() - 4);
}

}  // namespace novaphy::detail
