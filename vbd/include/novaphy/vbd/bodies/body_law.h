// The law of one rigid body in a step of VBD: the inertial energy T, its force and 6x6 stiffness,
// and the update of the pose.
//
//   T(u, q) = m/(2 h^2) |u - u*|^2 + 1/(2 h^2) th . I* th,   th = log(q q*^-1)
// Symbols:
//   u, q     displacement of the center of mass (m) and rotation since the start, world frame
//   u*, q*   u and q at the inertial target, which the body reaches without contacts and joints:
//            u* = h v + h^2 (g + f/m), q* = exp(h w')
//   h        step size (s), m the mass (kg), f the external force (N)
//   w'       angular velocity at the target (rad/s, body axes), by the midpoint rule with the
//            moment t (N m): I (w' - w) + h wm x I wm = h t, wm = (w + w')/2. If t = 0, the rule
//            keeps |I w| and the kinetic energy.
//   I*       inertia in world axes at the target (kg m^2)
// The gradient of T with respect to a world increment dw of the rotation is J_l(th)^-T I* th/h^2,
// with the left Jacobian J_l of SO(3). This gradient is exact. The stiffness is I*/h^2, its value
// at th = 0.
//
// Sources: Chen et al. 2024, Vertex Block Descent; Giles et al. 2025, Augmented VBD.
// Kink: a rotation th by pi, where log takes the shorter way.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/ldlt.h"
#include "novaphy/math/matrix.h"

