// The rows along the axis of a joint: drive, damping, armature, limit and dry friction.
#include <algorithm>
#include <cmath>
#include <limits>

#include "bodies_side.h"

namespace novaphy::vbd {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kUnlimited = 1e10f;

}  // namespace

// Sets the rows along the joint axis, or the limits of a DISTANCE joint.
void Bodies::put_axis(size_t joint, const SimState& in, const Control* control, VbdBodyJoint& to) {
  const auto dof = static_cast<size_t>(model_.joint_qd_start.data()[joint]);
  if (to.kind == VbdBodyJointKind::Distance) return put_distance(dof, to);
  if (to.kind != VbdBodyJointKind::Revolute && to.kind != VbdBodyJointKind::Prismatic) return;
  to.coordinate = joint_coordinate(joint, to);
  put_drive(dof, static_cast<size_t>(model_.joint_q_start.data()[joint]), control, to);
  put_resistance(dof, joint_rate(in, to), to);
}

// Sets the two rows of a DISTANCE joint: the upper limit only pulls (a rope), and the lower limit
// only pushes (a strut).
void Bodies::put_distance(size_t dof, VbdBodyJoint& to) const {
  const float low = model_.joint_limit_lower.data()[dof];
  const float high = model_.joint_limit_upper.data()[dof], length = math::length(to.gap);
  if (high < kUnlimited)
    put_row(to.rows[0], kInf, high + kVbdKeptError * std::max(0.0f, length - high), -kInf, 0.0f);
  if (low > 0.0f)
    put_row(to.rows[1], kInf, low - kVbdKeptError * std::max(0.0f, low - length), 0.0f, kInf);
}

// Sets three rows: damping and armature as one, the nearer limit, and dry friction. A limit has
// damping only if the coordinate is outside of the limit at the start of the step.
void Bodies::put_resistance(size_t dof, float rate, VbdBodyJoint& to) const {
  const Model& m = model_;
  const float h = dt_, q = to.coordinate;
  const float low = m.joint_limit_lower.data()[dof], high = m.joint_limit_upper.data()[dof];
  const float damping = m.joint_damping.data()[dof] / h;
  const float inertia = m.joint_armature.data()[dof] / (h * h);
  if (damping + inertia > 0.0f)
    put_row(to.rows[1], damping + inertia, q + inertia * rate * h / (damping + inertia), -kInf,
            kInf);
  const bool near_low = q - low < high - q;
  const float bound = near_low ? low : high, limit_ke = m.joint_limit_ke.data()[dof];
  if (std::abs(bound) < kUnlimited && limit_ke > 0.0f) {
    const bool is_outside = near_low ? q < low : q > high;
    const float limit_kd = is_outside ? m.joint_limit_kd.data()[dof] / h : 0.0f;
    put_row(to.rows[2], limit_ke + limit_kd,
            (limit_ke * bound + limit_kd * q) / (limit_ke + limit_kd), near_low ? 0.0f : -kInf,
            near_low ? kInf : 0.0f);
  }
  if (const float friction = m.joint_friction.data()[dof]; friction > 0.0f)
    put_row(to.rows[3], kInf, q, -friction, friction);
}

}  // namespace novaphy::vbd
