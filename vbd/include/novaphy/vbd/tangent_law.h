// Tangent: lanes, or a float, with their derivative along one direction. The formulas are
// instantiated with it as they stand. The rules are those of tools/vbd_adjoints/symbol.h.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/types.h"

#ifndef NOVAPHY_LANE_FN  // of floats
#define NOVAPHY_LANE_FN inline
#endif

namespace novaphy::vbd {

template <class Lanes>
struct TangentOf {
  using Tangent = TangentOf;
  using Mask = decltype(Lanes() < Lanes());
  Lanes v{}, d{};

  TangentOf() = default;
  template <class Value>
  explicit TangentOf(Value value) : v(value) {}  // of a float, too
  TangentOf(Lanes value, Lanes slope) : v(value), d(slope) {}

  NOVAPHY_LANE_FN friend Tangent operator+(const Tangent& a, const Tangent& b) {
    return {a.v + b.v, a.d + b.d};
  }
  NOVAPHY_LANE_FN friend Tangent operator-(const Tangent& a, const Tangent& b) {
    return {a.v - b.v, a.d - b.d};
  }
  NOVAPHY_LANE_FN friend Tangent operator*(const Tangent& a, const Tangent& b) {
    return {a.v * b.v, a.d * b.v + b.d * a.v};
  }
  NOVAPHY_LANE_FN friend Tangent operator/(const Tangent& a, const Tangent& b) {
    const Lanes inverse = Lanes(1.0f) / b.v, quotient = a.v / b.v;
    return {quotient, a.d * inverse - b.d * (quotient * inverse)};
  }
  NOVAPHY_LANE_FN friend Tangent operator-(const Tangent& a) { return {-a.v, -a.d}; }
  NOVAPHY_LANE_FN friend Mask operator<(const Tangent& a, const Tangent& b) { return a.v < b.v; }
  NOVAPHY_LANE_FN friend Mask operator>(const Tangent& a, const Tangent& b) { return a.v > b.v; }
  NOVAPHY_LANE_FN friend Mask operator>=(const Tangent& a, const Tangent& b) { return a.v >= b.v; }
  NOVAPHY_LANE_FN friend Tangent select(Mask c, const Tangent& a, const Tangent& b) {
    using math::select;
    return {select(c, a.v, b.v), select(c, a.d, b.d)};
  }
  NOVAPHY_LANE_FN friend Tangent min(const Tangent& a, const Tangent& b) {
    return select(a.v <= b.v, a, b);
  }
  NOVAPHY_LANE_FN friend Tangent max(const Tangent& a, const Tangent& b) {
    return select(a.v >= b.v, a, b);
  }
  friend Tangent sqrt(const Tangent& a) {
    using math::select;
    using math::sqrt;
    const Lanes root = sqrt(a.v), zero{};
    return {root, a.d * select(root > zero, Lanes(0.5f) / root, zero)};
  }
  friend Tangent atan2(const Tangent& y, const Tangent& x) {
    const auto angle = math::functions_detail::atan2_value(y.v, x.v);
    return {angle.value, y.d * angle.dy + x.d * angle.dx};
  }
};

template <class Lanes>
Vec3<TangentOf<Lanes>> with_slope(const Vec3<Lanes>& value, const Vec3<Lanes>& slope) {
  return {{value.x, slope.x}, {value.y, slope.y}, {value.z, slope.z}};
}
template <class Lanes>
Vec3<Lanes> value_of(const Vec3<TangentOf<Lanes>>& a) {
  return {a.x.v, a.y.v, a.z.v};
}
template <class Lanes>
Vec3<Lanes> slope_of(const Vec3<TangentOf<Lanes>>& a) {
  return {a.x.d, a.y.d, a.z.d};
}

}  // namespace novaphy::vbd
