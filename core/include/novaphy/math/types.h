// Vectors, matrices, quaternions and transforms, as templates over the scalar (float or
// nova::Real).
//
// Every operator rounds once, from left to right as written, and is not contracted to a fused
// multiply-add. Force formulas therefore have the same bits everywhere. Conventions: quaternions
// are (x, y, z, w) with the Hamilton product and rotate actively. Matrices are row-major. A
// transform is p' = p + rotate(q, v). Spatial vectors have their linear part first.
#pragma once

#include <cstdint>

#include "novaphy/math/scalar.h"

namespace novaphy {

template <class T>
struct Vec2 {
  T x{}, y{};
  bool operator==(const Vec2&) const = default;
};
template <class T>
struct Vec3 {
  T x{}, y{}, z{};
  bool operator==(const Vec3&) const = default;
};
template <class T>
struct Vec4 {
  T x{}, y{}, z{}, w{};
  bool operator==(const Vec4&) const = default;
};
template <class T>
struct Quat {
  T x{}, y{}, z{}, w{};
  static Quat identity() { return {T(0.0f), T(0.0f), T(0.0f), T(1.0f)}; }
  bool operator==(const Quat&) const = default;
};
template <class T>
struct Transform {
  Vec3<T> p{};
  Quat<T> q = Quat<T>::identity();
  static Transform identity() { return {{T(0.0f), T(0.0f), T(0.0f)}, Quat<T>::identity()}; }
  bool operator==(const Transform&) const = default;
};
template <class T>
struct SpatialVector {
  Vec3<T> linear{}, angular{};
  bool operator==(const SpatialVector&) const = default;
};
template <class T>
struct Mat22 {
  T m[2][2]{};
  bool operator==(const Mat22&) const = default;
};
template <class T>
struct Mat33 {
  T m[3][3]{};
  bool operator==(const Mat33&) const = default;
};

using Vec2f = Vec2<float>;
using Vec3f = Vec3<float>;
using Vec4f = Vec4<float>;
using Vec2i = Vec2<int32_t>;
using Vec3i = Vec3<int32_t>;
using Vec4i = Vec4<int32_t>;
using Quatf = Quat<float>;
using Transformf = Transform<float>;
using SpatialVectorf = SpatialVector<float>;
using Mat22f = Mat22<float>;
using Mat33f = Mat33<float>;

template <class T>
Vec3<T> operator+(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
Vec3<T> operator-(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
Vec3<T> operator-(const Vec3<T>& a) {
  return {-a.x, -a.y, -a.z};
}
template <class T>
Vec3<T> operator*(const Vec3<T>& a, const T& s) {
  return {a.x * s, a.y * s, a.z * s};
}
template <class T>
Vec3<T> operator*(const T& s, const Vec3<T>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class T>
Vec3<T> operator/(const Vec3<T>& a, const T& s) {
  return {a.x / s, a.y / s, a.z / s};
}

namespace math {

template <class T>
T dot(const Vec3<T>& a, const Vec3<T>& b) {
  return (a.x * b.x + a.y * b.y) + a.z * b.z;
}
template <class T>
Vec3<T> cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class T>
T length(const Vec3<T>& a) {
  return sqrt(dot(a, a));
}
// Divides each component by the length. The zero vector stays zero and passes no gradient.
template <class T>
Vec3<T> normalize(const Vec3<T>& a) {
  const T l = length(a);
  const auto positive = l > T(0.0f);
  const T zero = T(0.0f);
  return {select(positive, a.x / l, zero), select(positive, a.y / l, zero),
          select(positive, a.z / l, zero)};
}
// Returns y with the derivative dy_dx of each component with respect to the same component of x.
template <class T>
Vec3<T> with_derivative(const Vec3<T>& y, const Vec3<T>& x, const T& dy_dx) {
  return {with_derivative(y.x, x.x, dy_dx), with_derivative(y.y, x.y, dy_dx),
          with_derivative(y.z, x.z, dy_dx)};
}
template <class B, class T>
Vec3<T> select(const B& c, const Vec3<T>& a, const Vec3<T>& b) {
  return {select(c, a.x, b.x), select(c, a.y, b.y), select(c, a.z, b.z)};
}

template <class T>
Quat<T> conjugate(const Quat<T>& q) {
  return {-q.x, -q.y, -q.z, q.w};
}
template <class T>
Quat<T> multiply(const Quat<T>& a, const Quat<T>& b) {
  return {
      a.w * b.x + b.w * a.x + a.y * b.z - b.y * a.z, a.w * b.y + b.w * a.y + a.z * b.x - b.z * a.x,
      a.w * b.z + b.w * a.z + a.x * b.y - b.x * a.y, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}
// Returns p rotated by the unit quaternion (q, w), as p*c + q*d + cross(q, p)*w*2 with c = 2ww - 1
// and d = 2 dot(q, p). The identity rotates exactly.
template <class T>
Vec3<T> rotate(const Quat<T>& q, const Vec3<T>& p) {
  const T c = (T(2.0f) * q.w) * q.w - T(1.0f);
  const T d = T(2.0f) * ((q.x * p.x + q.y * p.y) + q.z * p.z);
  const T two = T(2.0f);
  return {(p.x * c + q.x * d) + ((q.y * p.z - q.z * p.y) * q.w) * two,
          (p.y * c + q.y * d) + ((q.z * p.x - q.x * p.z) * q.w) * two,
          (p.z * c + q.z * d) + ((q.x * p.y - q.y * p.x) * q.w) * two};
}
template <class T>
Vec3<T> rotate_inverse(const Quat<T>& q, const Vec3<T>& p) {
  const T c = (T(2.0f) * q.w) * q.w - T(1.0f);
  const T d = T(2.0f) * ((q.x * p.x + q.y * p.y) + q.z * p.z);
  const T two = T(2.0f);
  return {(p.x * c + q.x * d) - ((q.y * p.z - q.z * p.y) * q.w) * two,
          (p.y * c + q.y * d) - ((q.z * p.x - q.x * p.z) * q.w) * two,
          (p.z * c + q.z * d) - ((q.x * p.y - q.y * p.x) * q.w) * two};
}
template <class T>
Vec3<T> transform_point(const Transform<T>& t, const Vec3<T>& p) {
  return t.p + rotate(t.q, p);
}
template <class T>
Transform<T> multiply(const Transform<T>& a, const Transform<T>& b) {
  return {rotate(a.q, b.p) + a.p, multiply(a.q, b.q)};
}
template <class T>
Transform<T> inverse(const Transform<T>& t) {
  const Quat<T> q = conjugate(t.q);
  return {-rotate(q, t.p), q};
}

}  // namespace math
}  // namespace novaphy
