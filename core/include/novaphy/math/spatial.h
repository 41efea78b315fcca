// Spatial vectors, frames and inertias, as templates over the scalar like types.h.
//
// Motion (v, w) and force (f, t) have their linear part first and refer to the origin of their
// frame. The velocity v is that of the body point at the origin. The moment t is about the origin.
// A frame is a Transform X, the pose of the frame in the outer frame: p' = p + rotate(q, x). An
// inertia is ten numbers about the origin; only factorizations use a 6x6 matrix (ldlt.h).
//
// Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2, but with the linear part
// first. Comments give the numbers of equations.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

// Spatial inertia (2.63): mass (kg), first moment m c of the center of mass c (kg m), and symmetric
// rotational inertia about the origin, I_c + m (|c|^2 1 - c c^T) (kg m^2).
template <class T>
struct SpatialInertia {
  T mass{};
  Vec3<T> moment{};
  T xx{}, yy{}, zz{}, xy{}, xz{}, yz{};
  bool operator==(const SpatialInertia&) const = default;
};
using SpatialInertiaf = SpatialInertia<float>;

template <class T>
struct Mat66 {
  T m[6][6]{};
  bool operator==(const Mat66&) const = default;
};

template <class T>
SpatialVector<T> operator+(const SpatialVector<T>& a, const SpatialVector<T>& b) {
  return {a.linear + b.linear, a.angular + b.angular};
}
template <class T>
SpatialVector<T> operator-(const SpatialVector<T>& a, const SpatialVector<T>& b) {
  return {a.linear - b.linear, a.angular - b.angular};
}
template <class T>
SpatialVector<T> operator*(const SpatialVector<T>& a, const T& s) {
  return {a.linear * s, a.angular * s};
}
template <class T>
SpatialInertia<T> operator+(const SpatialInertia<T>& a, const SpatialInertia<T>& b) {
  return {a.mass + b.mass, a.moment + b.moment, a.xx + b.xx, a.yy + b.yy,
          a.zz + b.zz,     a.xy + b.xy,         a.xz + b.xz, a.yz + b.yz};
}

