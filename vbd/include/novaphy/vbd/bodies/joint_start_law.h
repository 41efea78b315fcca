// A joint at the start of a step: its geometry from the poses of its bodies, and its rows from the
// coefficients of its axis or of the rod. The multipliers and penalty stiffnesses of the rows are
// not set here.
//
// Symbols: as in joint_law.h. Frames: frame k is fixed to body k, with the joint axis as a given
// vector in it.
#pragma once

#include "novaphy/vbd/bodies/joint_law.h"

namespace novaphy::vbd {

constexpr float kHardRow = __builtin_inff();
constexpr float kUnlimited = 1e10f;  // limits of at least this size do not act

// A body of a joint at the start of the step. For the world: the values below.
template <class T>
struct JointSide {
  Transform<T> pose{};
  Vec3<T> com{};  // in the axes of the body
  SpatialVector<T> qd{};
};

// The coefficients of a joint axis. `ke` and `kd` are those of its drive, and 0 without a drive.
template <class T>
struct JointAxis {
  T force{}, ke{}, kd{}, target{}, target_rate{}, effort{};
  T damping{}, armature{}, friction{}, low{}, high{}, limit_ke{}, limit_kd{};
};

template <class T>
struct JointStart {
  VbdBodyJointKind kind = VbdBodyJointKind::Ball;
  JointSide<T> side[2];
  Transform<T> frame[2];
  Vec3<T> axis = {T(0.0f), T(0.0f), T(1.0f)};
  JointAxis<T> of_axis;
  T rod_ke[6] = {}, rod_kd[6] = {};  // ROD
};

template <class T>
void put_row(VbdAxisRowOf<T>& row, const T& stiffness, const T& rest, const T& lower,
             const T& upper) {
  row.stiffness = stiffness;
  row.rest = rest;
  row.lower = lower;
  row.upper = upper;
}

// Returns a joint with its geometry, and with hard rows.
template <class T>
VbdBodyJointOf<T> joint_geometry(const JointStart<T>& start) {
  using namespace math;
  VbdBodyJointOf<T> j;
  j.kind = start.kind;
  Transform<T> frames[2];
  for (int s = 0; s < 2; ++s) {
    const JointSide<T>& side = start.side[s];
    frames[s] = multiply(side.pose, start.frame[s]);
    j.arm[s] = frames[s].p - transform_point(side.pose, side.com);
    j.axis[s] = normalize(rotate(frames[s].q, start.axis));
  }
  j.gap = frames[1].p - frames[0].p;
  j.keep = j.gap * T(kVbdKeptError);
  j.turned = multiply(frames[1].q, conjugate(frames[0].q));
  const T sign(j.turned.w < T(0.0f) ? -2.0f : 2.0f);
  j.keep_turn = j.kind == VbdBodyJointKind::Revolute
                    ? cross(j.axis[0], j.axis[1]) * T(kVbdKeptError)
                    : Vec3<T>{j.turned.x, j.turned.y, j.turned.z} * (sign * T(kVbdKeptError));
  for (VbdJointRowOf<T>& row : j.points) row.stiffness = T(kHardRow);
  for (VbdJointRowOf<T>& row : j.turns) row.stiffness = T(kHardRow);
  if (j.kind == VbdBodyJointKind::Rod)
    j.axis[1] = rotate(frames[0].q, Vec3<T>{T(1.0f), T(0.0f), T(0.0f)});
  return j;
}

inline bool has_coordinate(VbdBodyJointKind kind) {
  return kind == VbdBodyJointKind::Revolute || kind == VbdBodyJointKind::Prismatic;
}

// Returns the angle of a REVOLUTE joint in [-pi, pi], or the displacement of a PRISMATIC joint.
template <class T>
T joint_coordinate(const VbdBodyJointOf<T>& j) {
  using namespace math;
  if (j.kind == VbdBodyJointKind::Prismatic) return dot(j.axis[0], j.gap);
  const Vec3<T> v = {j.turned.x, j.turned.y, j.turned.z};
  return T(2.0f) * atan2(dot(v, j.axis[0]), j.turned.w);
}

// Returns the rate of the joint coordinate at the start of the step (rad/s or m/s).
template <class T>
T joint_rate(const VbdBodyJointOf<T>& j, const JointStart<T>& start) {
  using namespace math;
  const SpatialVector<T>&a = start.side[0].qd, &b = start.side[1].qd;
  if (j.kind == VbdBodyJointKind::Revolute) return dot(j.axis[0], b.angular - a.angular);
  return dot(j.axis[0], (b.linear + cross(b.angular, j.arm[1])) -
                            (a.linear + cross(a.angular, j.arm[0] + j.gap)));
}

// Sets the stiffness and damping of a ROD joint.
template <class T>
void put_rod(const JointStart<T>& start, float h, VbdBodyJointOf<T>& to) {
  const Vec3<T> axes[3] = {to.axis[1], math::cross(to.axis[0], to.axis[1]), to.axis[0]};
  const Vec3<T> errors[2] = {to.gap, log_rotation(to.turned)};
  to.keep = to.keep_turn = {};
  for (int k = 0; k < 6; ++k) {
    VbdJointRowOf<T>& row = k < 3 ? to.points[k] : to.turns[k - 3];
    const T damping = start.rod_kd[k] / T(h);
    row.stiffness = start.rod_ke[k] + damping;
    if (!(damping > T(0.0f))) continue;
    const Vec3<T>& axis = axes[k % 3];
    Vec3<T>& keep = k < 3 ? to.keep : to.keep_turn;
    keep = keep + axis * (math::dot(axis, errors[k / 3]) * (damping / row.stiffness));
  }
}

// Sets the two rows of a DISTANCE joint: the upper limit only pulls (a rope), and the lower limit
// only pushes (a strut).
template <class T>
void put_distance(const JointAxis<T>& a, VbdBodyJointOf<T>& to) {
  using namespace math;
  const T length = math::length(to.gap), zero(0.0f), inf(kHardRow), keep(kVbdKeptError);
  if (a.high < T(kUnlimited))
    put_row(to.rows[0], inf, a.high + keep * max(zero, length - a.high), -inf, zero);
  if (a.low > zero) put_row(to.rows[1], inf, a.low - keep * max(zero, a.low - length), zero, inf);
}

// Sets the row of a drive: a spring and a damper together, bounded by the effort limit.
template <class T>
void put_drive(const JointAxis<T>& a, float h, VbdBodyJointOf<T>& to) {
  to.force = a.force;
  const T k = a.ke + a.kd / T(h);
  if (!(k > T(0.0f))) return;
  put_row(to.rows[0], k,
          (a.ke * a.target + a.kd * (to.coordinate / T(h) + a.target_rate)) / k, -a.effort,
          a.effort);
}

// Sets three rows: damping and armature as one, the nearer limit, and dry friction. A limit has
// damping only if the coordinate is outside of the limit at the start of the step.
template <class T>
void put_resistance(const JointAxis<T>& a, const T& rate, float h, VbdBodyJointOf<T>& to) {
  const T q = to.coordinate, zero(0.0f), inf(kHardRow);
  const T damping = a.damping / T(h), inertia = a.armature / T(h * h), both = damping + inertia;
  if (both > zero) put_row(to.rows[1], both, q + inertia * rate * T(h) / both, -inf, inf);
  const bool near_low = q - a.low < a.high - q;
  const T bound = near_low ? a.low : a.high;
  if (bound < T(kUnlimited) && bound > T(-kUnlimited) && a.limit_ke > zero) {
    const bool is_outside = near_low ? q < a.low : q > a.high;
    const T limit_kd = is_outside ? a.limit_kd / T(h) : zero, k = a.limit_ke + limit_kd;
    put_row(to.rows[2], k, (a.limit_ke * bound + limit_kd * q) / k, near_low ? zero : -inf,
            near_low ? inf : zero);
  }
  if (a.friction > zero) put_row(to.rows[3], inf, q, -a.friction, a.friction);
}

// Sets the rows of the rod or of the joint axis. `to` has its geometry and its coordinate.
template <class T>
void put_rows(const JointStart<T>& start, float h, VbdBodyJointOf<T>& to) {
  if (to.kind == VbdBodyJointKind::Rod) return put_rod(start, h, to);
  if (to.kind == VbdBodyJointKind::Distance) return put_distance(start.of_axis, to);
  if (!has_coordinate(to.kind)) return;
  put_drive(start.of_axis, h, to);
  put_resistance(start.of_axis, joint_rate(to, start), h, to);
}

}  // namespace novaphy::vbd
