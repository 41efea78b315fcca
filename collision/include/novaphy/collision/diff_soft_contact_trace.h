// The contact of a particle with a shape, as formulas: the contact force, and the contact with a
// static shape (signed distance, normal, closest point).
//
// Law (penalty spring, damper that acts only on approach, viscous friction with a Coulomb limit):
//   c  = dot(n, x - p) - R
//   v  = v_p - v_s, vn = dot(n, v), vt = v - n*vn
//   f  = (n*c)*ke + ((n*min(vn, 0))*kd + unit(vt)*min(kf*|vt|, |(mu*c)*ke|))
//   the force on the particle is -f for c <= a, and 0 for c > a
// Symbols:
//   x, v_p           particle position (m) and velocity (m/s), world frame
//   R                particle radius (m)
//   p, v_s           contact point on the shape (m) and its velocity (m/s), world frame
//   n                unit normal, out of the shape, world frame
//   c                gap between the two surfaces (m); < 0 is penetration
//   ke, kd, kf, mu   N/m, N*s/m, N*s/m, 1: each the mean of the model's value and the shape's
//   m                mass of the particle (kg)
//   r                bound of kf (1/s): kf is at most r m, if m is not 0. A solver uses r =
//                    particle_kf_bound / dt, so that friction removes at most this part of the slip
//                    in a step. Operators and Newton have no bound: r = kNoKfBound.
//   a, f             adhesion distance (m), 0 by default; force (N), world frame
// The margin of a shape widens the search for contacts, not the force. Source: SolverSemiImplicit
// of Newton 1.8.0, which has no bound r. Its output on the CPU has the same bits where kf <= r m.
//
// Points where the law is not smooth, and the value there (the derivative takes the same branch):
//   c = a    the force acts. It jumps by the damping kd*vn at touch-down.
//   vn = 0   min takes the constant 0: damping has no gradient.
//   |vt| = 0 (underflow included)   the force is 0. The derivative by vt is kf, that of the smooth
//            branch kf*vt, if |(mu*c)*ke| > 0, else 0.
//   kf*|vt| = |(mu*c)*ke|   the Coulomb branch; |.| has the derivative +1 at 0.
//   kf = r m the branch kf, not the bound.
//   The normal of a surface jumps at the points that surface_distance_trace.h lists.
// Gradient: exact in x, v_p, R, p, v_s, n, ke, kd, kf, mu, m away from these points. The adhesion
// distance only selects a branch and has no gradient. r is a constant.
//
// Freestanding: with T = float the code runs in the forward engine, with T = nova::Real it is
// traced. Both round each operation once, in the same order, and give the same bits.
#pragma once

#include "novaphy/collision/surface_distance_trace.h"

