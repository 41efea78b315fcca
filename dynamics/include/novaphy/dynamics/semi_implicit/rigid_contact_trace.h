// The force of a rigid penalty contact: spring, damper that acts only on approach, and friction.
//
// Law, for the shapes A and B, N = -normal (from B to A):
//   P_A = X_A(p_A) - N m_A,  P_B = X_B(p_B) + N m_B     surface points including the margins
//   d  = dot(N, P_A - P_B)                              < 0 is penetration; no force for d >= ka
//   P  = (P_A + P_B)/2 between two bodies; the body's own point if the other side is the world
//   u  = v_A - v_B at P,  un = dot(N, u),  ut = u - N un
//   fn = ke d,  fd = kd min(un, 0) for d < 0, else 0
//   F  = N (fn + fd) + friction(ut, c),  c = -mu (fn + fd) the Coulomb limit, 0 for d >= 0
//   B gets F at P and A gets -F there, which conserves momentum and angular momentum; moments are
//   about the centers of mass
// Friction (c > 0, s = |ut|):
//   viscous   kf ut, clipped to the cone: ut c/s for kf s > c
//   huber     ut min(kf, c/h),  h = (s^2 + e^2)/(2 e) for s <= e, else s. Never exceeds the cone,
//             smooth for s < e. e = 0 has the bits of viscous
//   newton17  ut/h min(kf h, c),  h = s^2/2 for s <= e, else e (s - e/2). May exceed the cone
//   newton18  viscous
// With newton17 and newton18 A gets -F at P_A and B gets F at P_B, each with the velocity there, as
// in Newton. Friction then creates a couple |ut part of F| |d|. Both laws are for comparison only.
// No law has sticking friction: a contact creeps under a load below the cone.
//
// With PenaltyLaw::Mean the force near the surface, |d| < w = h |un|/2 (h: the step), is its mean
// over [t - h/2, t + h/2] at the velocities of time t. The fraction of that time in contact is r =
// 1/2 - d/(2 w):
//   fn = -ke (w - d)^2/(4 w),  fd = r kd min(un, 0),  friction with r kf and c = -mu (fn + fd)
// The force is then continuous in d, and the result of a touch depends little on where in a step it
// begins. The laws of Newton do not support the mean. Symbols:
//   X, v, w, c   pose, velocity, angular velocity and center of mass of a body (Model::body_q and
//                others); the world: identity, 0
//   p, m, normal Contacts::rigid_contact_point0, margin0 and so on
//   ke, kd, kf   N/m, N*s/m, N*s/m; mu 1; ka m: each the mean over the two shapes, except for ke,
//                kd and mu of a row with its own values (Contacts::rigid_contact_stiffness, ...)
//   e            friction_smoothing (m/s), e > 0 for newton17
//   F            N, world frame
// Source: Newton 1.8.0 for newton18, with the same bits on the CPU, except that margins act on
// world-owned shapes too. viscous has these bits if one side is the world. Newton 1.7 for newton17.
// huber is the Huber norm, scaled to stay within the cone.
//
// Points where the law is not smooth, and the value there (the derivative makes the same choice):
//   d = ka, d = 0   no force, no damping. At touch-down the sampled force jumps by kd un.
//   |d| = w, un = 0 the mean: the force and its first derivative by d are continuous, except for
//                   damping and friction
//   un = 0          min takes the constant 0: damping has no gradient.
//   at the cone     viscous: kf ut.
// Gradient: exact in poses, velocities, centers of mass, p, m, normal, ke, kd, kf, mu away from
// these points, including zero slip. `ka` only selects and has no gradient.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

enum class FrictionLaw { Viscous, Huber, Newton17, Newton18 };
// How the force is taken. Sampled: at the start of a step. Mean: as the mean over a step around
// that time.
enum class PenaltyLaw { Sampled, Mean };

// Returns whether a law is Newton's. Then each side gets the force at its own surface point, and
// bodies rotate with Newton's rounding (rigid_integrator_trace.h, "Newton's spin").
inline bool is_of_newton(FrictionLaw law) {
  return law == FrictionLaw::Newton17 || law == FrictionLaw::Newton18;
}

template <class T>
struct RigidContactMaterial {
  T ke{}, kd{}, kf{}, ka{}, mu{};
};
template <class T>
RigidContactMaterial<T> mean_rigid_contact_material(const RigidContactMaterial<T>& a,
                                                    const RigidContactMaterial<T>& b) {
  const T half = T(0.5f);
  return {(a.ke + b.ke) * half, (a.kd + b.kd) * half, (a.kf + b.kf) * half, (a.ka + b.ka) * half,
          (a.mu + b.mu) * half};
}

// Returns the material of a contact: the shapes' mean, with the row's own stiffness, damping and
// friction coefficient where these are > 0.
template <class T>
RigidContactMaterial<T> rigid_contact_material_of_row(const RigidContactMaterial<T>& of_shapes,
                                                      const T& ke, const T& kd, const T& mu) {
  using namespace math;
  const T zero = T(0.0f);
  return {select(ke > zero, ke, of_shapes.ke), select(kd > zero, kd, of_shapes.kd), of_shapes.kf,
          of_shapes.ka, select(mu > zero, mu, of_shapes.mu)};
}

// One side of a contact.
template <class T>
struct RigidContactSide {
  Transform<T> pose{};  // pose of the body; the identity for the world
  SpatialVector<T> twist{};
  Vec3<T> com{};
  Vec3<T> point{};  // core point, body frame (m)
  T margin{};
  T is_body{};  // 1 for a body, 0 for the world
};

// The force on B, and the arms from both centers of mass to the points where the force acts.
template <class T>
struct RigidContactForce {
  Vec3<T> force{}, arm_a{}, arm_b{};
};

