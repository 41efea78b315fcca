// Dual numbers: a value and its derivative along one direction. With dual numbers as scalar, the
// tree algorithms (tree.h) compute tangents. Comparisons use the values, so the branches are those
// of the computation without tangents.
#pragma once

#include "novaphy/dynamics/articulation/scalar.h"
#include "novaphy/math/types.h"

namespace novaphy::articulation {

template <class T>
struct Dual {
  T value{}, tangent{};
  Dual() = default;
  constexpr Dual(T v) : value(v) {}  // constant: tangent 0
  constexpr Dual(T v, T t) : value(v), tangent(t) {}
};

template <class T>
Dual<T> operator+(const Dual<T>& a, const Dual<T>& b) {
  return {a.value + b.value, a.tangent + b.tangent};
}
template <class T>
Dual<T> operator-(const Dual<T>& a, const Dual<T>& b) {
  return {a.value - b.value, a.tangent - b.tangent};
}
template <class T>
Dual<T> operator-(const Dual<T>& a) {
  return {-a.value, -a.tangent};
}
template <class T>
Dual<T> operator*(const Dual<T>& a, const Dual<T>& b) {
  return {a.value * b.value, a.tangent * b.value + a.value * b.tangent};
}
template <class T>
Dual<T> operator/(const Dual<T>& a, const Dual<T>& b) {
  const T q = a.value / b.value;
  return {q, (a.tangent - q * b.tangent) / b.value};
}
template <class T>
bool operator<(const Dual<T>& a, const Dual<T>& b) {
  return a.value < b.value;
}
template <class T>
bool operator>(const Dual<T>& a, const Dual<T>& b) {
  return a.value > b.value;
}
template <class T>
Dual<T> square_root(const Dual<T>& a) {
  const T r = square_root(a.value);
  return {r, a.tangent / (r + r)};
}
template <class T>
SinCos<Dual<T>> sin_cos(const Dual<T>& a) {
  const SinCos<T> v = sin_cos(a.value);
  return {{v.sin, v.cos * a.tangent}, {v.cos, -(v.sin * a.tangent)}};
}
template <class T>
Dual<T> angle_of(const Dual<T>& sine, const Dual<T>& cosine) {
  const T norm = sine.value * sine.value + cosine.value * cosine.value;
  return {angle_of(sine.value, cosine.value),
          (cosine.value * sine.tangent - sine.value * cosine.tangent) / norm};
}
template <class T>
bool is_finite(const Dual<T>& a) {
  return is_finite(a.value);
}

using DualFloat = Dual<float>;
inline Vec3<DualFloat> constant(const Vec3f& v) { return {v.x, v.y, v.z}; }
inline Quat<DualFloat> constant(const Quatf& q) { return {q.x, q.y, q.z, q.w}; }

}  // namespace novaphy::articulation