namespace novaphy {

template <class T>
struct SoftContactMaterial {
  T ke{}, kd{}, kf{}, mu{};
};

// Returns 0.5*(model + shape) for each coefficient.
template <class T>
SoftContactMaterial<T> mean_soft_contact_material(const SoftContactMaterial<T>& model,
                                                  const SoftContactMaterial<T>& shape) {
  const T half = T(0.5f);
  return {half * (model.ke + shape.ke), half * (model.kd + shape.kd), half * (model.kf + shape.kf),
          half * (model.mu + shape.mu)};
}

// Represents infinity. The value is finite, because 0 times its derivative must be 0.
inline constexpr float kNoKfBound = 1e30f;
// Returns r (1/s) of the law from particle_kf_bound >= 0, which may be infinite.
inline float kf_rate(float bound, float dt) {
  const float rate = bound / dt;
  return rate < kNoKfBound ? rate : kNoKfBound;
}
template <class T>
SoftContactMaterial<T> with_bounded_kf(SoftContactMaterial<T> material, const T& mass,
                                       const T& rate) {
  using namespace math;
  const T most = rate * mass;
  material.kf = select(both(mass > T(0.0f), most < material.kf), most, material.kf);
  return material;
}

// Returns the force on the particle (N): -f, or -0 for an inactive contact. Adding -0 does not
// change the bits of a sum, so that a sum over all slots has the bits of Newton's sum.
template <class T>
Vec3<T> soft_contact_force_term(const Vec3<T>& x, const Vec3<T>& v_p, const T& radius,
                                const Vec3<T>& point, const Vec3<T>& point_velocity,
                                const Vec3<T>& normal, const SoftContactMaterial<T>& material,
                                const T& adhesion) {
  using namespace math;
  const T c = dot(normal, x - point) - radius;
  const Vec3<T> v = v_p - point_velocity;
  const T vn = dot(normal, v);
  const Vec3<T> vt = v - normal * vn;
  const Vec3<T> fn = (normal * c) * material.ke;
  const Vec3<T> fd = (normal * min(vn, T(0.0f))) * material.kd;
  const T speed = length(vt), limit = abs((material.mu * c) * material.ke);
  const Vec3<T> friction = normalize(vt) * min(material.kf * speed, limit);
  // Without slip the unit vector and the length have no gradient. This term adds the derivative.
  const T at_rest = select(both(speed == T(0.0f), limit > T(0.0f)), material.kf, T(0.0f));
  const Vec3<T> ft = with_derivative(friction, vt, at_rest);
  const Vec3<T> f = fn + (fd + ft);
  // The test is c > a, so that a NaN reaches the force. A test c <= a would turn the contact off.
  const T none = T(-0.0f);
  return select(c > adhesion, Vec3<T>{none, none, none}, -f);
}

// The contact point of a shape that belongs to a body.
template <class T>
struct SoftContactBody {
  Vec3<T> position{}, velocity{};  // world frame
  Vec3<T> arm{};                   // from the center of mass to the position, world frame
};
// Computes the contact point from the body's pose, twist (velocity of the center of mass), and
// center of mass (body frame). `point` and its relative velocity are in the body frame.
template <class T>
SoftContactBody<T> soft_contact_body(const Transform<T>& pose, const SpatialVector<T>& twist,
                                     const Vec3<T>& com, const Vec3<T>& point,
                                     const Vec3<T>& point_velocity) {
  using namespace math;
  const Vec3<T> position = transform_point(pose, point);
  const Vec3<T> arm = position - transform_point(pose, com);
  return {position, (twist.linear + rotate(pose.q, point_velocity)) + cross(twist.angular, arm),
          arm};
}

// The contact of a particle with a world-owned shape, in the world frame.
template <class T>
struct StaticContact {
  T distance{};      // m, from the particle's center to the surface
  Vec3<T> point{};   // m, closest point of the surface
  Vec3<T> normal{};  // unit, out of the shape
};

// Returns the pose of a world-owned shape with the bits of Newton. Newton multiplies the pose by
// the identity pose of the world, which turns -0 components into +0.
template <class T>
Transform<T> static_shape_pose(const Transform<T>& xform) {
  return math::multiply(Transform<T>::identity(), xform);
}
// Returns the particle's position in the shape's frame. `pose` is the result of static_shape_pose.
template <class T>
Vec3<T> to_shape_frame(const Transform<T>& pose, const Vec3<T>& x) {
  return math::transform_point(math::inverse(pose), x);
}
// Returns a contact from a distance and a normal in the shape's frame.
template <class T>
StaticContact<T> static_contact_record(const Transform<T>& xform, const Transform<T>& pose,
                                       const Vec3<T>& x_local, const SurfaceDistance<T>& surface) {
  using namespace math;
  return {surface.distance, transform_point(xform, x_local - surface.normal * surface.distance),
          rotate(pose.q, surface.normal)};
}

// Returns the contact of a particle at `x` (world frame) with a world-owned shape at `xform`. The
// contact acts if distance < (gap + margin) + radius.
template <bool Round, class B, class T>
StaticContact<T> static_shape_contact(const StaticShapeType<B>& type, const Transform<T>& xform,
                                      const Vec3<T>& scale, const Vec3<T>& x) {
  const Transform<T> pose = static_shape_pose(xform);
  const Vec3<T> x_local = to_shape_frame(pose, x);
  return static_contact_record(xform, pose, x_local,
                               static_shape_distance<Round>(type, scale, x_local));
}

}  // namespace novaphy
