// Functions for the joint types of links: columns of S, quaternions and their tangents.
#pragma once

#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

// Returns the column of S for a rotation about an axis of the anchor through the point `at` (m,
// about O).
template <class T>
SpatialVector<T> turning_column(const LinkState<T>& s, const Vec3<T>& axis, const Vec3<T>& at) {
  const Vec3<T> w = math::rotate(s.anchor_q, axis);
  return {math::cross(at, w), w};
}

// Returns a link's center of mass in its joint's frame (m): X_c^-1 (com).
template <class T>
Vec3<T> com_in_joint(const Tree<T>& tree, const Link& link) {
  const Vec3<T> com = link.body < 0 ? Vec3<T>{} : tree.com[link.body];
  return link.frame_c < 0
             ? com
             : math::rotate_inverse(tree.X_c[link.frame_c].q, com - tree.X_c[link.frame_c].p);
}

template <class T>
T quat_length(const Quat<T>& q) {
  return square_root(((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w);
}
template <class T>
Quat<T> scaled(const Quat<T>& q, const T& s) {
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}
// Returns the normalized quaternion of four coordinates. `length`: their length before.
template <class T>
Quat<T> unit_quaternion(const T* x, T& length) {
  const Quat<T> raw = {x[0], x[1], x[2], x[3]};
  length = quat_length(raw);
  return scaled(raw, T(1.0f) / length);
}
template <class T>
Quat<T> unit_quaternion(const T* x) {
  T length;
  return unit_quaternion(x, length);
}

// Converts a gradient g by the quaternion r to one by its tangent: E(r)^T g, where E(r) e = (e, 0)
// r / 2.
template <class T>
Vec3<T> quat_to_tangent(const Quat<T>& r, const Quat<T>& g) {
  const T half = T(0.5f);
  return {(((r.w * g.x - r.z * g.y) + r.y * g.z) - r.x * g.w) * half,
          (((r.z * g.x + r.w * g.y) - r.x * g.z) - r.y * g.w) * half,
          (((r.x * g.y - r.y * g.x) + r.w * g.z) - r.z * g.w) * half};
}
// Returns 4 E(r) h for a tangent h, with E(r) e = (e, 0) r / 2.
template <class T>
Quat<T> quat_from_tangent(const Quat<T>& r, const Vec3<T>& h) {
  const Quat<T> turned = math::multiply(Quat<T>{h.x, h.y, h.z, T(0.0f)}, r);
  return scaled(turned, T(2.0f));
}

// Returns the normalized quaternion (y, 1): the Cayley map, the rotation of a step with y = dt w /
// 2.
template <class T>
Quat<T> cayley(const Vec3<T>& y) {
  const T s = T(1.0f) / square_root(T(1.0f) + math::dot(y, y));
  return {y.x * s, y.y * s, y.z * s, s};
}
// Returns the unit quaternion r after a time dt with the angular velocity u {3}.
template <class T>
Quat<T> turned_quaternion(const Quat<T>& r, const T* u, const T& dt) {
  const T h = T(0.5f) * dt;
  const Quat<T> turned = math::multiply(cayley(Vec3<T>{h * u[0], h * u[1], h * u[2]}), r);
  return scaled(turned, T(1.0f) / quat_length(turned));
}
template <class T>
void store(const Quat<T>& q, T* to) {
  to[0] = q.x;
  to[1] = q.y;
  to[2] = q.z;
  to[3] = q.w;
}
template <class T>
void store(const Vec3<T>& v, T* to) {
  to[0] = v.x;
  to[1] = v.y;
  to[2] = v.z;
}
// The adjoint of turned_quaternion. Converts the gradient h by the new tangent to that by the old
// tangent in place, and adds the gradient by u to g.
template <class T>
void turned_quaternion_vjp(const T* u, const T& dt, T* h, T* g) {
  const T half = T(0.5f) * dt;
  const Vec3<T> y = {half * u[0], half * u[1], half * u[2]};
  const Vec3<T> ha = {h[0], h[1], h[2]};
  const Vec3<T> gu = (ha - math::cross(y, ha)) * (dt / (T(1.0f) + math::dot(y, y)));
  const Vec3<T> back = math::rotate_inverse(cayley(y), ha);
  const T add[3] = {gu.x, gu.y, gu.z}, keep[3] = {back.x, back.y, back.z};
  for (int k = 0; k < 3; ++k) {
    g[k] = g[k] + add[k];
    h[k] = keep[k];
  }
}

}  // namespace novaphy::articulation