namespace novaphy {

// The motion of a body since the start of the step.
struct alignas(16) VbdBodyMotion {
  using Element = Vec4f;
  Vec3f moved{};  // displacement of the center of mass (m)
  float unused = 0.0f;
  Quatf turned = Quatf::identity();
  Vec3f turn{};  // the rotation vector of `turned` (rad)
  float unused2 = 0.0f;
};

// The inertial target of a body in a step, and its inertia. mass_by_h2 (kg/s^2) is 0 for a
// kinematic body.
struct alignas(16) VbdBody {
  using Element = Vec4f;
  Vec3f target{};
  float mass_by_h2 = 0.0f;
  Quatf target_turned = Quatf::identity();
  float xx = 0.0f, yy = 0.0f, zz = 0.0f, xy = 0.0f, xz = 0.0f, yz = 0.0f;  // I*/h^2
  float unused = 0.0f, unused2 = 0.0f;
};

namespace vbd {

// Returns the unit quaternion of the rotation vector w (rad).
inline Quatf exp_rotation(const Vec3f& w) {
  const float angle = math::length(w), half = 0.5f * angle;
  const float s = angle > 1e-4f ? math::sin(half) / angle : 0.5f - angle * angle / 48.0f;
  return {w.x * s, w.y * s, w.z * s, math::cos(half)};
}

// Returns the rotation vector (rad) of a unit quaternion. Its length is at most pi.
inline Vec3f log_rotation(const Quatf& q) {
  const float sign = q.w < 0.0f ? -1.0f : 1.0f;
  const Vec3f v = Vec3f{q.x, q.y, q.z} * sign;
  const float s = math::length(v), w = q.w * sign;
  const float factor = s > 1e-4f ? 2.0f * math::atan2(s, w) / s : 2.0f / w;
  return v * factor;
}

inline Quatf unit(const Quatf& q) {
  const float s = 1.0f / math::sqrt(((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w);
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}

struct Perpendicular {
  Vec3f t[3];  // t[0], t[1]: unit vectors perpendicular to each other and to the unit vector t[2]
};
inline Perpendicular perpendicular(const Vec3f& axis) {
  const Vec3f other = math::abs(axis.x) < 0.6f ? Vec3f{1.0f, 0.0f, 0.0f} : Vec3f{0.0f, 1.0f, 0.0f};
  const Vec3f u = math::normalize(math::cross(axis, other));
  return {{u, math::cross(axis, u), axis}};
}

// Returns rotate(q, r) - r, without the cancellation for small rotations.
inline Vec3f rotate_change(const Quatf& q, const Vec3f& r) {
  const Vec3f v = {q.x, q.y, q.z}, c = math::cross(v, r);
  return (c * q.w + math::cross(v, c)) * 2.0f;
}

// Returns J_l(th)^-T v for th = log(q), with the left Jacobian J_l of SO(3).
inline Vec3f inverse_left_jacobian_transposed(const Quatf& q, const Vec3f& th, const Vec3f& v) {
  const float square = math::dot(th, th);
  float c = 1.0f / 12.0f + square / 720.0f;
  if (square > 0.04f) {
    const float s = math::length(Vec3f{q.x, q.y, q.z});
    c = (1.0f - 0.5f * math::sqrt(square) * math::abs(q.w) / s) / square;
  }
  const Vec3f once = math::cross(th, v);
  return v + once * 0.5f + math::cross(th, once) * c;
}

// Returns the angular velocity after the time h (rad/s, body axes), by three Newton iterations of
// the midpoint rule. `moment` is in body axes (N m).
inline Vec3f turn_freely(const Mat33f& inertia, const Vec3f& w, const Vec3f& moment, float h) {
  using namespace math;
  Vec3f next = w;
  for (int k = 0; k < 3; ++k) {
    const Vec3f mid = (w + next) * 0.5f, momentum = multiply(inertia, mid);
    const Vec3f rest = multiply(inertia, next - w) + (cross(mid, momentum) - moment) * h;
    Mat33f jacobian;
    for (int j = 0; j < 3; ++j) {
      const Vec3f e = {j == 0 ? 1.0f : 0.0f, j == 1 ? 1.0f : 0.0f, j == 2 ? 1.0f : 0.0f};
      const Vec3f of = multiply(inertia, e);
      const Vec3f column = of + (cross(e, momentum) + cross(mid, of)) * (0.5f * h);
      jacobian.m[0][j] = column.x;
      jacobian.m[1][j] = column.y;
      jacobian.m[2][j] = column.z;
    }
    const Vec3f a = column(jacobian, 0), b = column(jacobian, 1), c = column(jacobian, 2);
    const float d = 1.0f / dot(a, cross(b, c));
    next = next - Vec3f{dot(rest, cross(b, c)), dot(rest, cross(c, a)), dot(rest, cross(a, b))} * d;
  }
  return next;
}

// The force f on a body (N, N m) and its stiffness matrix h, of which only the lower triangle is
// used.
struct BodyBlock {
  float f[6] = {};
  float h[6][6] = {};
};

// Adds a force (N) at the center of mass and a moment (N m) about the center.
inline void add_force(BodyBlock& b, const Vec3f& force, const Vec3f& moment) {
  const float of[6] = {force.x, force.y, force.z, moment.x, moment.y, moment.z};
  for (int i = 0; i < 6; ++i) b.f[i] = b.f[i] + of[i];
}

// Adds k j j^T to the stiffness, for the row j = (linear, angular) of a Jacobian.
inline void add_row(BodyBlock& b, float k, const Vec3f& linear, const Vec3f& angular) {
  const float j[6] = {linear.x, linear.y, linear.z, angular.x, angular.y, angular.z};
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c <= r; ++c) b.h[r][c] = b.h[r][c] + (k * j[r]) * j[c];
}

// Returns the force and stiffness of inertia for a motion of the body.
inline BodyBlock inertia_block(const VbdBody& body, const VbdBodyMotion& at) {
  BodyBlock b;
  const Quatf off = math::multiply(at.turned, math::conjugate(body.target_turned));
  const Vec3f th = log_rotation(off);
  const Vec3f moment = {(body.xx * th.x + body.xy * th.y) + body.xz * th.z,
                        (body.xy * th.x + body.yy * th.y) + body.yz * th.z,
                        (body.xz * th.x + body.yz * th.y) + body.zz * th.z};
  add_force(b, (body.target - at.moved) * body.mass_by_h2,
            -inverse_left_jacobian_transposed(off, th, moment));
  for (int i = 0; i < 3; ++i) b.h[i][i] = body.mass_by_h2;
  b.h[3][3] = body.xx;
  b.h[4][4] = body.yy;
  b.h[5][5] = body.zz;
  b.h[4][3] = body.xy;
  b.h[5][3] = body.xz;
  b.h[5][4] = body.yz;
  return b;
}

// Moves a body by the increment d = (du, dw): a displacement (m) and a rotation vector (rad), in
// the world frame.
inline void move_body(VbdBodyMotion& at, const float (&d)[6]) {
  at.moved = at.moved + Vec3f{d[0], d[1], d[2]};
  at.turned = unit(math::multiply(exp_rotation({d[3], d[4], d[5]}), at.turned));
  at.turn = log_rotation(at.turned);
}

}  // namespace vbd
}  // namespace novaphy
