// The law of a joint between two rigid bodies in VBD, by an augmented Lagrangian: hard constraints
// of points and rotations, and compliant rows along or about the joint axis.
//
//   points      raw = (x + r)_B - (x + r)_A,  C = raw - keep;  PRISMATIC: without the axis
//   rotations   REVOLUTE: a_A x a_B - keep_turn;  FIXED, PRISMATIC: 2 vec(R_B E R_A^-1) - keep_turn
//   force on B  -(rho C + lam) at the anchor of B; A gets the opposite force at the same point
//   axis        clamp(k (rest - q) + s lam, lo, hi)
//   ROD         -(k C_i + s lam_i) along each axis t_i of the joint frame of A, which turns with A:
//               C = raw - keep, and for rotations C = th - keep_turn with th = log(R_B E R_A^-1).
//               The moment of the force m along th is J_l(th)^-T m: the gradient of the energy
//               K_i C_i^2/2 is exact. A damper d in parallel to a spring k_i: K_i = k_i + d/h, and
//               keep is the part (d/h)/K_i of the error at the start.
// Symbols:
//   x, R        center of mass (m) and rotation since the start of the step, of a body
//   r           levers of the anchors (m), which rotate with their bodies
//   keep, keep_turn   part kVbdKeptError of the error at the start, which the step does not correct
//   a_A, a_B    the joint axis as a vector fixed to A and to B; ROD: z and x of the frame of A
//   E           rotation from the joint frame of A to that of B at the start
//   q           REVOLUTE: angle (rad). PRISMATIC: displacement (m). DISTANCE: distance of the
//               anchors (m).
//   rest        the value of q without force; lo, hi: bounds of the force
//   K, rho      stiffness of a row; penalty stiffness of the iteration, for each hard row
//   s, k        K/(K + rho) and s rho; for K = infinity (no compliance): 1 and rho
//   lam         multipliers: lam <- lam + rho C; of the axis: s (lam + rho (rest - q)), clamped
// The angle of a REVOLUTE joint is the angle at the start plus the difference of the bodies'
// rotation vectors along the axis. This sum is exact to first order in rotations about other axes.
// DISTANCE has rows along the line between the anchors.
// Sources: Giles et al. 2025, with the geometric stiffness of its section 3.5.
// Kinks: q where the force meets lo or hi; anchors of a DISTANCE joint that coincide; a ROD joint
// that is bent by pi.
#pragma once

#include "novaphy/vbd/bodies/body_law.h"

