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
//
// The laws are templates over the scalar T. T = float runs in the engine. T = math::Dual<float> gives
// derivatives.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/ldlt.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/spatial.h"

namespace novaphy {

// The motion of a body since the start of the step.
template <class T>
struct alignas(16) VbdBodyMotionOf {
  using Element = Vec4f;
  Vec3<T> moved{};  // displacement of the center of mass (m)
  float unused = 0.0f;
  Quat<T> turned = Quat<T>::identity();
  Vec3<T> turn{};  // the rotation vector of `turned` (rad)
  float unused2 = 0.0f;
};
using VbdBodyMotion = VbdBodyMotionOf<float>;

// The inertial target of a body in a step, and its inertia. mass_by_h2 (kg/s^2) is 0 for a
// kinematic body.
template <class T>
struct alignas(16) VbdBodyOf {
  using Element = Vec4f;
  Vec3<T> target{};
  T mass_by_h2{};
  Quat<T> target_turned = Quat<T>::identity();
  T xx{}, yy{}, zz{}, xy{}, xz{}, yz{};  // I*/h^2
  float unused = 0.0f, unused2 = 0.0f;
};
using VbdBody = VbdBodyOf<float>;

namespace vbd {

// Returns the unit quaternion of the rotation vector w (rad).
template <class T>
Quat<T> exp_rotation(const Vec3<T>& w) {
  using namespace math;
  const T angle = length(w), half = T(0.5f) * angle;
  const T s = angle > T(1e-4f) ? sin(half) / angle : T(0.5f) - angle * angle / T(48.0f);
  return {w.x * s, w.y * s, w.z * s, cos(half)};
}

// Returns the rotation vector (rad) of a unit quaternion. Its length is at most pi.
template <class T>
Vec3<T> log_rotation(const Quat<T>& q) {
  using namespace math;
  const T sign = q.w < T(0.0f) ? T(-1.0f) : T(1.0f);
  const Vec3<T> v = Vec3<T>{q.x, q.y, q.z} * sign;
  const T s = length(v), w = q.w * sign;
  const T factor = s > T(1e-4f) ? T(2.0f) * atan2(s, w) / s : T(2.0f) / w;
  return v * factor;
}

template <class T>
Quat<T> unit(const Quat<T>& q) {
  using namespace math;
  const T s = T(1.0f) / sqrt(((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w);
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}

template <class T>
struct PerpendicularOf {
  // t[0], t[1]: unit vectors perpendicular to each other and to the unit vector t[2]
  Vec3<T> t[3];
};
using Perpendicular = PerpendicularOf<float>;
template <class T>
PerpendicularOf<T> perpendicular(const Vec3<T>& axis) {
  const T one(1.0f), zero(0.0f);
  const bool is_off_x = axis.x < T(0.6f) && axis.x > T(-0.6f);
  const Vec3<T> other = is_off_x ? Vec3<T>{one, zero, zero} : Vec3<T>{zero, one, zero};
  const Vec3<T> u = math::normalize(math::cross(axis, other));
  return {{u, math::cross(axis, u), axis}};
}

// Returns rotate(q, r) - r, without the cancellation for small rotations.
template <class T>
Vec3<T> rotate_change(const Quat<T>& q, const Vec3<T>& r) {
  const Vec3<T> v = {q.x, q.y, q.z}, c = math::cross(v, r);
  return (c * q.w + math::cross(v, c)) * T(2.0f);
}

// Returns J_l(th)^-T v for th = log(q), with the left Jacobian J_l of SO(3).
template <class T>
Vec3<T> inverse_left_jacobian_transposed(const Quat<T>& q, const Vec3<T>& th, const Vec3<T>& v) {
  using namespace math;
  const T square = dot(th, th);
  T c = T(1.0f / 12.0f) + square / T(720.0f);
  if (square > T(0.04f)) {
    const T s = length(Vec3<T>{q.x, q.y, q.z}), w = q.w < T(0.0f) ? -q.w : q.w;
    c = (T(1.0f) - T(0.5f) * sqrt(square) * w / s) / square;
  }
  const Vec3<T> once = cross(th, v);
  return v + once * T(0.5f) + cross(th, once) * c;
}

// Returns the angular velocity after the time h (rad/s, body axes), by three Newton iterations of
// the midpoint rule. `moment` is in body axes (N m).
template <class T>
Vec3<T> turn_freely(const Mat33<T>& inertia, const Vec3<T>& w, const Vec3<T>& moment, float h) {
  using namespace math;
  Vec3<T> next = w;
  for (int k = 0; k < 3; ++k) {
    const Vec3<T> mid = (w + next) * T(0.5f), momentum = multiply(inertia, mid);
    const Vec3<T> rest = multiply(inertia, next - w) + (cross(mid, momentum) - moment) * T(h);
    Mat33<T> jacobian;
    for (int j = 0; j < 3; ++j) {
      const Vec3<T> e = {T(j == 0 ? 1.0f : 0.0f), T(j == 1 ? 1.0f : 0.0f), T(j == 2 ? 1.0f : 0.0f)};
      const Vec3<T> of = multiply(inertia, e);
      const Vec3<T> column = of + (cross(e, momentum) + cross(mid, of)) * T(0.5f * h);
      jacobian.m[0][j] = column.x;
      jacobian.m[1][j] = column.y;
      jacobian.m[2][j] = column.z;
    }
    const Vec3<T> a = column(jacobian, 0), b = column(jacobian, 1), c = column(jacobian, 2);
    const T d = T(1.0f) / dot(a, cross(b, c));
    next =
        next - Vec3<T>{dot(rest, cross(b, c)), dot(rest, cross(c, a)), dot(rest, cross(a, b))} * d;
  }
  return next;
}

// The state of a body at the start of a step, and what acts on it.
template <class T>
struct BodyStart {
  Quat<T> q = Quat<T>::identity();
  SpatialVector<T> qd{}, f{};
  Vec3<T> gravity{};
  T mass{}, inv_mass{};
  Mat33<T> inertia{};  // kg m^2, body axes
};

template <class T>
VbdBodyOf<T> inertial_target(const BodyStart<T>& start, float h) {
  using namespace math;
  const Quat<T>& q = start.q;
  const T by_h2(1.0f / (h * h));
  VbdBodyOf<T> body;
  body.target = start.qd.linear * T(h) +
                (start.gravity + start.f.linear * start.inv_mass) * T(h * h);
  body.mass_by_h2 = start.mass * by_h2;
  const Vec3<T> turning =
      rotate(q, turn_freely(start.inertia, rotate_inverse(q, start.qd.angular),
                            rotate_inverse(q, start.f.angular), h));
  body.target_turned = exp_rotation(turning * T(h));
  const SpatialInertia<T> of =
      rotate(multiply(body.target_turned, q),
             spatial_inertia(T(0.0f), Vec3<T>{}, scale(start.inertia, by_h2)));
  body.xx = of.xx;
  body.yy = of.yy;
  body.zz = of.zz;
  body.xy = of.xy;
  body.xz = of.xz;
  body.yz = of.yz;
  return body;
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

// Returns the force (N) and the moment (N m) of inertia for a motion of the body.
template <class T>
SpatialVector<T> inertia_force(const VbdBodyOf<T>& body, const VbdBodyMotionOf<T>& at) {
  const Quat<T> off = math::multiply(at.turned, math::conjugate(body.target_turned));
  const Vec3<T> th = log_rotation(off);
  const Vec3<T> moment = {(body.xx * th.x + body.xy * th.y) + body.xz * th.z,
                          (body.xy * th.x + body.yy * th.y) + body.yz * th.z,
                          (body.xz * th.x + body.yz * th.y) + body.zz * th.z};
  return {(body.target - at.moved) * body.mass_by_h2,
          -inverse_left_jacobian_transposed(off, th, moment)};
}

// Returns the force and stiffness of inertia for a motion of the body.
inline BodyBlock inertia_block(const VbdBody& body, const VbdBodyMotion& at) {
  BodyBlock b;
  const SpatialVectorf force = inertia_force(body, at);
  add_force(b, force.linear, force.angular);
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
  at.turned = unit(math::multiply(exp_rotation(Vec3f{d[3], d[4], d[5]}), at.turned));
  at.turn = log_rotation(at.turned);
}

}  // namespace vbd
}  // namespace novaphy