// Returns friction(ut, c) for c > 0, else 0.
template <class T>
Vec3<T> rigid_friction(FrictionLaw law, const Vec3<T>& ut, const T& limit, const T& kf,
                       const T& smoothing) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const auto acts = both(limit > zero, kf > zero);
  const T cap = select(acts, limit, one), k = select(acts, kf, one);  // avoids a division by 0
  const T s2 = dot(ut, ut);
  T slope;  // friction per slip speed
  if (law == FrictionLaw::Viscous || law == FrictionLaw::Newton18) {
    const T at_cap = cap / k;
    const auto slides = s2 > at_cap * at_cap;
    slope = select(slides, cap / sqrt(select(slides, s2, one)), k);
  } else {
    const T s = sqrt(s2);
    const auto small = s < smoothing;
    const T e = select(smoothing > zero, smoothing, one);
    if (law == FrictionLaw::Huber) {
      const T h = select(small, (s2 + e * e) / (e + e), s), h2 = select(small, h * h, s2);
      const T at_cap = cap / k;
      const auto slides = h2 > at_cap * at_cap;
      slope = select(slides, cap / select(slides, h, one), k);
    } else {
      const T h = select(small, s2 * T(0.5f), e * (s - e * T(0.5f)));
      const auto slips = h > zero;
      slope = select(slips, min(k * h, cap) / select(slips, h, one), k);
    }
  }
  return ut * select(acts, slope, zero);
}

// The options of the law. half_step: h/2 (s), used by the mean only.
template <class T>
struct RigidContactLaw {
  FrictionLaw friction = FrictionLaw::Viscous;
  T smoothing{};
  PenaltyLaw penalty = PenaltyLaw::Sampled;
  T half_step{};
};

// Returns the mean force on B over a step, for the gap d.
template <class T>
Vec3<T> mean_contact_force(const RigidContactLaw<T>& law, const Vec3<T>& n, const T& d, const T& un,
                           const Vec3<T>& ut, const RigidContactMaterial<T>& material) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const T w = abs(un) * law.half_step;
  const auto near = abs(d) < w;
  const T twice = select(near, w + w, one), part = select(near, w - d, zero) / twice;
  const T in_contact = select(near, part, step(d));
  const T fn = select(near, (zero - material.ke) * ((part * part) * w), d * material.ke);
  const T fd = (min(un, zero) * material.kd) * in_contact;
  const T limit = select(d < w, (-material.mu) * (fn + fd), zero);
  const Vec3<T> force = n * (fn + fd) + rigid_friction(law.friction, ut, limit,
                                                       material.kf * in_contact, law.smoothing);
  return select(d >= w, Vec3<T>{zero, zero, zero}, force);  // NaN gives a NaN force
}

// Returns the force on B (N). p_a, p_b: surface points including the margins, n = N, u = v_A - v_B.
template <class T>
Vec3<T> rigid_contact_law(const RigidContactLaw<T>& law, const Vec3<T>& n, const Vec3<T>& p_a,
                          const Vec3<T>& p_b, const Vec3<T>& u,
                          const RigidContactMaterial<T>& material) {
  using namespace math;
  const T zero = T(0.0f);
  const T d = dot(n, p_a - p_b);
  const T un = dot(n, u);
  const Vec3<T> ut = u - n * un;
  if (law.penalty == PenaltyLaw::Mean) return mean_contact_force(law, n, d, un, ut, material);
  const T fn = d * material.ke;
  const T fd = (min(un, zero) * material.kd) * step(d);
  const T limit = select(d < zero, (-material.mu) * (fn + fd), zero);
  const Vec3<T> force =
      n * (fn + fd) + rigid_friction(law.friction, ut, limit, material.kf, law.smoothing);
  // The test is d >= ka, so that a NaN gives a NaN force instead of switching the contact off.
  return select(d >= material.ka, Vec3<T>{zero, zero, zero}, force);
}

// Returns the force for two core points in the world frame.
template <class T>
RigidContactForce<T> rigid_contact_force_at(const RigidContactLaw<T>& law,
                                            const RigidContactSide<T>& a,
                                            const RigidContactSide<T>& b, const Vec3<T>& core_a,
                                            const Vec3<T>& core_b, const Vec3<T>& normal,
                                            const RigidContactMaterial<T>& material) {
  using namespace math;
  const Vec3<T> n = -normal;
  const Vec3<T> p_a = core_a - n * a.margin;
  const Vec3<T> p_b = core_b + n * b.margin;
  Vec3<T> at_a = p_a, at_b = p_b;
  if (!is_of_newton(law.friction)) {
    const T half = T(0.5f);
    at_a = select(a.is_body < half, p_b, select(b.is_body < half, p_a, (p_a + p_b) * half));
    at_b = at_a;
  }
  const Vec3<T> arm_a = at_a - transform_point(a.pose, a.com);
  const Vec3<T> arm_b = at_b - transform_point(b.pose, b.com);
  const Vec3<T> u = (a.twist.linear + cross(a.twist.angular, arm_a)) -
                    (b.twist.linear + cross(b.twist.angular, arm_b));
  return {rigid_contact_law(law, n, p_a, p_b, u, material), arm_a, arm_b};
}

template <class T>
RigidContactForce<T> rigid_contact_force(const RigidContactLaw<T>& law,
                                         const RigidContactSide<T>& a, const RigidContactSide<T>& b,
                                         const Vec3<T>& normal,
                                         const RigidContactMaterial<T>& material) {
  return rigid_contact_force_at(law, a, b, math::transform_point(a.pose, a.point),
                                math::transform_point(b.pose, b.point), normal, material);
}

}  // namespace novaphy
