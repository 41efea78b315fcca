// Dual: a scalar (a float or SIMD lanes of floats) with its derivative along one direction. A
// formula template runs with Dual unchanged. Comparisons use the values alone, so the formula takes
// the same branches. Conventions, as in tools/vbd_adjoints/symbol.h: sqrt has the derivative 0 at
// 0. For equal arguments, max and min have the derivative of the first argument.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/types.h"

#ifndef NOVAPHY_LANE_FN  // qualifiers of functions on floats
#define NOVAPHY_LANE_FN inline
#endif

namespace novaphy::math {

template <class S>
struct Dual {
  using Mask = decltype(S() < S());
  S v{}, d{};

  Dual() = default;
  template <class Value>
  explicit Dual(Value value) : v(value) {}  // also converts from a float
  Dual(S value, S tangent) : v(value), d(tangent) {}

  NOVAPHY_LANE_FN friend Dual operator+(const Dual& a, const Dual& b) {
    return {a.v + b.v, a.d + b.d};
  }
  NOVAPHY_LANE_FN friend Dual operator-(const Dual& a, const Dual& b) {
    return {a.v - b.v, a.d - b.d};
  }
  NOVAPHY_LANE_FN friend Dual operator*(const Dual& a, const Dual& b) {
    return {a.v * b.v, a.d * b.v + b.d * a.v};
  }
  NOVAPHY_LANE_FN friend Dual operator/(const Dual& a, const Dual& b) {
    const S inverse = S(1.0f) / b.v, quotient = a.v / b.v;
    return {quotient, a.d * inverse - b.d * (quotient * inverse)};
  }
  NOVAPHY_LANE_FN friend Dual operator-(const Dual& a) { return {-a.v, -a.d}; }
  NOVAPHY_LANE_FN friend Mask operator<(const Dual& a, const Dual& b) { return a.v < b.v; }
  NOVAPHY_LANE_FN friend Mask operator>(const Dual& a, const Dual& b) { return a.v > b.v; }
  NOVAPHY_LANE_FN friend Mask operator>=(const Dual& a, const Dual& b) { return a.v >= b.v; }
  NOVAPHY_LANE_FN friend Dual select(Mask c, const Dual& a, const Dual& b) {
    using math::select;
    return {select(c, a.v, b.v), select(c, a.d, b.d)};
  }
  NOVAPHY_LANE_FN friend Dual min(const Dual& a, const Dual& b) { return select(a.v <= b.v, a, b); }
  NOVAPHY_LANE_FN friend Dual max(const Dual& a, const Dual& b) { return select(a.v >= b.v, a, b); }
  friend Dual sqrt(const Dual& a) {
    using math::select;
    using math::sqrt;
    const S root = sqrt(a.v), zero{};
    return {root, a.d * select(root > zero, S(0.5f) / root, zero)};
  }
  friend Dual sin(const Dual& a) {
    const auto of = math::functions_detail::sin_cos(a.v);
    return {of.sin, a.d * of.cos};
  }
  friend Dual cos(const Dual& a) {
    const auto of = math::functions_detail::sin_cos(a.v);
    return {of.cos, -(a.d * of.sin)};
  }
  friend Dual fma(const Dual& a, const Dual& b, const Dual& c) {
    using math::fma;
    return {fma(a.v, b.v, c.v), (a.d * b.v + b.d * a.v) + c.d};
  }
  friend Dual atan2(const Dual& y, const Dual& x) {
    const auto angle = math::functions_detail::atan2_value(y.v, x.v);
    return {angle.value, y.d * angle.dy + x.d * angle.dx};
  }
};

template <class S>
Vec3<Dual<S>> with_tangent(const Vec3<S>& value, const Vec3<S>& tangent) {
  return {{value.x, tangent.x}, {value.y, tangent.y}, {value.z, tangent.z}};
}
template <class S>
Vec3<S> value_of(const Vec3<Dual<S>>& a) {
  return {a.x.v, a.y.v, a.z.v};
}
template <class S>
Vec3<S> tangent_of(const Vec3<Dual<S>>& a) {
  return {a.x.d, a.y.d, a.z.d};
}

}  // namespace novaphy::math
