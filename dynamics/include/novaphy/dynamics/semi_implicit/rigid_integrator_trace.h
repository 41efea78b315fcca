// Symplectic Euler for a rigid body, with an explicit gyroscopic term.
//
//   x_c = x + rotate(q, c)                       center of mass
//   v1  = v0 + (f/m + g s) dt                    s = 1 if 1/m > 0, else 0
//   x_c1 = x_c + v1 dt
//   w_b = rotate^-1(q, w0),  t_b = rotate^-1(q, t) - w_b x (I w_b)
//   w1  = w0 + rotate(q, (I^-1 t_b) dt)
//   q1  = unit(q + 1/2 (w1, 0) q dt)             quaternion product
//   x1  = x_c1 - rotate(q1, c)
//   the new angular velocity is w1 (1 - a dt)
// Symbols:
//   x, q      pose of the body's origin in the world (m, quaternion)
//   v, w      velocity of the center of mass and angular velocity, world frame (m/s, rad/s)
//   f, t      force and moment about the center of mass, world frame (N, N m)
//   c, I      center of mass (m), inertia about it (kg m^2), body frame
//   m         mass (kg)
//   g         gravity (m/s^2), world frame
//   a         angular damping (1/s)
// A kinematic body keeps its velocity and moves with it: x_c1 = x_c + v0 dt, q1 from w0.
//
// "Newton's spin" is w1 = rotate(q, w_b + (I^-1 t_b) dt), which differs only by rounding: |q| is
// not exactly 1, so |w| grows by about 2e-7 in each step.
//
// Source: Newton 1.8.0, SolverSemiImplicit. With Newton's spin the bits are those of Newton on the
// CPU, except that Newton's kinematic bodies do not move. The gyroscopic term gains energy of the
// order of (|w| dt)^2 per step. The rotation angle of a step is 2 atan(|w| dt / 2). Gradient: exact
// in x, q, v, w, f, t, c, I, I^-1, 1/m, g, dt, with q as four free numbers; s has no gradient.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/matrix.h"

namespace novaphy {

template <class T>
struct RigidBodyState {
  Transform<T> q{};
  SpatialVector<T> qd{};
};

template <class T>
struct RigidBodyMass {
  Vec3<T> com{};
  T inv_mass{};
  Mat33<T> inertia{}, inv_inertia{};
};

// Returns the orientation q after dt (s): unit(q + 1/2 (w, 0) q dt).
template <class T>
Quat<T> integrate_orientation(const Quat<T>& q, const Vec3<T>& w, const T& dt) {
  using namespace math;
  const Quat<T> rate = multiply(Quat<T>{w.x, w.y, w.z, T(0.0f)}, q);
  const T half = T(0.5f);
  const Quat<T> r = {q.x + (rate.x * half) * dt, q.y + (rate.y * half) * dt,
                     q.z + (rate.z * half) * dt, q.w + (rate.w * half) * dt};
  const T scale = T(1.0f) / sqrt(((r.x * r.x + r.y * r.y) + r.z * r.z) + r.w * r.w);
  return {r.x * scale, r.y * scale, r.z * scale, r.w * scale};
}

template <class T>
RigidBodyState<T> integrate_rigid_body(const RigidBodyState<T>& body, const SpatialVector<T>& force,
                                       const RigidBodyMass<T>& mass, const Vec3<T>& gravity,
                                       const T& angular_damping, const T& dt,
                                       bool newton_spin = false) {
  using namespace math;
  const Quat<T>& q = body.q.q;
  const Vec3<T> x_com = body.q.p + rotate(q, mass.com);
  const T moves = step(-mass.inv_mass);
  const Vec3<T> v = body.qd.linear + ((force.linear * mass.inv_mass) + (gravity * moves)) * dt;
  const Vec3<T> w_body = rotate_inverse(q, body.qd.angular);
  const Vec3<T> torque =
      rotate_inverse(q, force.angular) - cross(w_body, multiply(mass.inertia, w_body));
  const Vec3<T> change = multiply(mass.inv_inertia, torque) * dt;
  const Vec3<T> w = newton_spin ? rotate(q, w_body + change) : body.qd.angular + rotate(q, change);
  const Quat<T> turned = integrate_orientation(q, w, dt);
  const Vec3<T> x = (x_com + v * dt) - rotate(turned, mass.com);
  return {{x, turned}, {v, w * (T(1.0f) - angular_damping * dt)}};
}

template <class T>
RigidBodyState<T> move_kinematic_body(const RigidBodyState<T>& body, const Vec3<T>& com,
                                      const T& dt) {
  using namespace math;
  const Vec3<T> x_com = body.q.p + rotate(body.q.q, com);
  const Quat<T> turned = integrate_orientation(body.q.q, body.qd.angular, dt);
  return {{(x_com + body.qd.linear * dt) - rotate(turned, com), turned}, body.qd};
}

}  // namespace novaphy
