// The laws of bodies and joints with dual numbers, at the solution of a step. A direction sets the
// tangents of the inputs.
#pragma once

#include "bodies.h"
#include "bodies_solution.h"
#include "novaphy/math/dual.h"

namespace novaphy::vbd {

using DualFloat = math::Dual<float>;
using DualMotion = VbdBodyMotionOf<DualFloat>;

inline Vec3<DualFloat> dual(const Vec3f& v) {
  return {DualFloat(v.x), DualFloat(v.y), DualFloat(v.z)};
}
inline Quat<DualFloat> dual(const Quatf& q) {
  return {DualFloat(q.x), DualFloat(q.y), DualFloat(q.z), DualFloat(q.w)};
}
inline Transform<DualFloat> dual(const Transformf& t) { return {dual(t.p), dual(t.q)}; }
inline SpatialVector<DualFloat> dual(const SpatialVectorf& v) {
  return {dual(v.linear), dual(v.angular)};
}
inline DualMotion dual(const VbdBodyMotion& m) {
  DualMotion to;
  to.moved = dual(m.moved);
  to.turned = dual(m.turned);
  return to;
}
inline DualFloat& part(Vec3<DualFloat>& v, int k) { return k == 0 ? v.x : k == 1 ? v.y : v.z; }

// Sets the tangent of a rotation about the world axis k (1 rad).
inline void turn_about(Quat<DualFloat>& q, int k) {
  const Quatf axis = {k == 0 ? 0.5f : 0.0f, k == 1 ? 0.5f : 0.0f, k == 2 ? 0.5f : 0.0f, 0.0f};
  const Quatf d = math::multiply(axis, Quatf{q.x.v, q.y.v, q.z.v, q.w.v});
  q.x.d = d.x;
  q.y.d = d.y;
  q.z.d = d.z;
  q.w.d = d.w;
}

// A body of a step. The result is the force and the moment of inertia.
struct DualBody {
  BodyStart<DualFloat> start;
  DualMotion motion;
};
inline SpatialVector<DualFloat> force_on(const DualBody& b, float h) {
  return inertia_force(inertial_target(b.start, h), b.motion);
}

// A row of a joint: a row of points, of rotations, or along the axis.
enum class RowKind { Point, Turn, Axis };
struct ActiveRow {
  RowKind kind = RowKind::Point;
  int index = 0;
};
constexpr int kMostRows = 6 + kVbdAxisRows;

// A joint of a step, with the multipliers of the rows that act. A row at a bound has the force of
// this bound.
struct DualJoint {
  JointStart<DualFloat> start;
  DualMotion motion[2];
  ActiveRow rows[kMostRows];
  DualFloat lam[kMostRows];
  int count = 0;
  int at_bound[kVbdAxisRows] = {};  // -1: at the lower bound, 1: at the upper bound
  float whole_turns = 0.0f;         // rad: the coordinate without the angle in [-pi, pi]
};

struct DualValues {
  SpatialVector<DualFloat> on[2];    // force and moment on each body
  DualFloat error[kMostRows] = {};  // C - lam/K of each row
};

inline DualValues values_of(const DualJoint& s, float h) {
  VbdBodyJointOf<DualFloat> j = joint_geometry(s.start);
  if (has_coordinate(j.kind)) j.coordinate = joint_coordinate(j) + DualFloat(s.whole_turns);
  put_rows(s.start, h, j);
  DualMotion motion[2] = {s.motion[0], s.motion[1]};
  for (DualMotion& m : motion) m.turn = log_rotation(m.turned);
  const JointErrorsOf<DualFloat> e = joint_errors(j, motion[0], motion[1]);
  DualValues to;
  JointRowForces<DualFloat> forces;
  forces.axis = j.force;
  for (int r = 0; r < kVbdAxisRows; ++r)
    if (s.at_bound[r] != 0)
      forces.axis = forces.axis + (s.at_bound[r] > 0 ? j.rows[r].upper : j.rows[r].lower);
  for (int k = 0; k < s.count; ++k) {
    const int r = s.rows[k].index;
    switch (s.rows[k].kind) {
      case RowKind::Point:
        forces.points[r] = s.lam[k];
        to.error[k] = math::dot(e.along.t[r], e.point) - s.lam[k] / j.points[r].stiffness;
        break;
      case RowKind::Turn:
        forces.turns[r] = s.lam[k];
        to.error[k] = math::dot(e.along.t[r], e.turn) - s.lam[k] / j.turns[r].stiffness;
        break;
      case RowKind::Axis:
        forces.axis = forces.axis + s.lam[k];
        to.error[k] = (j.rows[r].rest - e.coordinate) - s.lam[k] / j.rows[r].stiffness;
        break;
    }
  }
  const SpatialVector<DualFloat> wrench = joint_wrench(j, e, forces);
  for (int side = 0; side < 2; ++side) to.on[side] = wrench_on(wrench, e.arm[side], side);
  return to;
}

inline Transform<DualFloat>& start_pose(DualJoint& s, int side) { return s.start.side[side].pose; }

// A contact that pushes at the solution. Rows: the depth, and two of slip if the contact sticks.
struct DualContact {
  ContactStart<DualFloat> start;
  DualMotion motion[2];
  DualFloat lam[kMostRows];
  int count = 0;              // 1, or 3 if the contact sticks
  bool is_plane[2] = {};      // an endless plane of the world whose point follows the other one
  float ignored = 0.0f;       // m, see VbdBodyContact
  Vec3f slides{};             // direction of the friction on B of a contact that slips; else 0
  float least_slip = 0.0f;    // m: below it, the direction of friction turns as at this slip
};

inline Transform<DualFloat>& start_pose(DualContact& s, int side) { return s.start.pose[side]; }

// Returns the direction of friction, which turns with the slip.
inline Vec3<DualFloat> friction_direction(const DualContact& s, const Vec3<DualFloat>& slip) {
  const Vec3f d = s.slides, by = math::tangent_of(slip);
  const float size = math::max(math::length(math::value_of(slip)), s.least_slip);
  return math::with_tangent(d, (by - d * math::dot(d, by)) * (-1.0f / size));
}

inline DualValues values_of(const DualContact& s, float h) {
  VbdBodyContactOf<DualFloat> c;
  Vec3<DualFloat> points[2];
  for (int k = 0; k < 2; ++k) points[k] = math::transform_point(s.start.pose[k], s.start.point[k]);
  const Vec3f n = math::value_of(s.start.normal);
  for (int k = 0; k < 2; ++k) {
    if (!s.is_plane[k]) continue;
    const Vec3f by = math::tangent_of(points[1 - k]);
    points[k] = math::with_tangent(math::value_of(points[k]), by - n * math::dot(n, by));
  }
  start_contact(s.start, points, h, c);
  c.gap = c.gap + DualFloat(s.ignored);
  DualMotion motion[2] = {s.motion[0], s.motion[1]};
  for (DualMotion& m : motion) m.turn = log_rotation(m.turned);
  const DualFloat depth = contact_depth(c, motion[0], motion[1]);
  const DualFloat normal = s.lam[0] + contact_damping(c, depth) * (depth + c.gap);
  const Vec3<DualFloat> slip = contact_slip(c, motion[0], motion[1]);
  DualValues to;
  to.error[0] = depth - s.lam[0] / c.stiffness;
  Vec3<DualFloat> force = c.normal * normal;
  const PerpendicularOf<DualFloat> across = perpendicular(c.normal);
  for (int k = 1; k < s.count; ++k) {
    force = force + across.t[k - 1] * s.lam[k];
    to.error[k] = -math::dot(across.t[k - 1], slip);
  }
  if (math::dot(s.slides, s.slides) > 0.0f)
    force = force + friction_direction(s, slip) * (c.mu * normal);
  for (int side = 0; side < 2; ++side) to.on[side] = wrench_on({force, {}}, c.arm[side], side);
  return to;
}

}  // namespace novaphy::vbd