namespace math {

// Returns the power of a force on a motion.
template <class T>
T dot(const SpatialVector<T>& motion, const SpatialVector<T>& force) {
  return dot(motion.linear, force.linear) + dot(motion.angular, force.angular);
}
// Returns m x m': the rate of a motion m' that moves with m (2.31).
template <class T>
SpatialVector<T> cross_motion(const SpatialVector<T>& m, const SpatialVector<T>& motion) {
  return {cross(m.angular, motion.linear) + cross(m.linear, motion.angular),
          cross(m.angular, motion.angular)};
}
// Returns m x* f: the rate of a force f that moves with m (2.32). As a matrix, m x* is minus the
// transpose of m x.
template <class T>
SpatialVector<T> cross_force(const SpatialVector<T>& m, const SpatialVector<T>& force) {
  return {cross(m.angular, force.linear),
          cross(m.angular, force.angular) + cross(m.linear, force.linear)};
}

// Shifts a motion or force to another reference point at r from the origin. The axes stay.
template <class T>
SpatialVector<T> motion_at(const SpatialVector<T>& motion, const Vec3<T>& r) {
  return {motion.linear + cross(motion.angular, r), motion.angular};
}
template <class T>
SpatialVector<T> force_at(const SpatialVector<T>& force, const Vec3<T>& r) {
  return {force.linear, force.angular - cross(r, force.linear)};
}

// Transform from the frame X to the outer frame: X m for motions, X^-T f for forces (2.24, 2.25).
template <class T>
SpatialVector<T> transform_motion(const Transform<T>& x, const SpatialVector<T>& motion) {
  const Vec3<T> angular = rotate(x.q, motion.angular);
  return {rotate(x.q, motion.linear) + cross(x.p, angular), angular};
}
template <class T>
SpatialVector<T> transform_force(const Transform<T>& x, const SpatialVector<T>& force) {
  const Vec3<T> linear = rotate(x.q, force.linear);
  return {linear, rotate(x.q, force.angular) + cross(x.p, linear)};
}
// Transform from the outer frame to X: X^-1 m for motions, X^T f for forces. dot(X m, f) = dot(m,
// X^T f).
template <class T>
SpatialVector<T> inverse_transform_motion(const Transform<T>& x, const SpatialVector<T>& motion) {
  return {rotate_inverse(x.q, motion.linear - cross(x.p, motion.angular)),
          rotate_inverse(x.q, motion.angular)};
}
template <class T>
SpatialVector<T> inverse_transform_force(const Transform<T>& x, const SpatialVector<T>& force) {
  return {rotate_inverse(x.q, force.linear),
          rotate_inverse(x.q, force.angular - cross(x.p, force.linear))};
}

// Returns the inertia of a body with the center of mass c and the symmetric rotational inertia
// `about_com`, in the axes of the frame.
template <class T>
SpatialInertia<T> spatial_inertia(const T& mass, const Vec3<T>& c, const Mat33<T>& about_com) {
  const Vec3<T> h = c * mass;
  const T hx = h.x * c.x, hy = h.y * c.y, hz = h.z * c.z;
  return {mass,
          h,
          about_com.m[0][0] + (hy + hz),
          about_com.m[1][1] + (hx + hz),
          about_com.m[2][2] + (hx + hy),
          about_com.m[1][0] - h.x * c.y,
          about_com.m[2][0] - h.x * c.z,
          about_com.m[2][1] - h.y * c.z};
}
// Returns the product of the rotational inertia about the origin and a vector.
template <class T>
Vec3<T> rotational(const SpatialInertia<T>& y, const Vec3<T>& w) {
  return {(y.xx * w.x + y.xy * w.y) + y.xz * w.z, (y.xy * w.x + y.yy * w.y) + y.yz * w.z,
          (y.xz * w.x + y.yz * w.y) + y.zz * w.z};
}
// Returns Y m: the momentum of a motion, or the force of an acceleration.
template <class T>
SpatialVector<T> apply(const SpatialInertia<T>& y, const SpatialVector<T>& motion) {
  return {motion.linear * y.mass - cross(y.moment, motion.angular),
          cross(y.moment, motion.linear) + rotational(y, motion.angular)};
}
// Returns the bias force m x* Y m: the gyroscopic term and the term of the moving origin.
template <class T>
SpatialVector<T> bias_force(const SpatialInertia<T>& y, const SpatialVector<T>& motion) {
  return cross_force(motion, apply(y, motion));
}
// Shifts an inertia to another point at r from the origin. The axes stay.
template <class T>
SpatialInertia<T> inertia_at(const SpatialInertia<T>& y, const Vec3<T>& r) {
  const Vec3<T> h = y.moment - r * y.mass;
  // Parallel axis theorem: subtracts the terms of r and h + moment, where h is the first moment
  // about the new point.
  const Vec3<T> s = y.moment + h;
  const T half = T(0.5f);
  const T rx = r.x * s.x, ry = r.y * s.y, rz = r.z * s.z;
  return {y.mass,
          h,
          y.xx - (ry + rz),
          y.yy - (rx + rz),
          y.zz - (rx + ry),
          y.xy + (r.x * s.y + r.y * s.x) * half,
          y.xz + (r.x * s.z + r.z * s.x) * half,
          y.yz + (r.y * s.z + r.z * s.y) * half};
}
// Returns the inertia in axes that are rotated by q: R Y R^T.
template <class T>
SpatialInertia<T> rotate(const Quat<T>& q, const SpatialInertia<T>& y) {
  const Vec3<T> a = rotate(q, Vec3<T>{y.xx, y.xy, y.xz}), b = rotate(q, Vec3<T>{y.xy, y.yy, y.yz}),
                c = rotate(q, Vec3<T>{y.xz, y.yz, y.zz});
  const Vec3<T> x = rotate(q, Vec3<T>{a.x, b.x, c.x}), z = rotate(q, Vec3<T>{a.z, b.z, c.z}),
                m = rotate(q, Vec3<T>{a.y, b.y, c.y});
  return {y.mass, rotate(q, y.moment), x.x, m.y, z.z, x.y, x.z, m.z};
}
// Transforms an inertia from the frame X to the outer frame (2.66).
template <class T>
SpatialInertia<T> transform_inertia(const Transform<T>& x, const SpatialInertia<T>& y) {
  return inertia_at(rotate(x.q, y), -x.p);
}
// Returns the inertia as a 6x6 matrix with the linear rows first: {m 1, -[h]; [h], I}.
template <class T>
Mat66<T> to_matrix(const SpatialInertia<T>& y) {
  const T o = T(0.0f);
  const Vec3<T> h = y.moment;
  return {{{y.mass, o, o, o, h.z, -h.y},
           {o, y.mass, o, -h.z, o, h.x},
           {o, o, y.mass, h.y, -h.x, o},
           {o, -h.z, h.y, y.xx, y.xy, y.xz},
           {h.z, o, -h.x, y.xy, y.yy, y.yz},
           {-h.y, h.x, o, y.xz, y.yz, y.zz}}};
}

}  // namespace math
}  // namespace novaphy