namespace novaphy {

constexpr float kVbdKeptError = 0.95f;
constexpr int kVbdAxisRows = 4;  // drive, damping, limit, dry friction

enum class VbdBodyJointKind : int32_t { Ball, Fixed, Revolute, Prismatic, Distance, Rod };

// A compliant row along or about the joint axis. The row does not act if stiffness is 0.
template <class T>
struct VbdAxisRowOf {
  T stiffness{}, rest{}, lower{}, upper{}, lam{};
  float rho = 0.0f;
};
using VbdAxisRow = VbdAxisRowOf<float>;

// The stiffness of a row (infinity: hard) and its penalty stiffness.
template <class T>
struct VbdJointRowOf {
  T stiffness{};
  float rho = 0.0f;
};
using VbdJointRow = VbdJointRowOf<float>;

template <class T>
struct alignas(16) VbdBodyJointOf {
  using Element = Vec4f;
  int32_t body[2] = {-1, -1};
  VbdBodyJointKind kind = VbdBodyJointKind::Ball;
  T force{};  // given force along the axis (N), or moment about it (N m)
  Vec3<T> arm[2] = {}, gap{}, keep{}, axis[2] = {}, keep_turn{};
  Quat<T> turned = Quat<T>::identity();
  Vec3<T> lam{}, lam_turn{};
  VbdJointRowOf<T> points[3] = {}, turns[3] = {};
  T coordinate{};
  VbdAxisRowOf<T> rows[kVbdAxisRows] = {};
  float in_trees = 1.0f;  // scales the stiffness in the blocks of trees (bodies_kernels.h)
};
using VbdBodyJoint = VbdBodyJointOf<float>;

namespace vbd {

struct JointRow {
  float k = 0.0f;
  Vec3f linear{}, angular[2] = {};
};
struct JointForce {
  Vec3f force{}, moment{}, arm[2] = {};
  JointRow rows[6 + kVbdAxisRows];
  int count = 0;
};

template <class T>
Vec3<T> turned_by(const Quat<T>& q, const Vec3<T>& v) {
  return v + rotate_change(q, v);
}

// The constraint errors and the coordinate of a joint, for given motions of its bodies.
template <class T>
struct JointErrorsOf {
  Vec3<T> arm[2], axis, raw, point, turn;
  T coordinate{};
  Quat<T> off = Quat<T>::identity();  // R_B E R_A^-1
  Vec3<T> th{};                       // ROD: log(off)
  PerpendicularOf<T> along;           // the directions of the rows of points and rotations
};
using JointErrors = JointErrorsOf<float>;

template <class T>
JointErrorsOf<T> joint_errors(const VbdBodyJointOf<T>& j, const VbdBodyMotionOf<T>& a,
                              const VbdBodyMotionOf<T>& b) {
  JointErrorsOf<T> e;
  const Vec3<T> change[2] = {rotate_change(a.turned, j.arm[0]), rotate_change(b.turned, j.arm[1])};
  e.raw = j.gap + ((b.moved + change[1]) - (a.moved + change[0]));
  e.arm[1] = j.arm[1] + change[1];
  e.arm[0] = (j.arm[0] + change[0]) + e.raw;  // from the center of A to the anchor of B
  e.axis = turned_by(a.turned, j.axis[0]);
  const bool is_rod = j.kind == VbdBodyJointKind::Rod;
  e.point = e.raw - (is_rod ? turned_by(a.turned, j.keep) : j.keep);
  if (j.kind == VbdBodyJointKind::Revolute) {
    e.turn = math::cross(e.axis, turned_by(b.turned, j.axis[1])) - j.keep_turn;
    e.coordinate = j.coordinate + math::dot(j.axis[0], b.turn - a.turn);
  } else if (j.kind == VbdBodyJointKind::Distance) {
    e.coordinate = math::length(e.raw);
    e.axis = math::normalize(e.raw);
  } else if (j.kind != VbdBodyJointKind::Ball) {
    e.off = math::multiply(math::multiply(b.turned, j.turned), math::conjugate(a.turned));
    const T sign(e.off.w < T(0.0f) ? -2.0f : 2.0f);
    if (is_rod) e.th = log_rotation(e.off);
    e.turn = is_rod ? e.th - turned_by(a.turned, j.keep_turn)
                    : Vec3<T>{e.off.x, e.off.y, e.off.z} * sign - j.keep_turn;
    e.coordinate = math::dot(e.axis, e.raw);
  }
  if (is_rod) {
    const Vec3<T> x = turned_by(a.turned, j.axis[1]);
    e.along = {{x, math::cross(e.axis, x), e.axis}};
  } else {
    e.along = perpendicular(e.axis);
  }
  return e;
}

// Returns the moment on B of the force m along the error of the rotation.
template <class T>
Vec3<T> joint_moment(const VbdBodyJointOf<T>& j, const JointErrorsOf<T>& e, const Vec3<T>& m) {
  return j.kind == VbdBodyJointKind::Rod ? inverse_left_jacobian_transposed(e.off, e.th, m) : m;
}

// Return the number of hard rows: point_rows for points, turn_rows for rotations. The rows act
// along the first vectors of Perpendicular.
inline int point_rows(VbdBodyJointKind kind) {
  return kind == VbdBodyJointKind::Distance ? 0 : kind == VbdBodyJointKind::Prismatic ? 2 : 3;
}
inline int turn_rows(VbdBodyJointKind kind) {
  return kind == VbdBodyJointKind::Revolute                                     ? 2
         : kind == VbdBodyJointKind::Ball || kind == VbdBodyJointKind::Distance ? 0
                                                                                : 3;
}

template <class Row>
float softness(const Row& row) {
  return row.stiffness - row.stiffness == 0.0f ? row.stiffness / (row.stiffness + row.rho) : 1.0f;
}

// Returns the force of a row along t for the error C, with the sign of C, and its stiffness k.
inline float row_force(const VbdJointRow& row, const Vec3f& t, const Vec3f& error,
                       const Vec3f& lam) {
  return softness(row) * math::dot(t, error * row.rho + lam);
}

// The forces of the rows, with the signs of their errors, and the force along the axis.
template <class T>
struct JointRowForces {
  T points[3] = {}, turns[3] = {}, axis{};
};

// Returns the force and the moment on B, at the anchor of B.
template <class T>
SpatialVector<T> joint_wrench(const VbdBodyJointOf<T>& j, const JointErrorsOf<T>& e,
                              const JointRowForces<T>& rows) {
  SpatialVector<T> f;
  for (int k = 0; k < point_rows(j.kind); ++k) f.linear = f.linear - e.along.t[k] * rows.points[k];
  for (int k = 0; k < turn_rows(j.kind); ++k)
    f.angular = f.angular - joint_moment(j, e, e.along.t[k]) * rows.turns[k];
  Vec3<T>& along = j.kind == VbdBodyJointKind::Revolute ? f.angular : f.linear;
  along = along + e.axis * rows.axis;
  return f;
}

// Returns the force and the moment of a joint about the center of body A (side 0) or B (side 1).
template <class T>
SpatialVector<T> wrench_on(const SpatialVector<T>& of_joint, const Vec3<T>& arm, int side) {
  const T sign(side == 0 ? -1.0f : 1.0f);
  const Vec3<T> force = of_joint.linear * sign;
  return {force, math::cross(arm, force) + of_joint.angular * sign};
}

inline JointForce joint_force(const VbdBodyJoint& j, const VbdBodyMotion& a,
                              const VbdBodyMotion& b) {
  using namespace math;
  JointForce f;
  JointRowForces<float> of;
  const JointErrors e = joint_errors(j, a, b);
  for (int side = 0; side < 2; ++side) f.arm[side] = e.arm[side];
  for (int k = 0; k < point_rows(j.kind); ++k) {
    const VbdJointRow& row = j.points[k];
    const Vec3f& t = e.along.t[k];
    of.points[k] = row_force(row, t, e.point, j.lam);
    f.rows[f.count++] = {softness(row) * row.rho, t, {cross(e.arm[0], t), cross(e.arm[1], t)}};
  }
  for (int k = 0; k < turn_rows(j.kind); ++k) {
    const VbdJointRow& row = j.turns[k];
    const Vec3f t = joint_moment(j, e, e.along.t[k]);
    of.turns[k] = row_force(row, e.along.t[k], e.turn, j.lam_turn);
    f.rows[f.count++] = {softness(row) * row.rho, {}, {t, t}};
  }
  const bool turns = j.kind == VbdBodyJointKind::Revolute;
  of.axis = j.force;
  for (const VbdAxisRow& row : j.rows) {
    if (row.stiffness == 0.0f) continue;
    const float s = softness(row), k = s * row.rho;
    const float wants = k * (row.rest - e.coordinate) + s * row.lam;
    of.axis = of.axis + min(max(wants, row.lower), row.upper);
    if (!(wants > row.lower && wants < row.upper)) continue;
    f.rows[f.count++] =
        turns ? JointRow{k, {}, {e.axis, e.axis}}
              : JointRow{k, e.axis, {cross(e.arm[0], e.axis), cross(e.arm[1], e.axis)}};
  }
  const SpatialVectorf wrench = joint_wrench(j, e, of);
  f.force = wrench.linear;
  f.moment = wrench.angular;
  return f;
}

// Updates the multipliers after an iteration.
inline void update_joint(VbdBodyJoint& j, const VbdBodyMotion& a, const VbdBodyMotion& b) {
  using namespace math;
  const JointErrors e = joint_errors(j, a, b);
  Vec3f lam{}, turn{};
  for (int k = 0; k < point_rows(j.kind); ++k)
    lam = lam + e.along.t[k] * row_force(j.points[k], e.along.t[k], e.point, j.lam);
  for (int k = 0; k < turn_rows(j.kind); ++k)
    turn = turn + e.along.t[k] * row_force(j.turns[k], e.along.t[k], e.turn, j.lam_turn);
  j.lam = lam;
  j.lam_turn = turn;
  for (VbdAxisRow& row : j.rows) {
    if (row.stiffness == 0.0f) continue;
    const float s = softness(row);
    row.lam = min(max(s * (row.lam + row.rho * (row.rest - e.coordinate)), row.lower), row.upper);
  }
}

// Adds the force of a joint to the block of body A (side 0) or B (side 1). Calls row(k, linear,
// angular, angular of the other body) for each rank-1 term of the stiffness.
template <bool with_stiffness, class Row>
void add_joint(BodyBlock& block, const VbdBodyJoint& j, int side, const VbdBodyMotion& a,
               const VbdBodyMotion& b, const Row& row) {
  using namespace math;
  const JointForce f = joint_force(j, a, b);
  const SpatialVectorf wrench = wrench_on({f.force, f.moment}, f.arm[side], side);
  const Vec3f force = wrench.linear, arm = f.arm[side];
  add_force(block, force, wrench.angular);
  if (!with_stiffness) return;
  for (int k = 0; k < f.count; ++k)
    row(f.rows[k].k, f.rows[k].linear, f.rows[k].angular[side], f.rows[k].angular[1 - side]);
  // Adds the column norms of the geometric stiffness sym(f r^T) - (f . r) 1 to the diagonal. This
  // stiffness exists because the lever r rotates with the body.
  const float along = dot(force, arm);
  const float fs[3] = {force.x, force.y, force.z}, rs[3] = {arm.x, arm.y, arm.z};
  for (int c = 0; c < 3; ++c) {
    float square = 0.0f;
    for (int r = 0; r < 3; ++r) {
      const float g = 0.5f * (fs[r] * rs[c] + rs[r] * fs[c]) - (r == c ? along : 0.0f);
      square = square + g * g;
    }
    block.h[3 + c][3 + c] = block.h[3 + c][3 + c] + sqrt(square);
  }
}

}  // namespace vbd
}  // namespace novaphy
