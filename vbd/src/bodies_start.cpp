// The joints of a model as the law of joint_start_law.h reads them.
#include "bodies.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy::vbd {
namespace {

VbdBodyJointKind kind_of(JointType type) {
  switch (type) {
    case JointType::FIXED:
      return VbdBodyJointKind::Fixed;
    case JointType::REVOLUTE:
      return VbdBodyJointKind::Revolute;
    case JointType::PRISMATIC:
      return VbdBodyJointKind::Prismatic;
    case JointType::DISTANCE:
      return VbdBodyJointKind::Distance;
    case JointType::ROD:
      return VbdBodyJointKind::Rod;
    default:
      return VbdBodyJointKind::Ball;
  }
}

// Reads the coefficients of the axis `dof`, whose position is at `coordinate`.
JointAxis<float> axis_of(const Model& m, const Control* control, size_t dof, size_t coordinate) {
  JointAxis<float> a;
  put_drive_of(m, control, dof, coordinate, a);
  a.damping = m.joint_damping.data()[dof];
  a.armature = m.joint_armature.data()[dof];
  a.friction = m.joint_friction.data()[dof];
  a.low = m.joint_limit_lower.data()[dof];
  a.high = m.joint_limit_upper.data()[dof];
  a.limit_ke = m.joint_limit_ke.data()[dof];
  a.limit_kd = m.joint_limit_kd.data()[dof];
  return a;
}

}  // namespace

JointStart<float> joint_start(const Model& m, const Transformf* q, const SpatialVectorf* qd,
                              const Control* control, size_t joint) {
  const auto type = static_cast<JointType>(m.joint_type.data()[joint]);
  const auto dof = static_cast<size_t>(m.joint_qd_start.data()[joint]);
  JointStart<float> start;
  start.kind = kind_of(type);
  const int32_t bodies[2] = {m.joint_parent.data()[joint], m.joint_child.data()[joint]};
  for (int s = 0; s < 2; ++s)
    if (const int32_t body = bodies[s]; body >= 0)
      start.side[s] = {q[body], m.body_com.data()[body], qd[body]};
  start.frame[0] = m.joint_X_p.data()[joint];
  start.frame[1] = m.joint_X_c.data()[joint];
  if (has_axes(type)) start.axis = m.joint_axis.data()[dof];
  if (start.kind == VbdBodyJointKind::Rod) {
    for (size_t k = 0; k < 6; ++k) {
      start.rod_ke[k] = m.joint_target_ke.data()[dof + k];
      start.rod_kd[k] = m.joint_target_kd.data()[dof + k];
    }
  } else if (start.kind == VbdBodyJointKind::Distance) {
    start.of_axis.low = m.joint_limit_lower.data()[dof];
    start.of_axis.high = m.joint_limit_upper.data()[dof];
  } else if (has_coordinate(start.kind)) {
    start.of_axis =
        axis_of(m, control, dof, static_cast<size_t>(m.joint_q_start.data()[joint]));
  }
  return start;
}

}  // namespace novaphy::vbd
