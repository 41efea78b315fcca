// Tangent: lanes with their derivative along one direction. The formulas are instantiated with it
// as they stand. The rules are those of tools/vbd_adjoints/symbol.h.
#pragma once

#include "lanes.h"
#include "novaphy/math/functions.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

struct Tangent {
  Lanes v{}, d{};

  Tangent() = default;
  explicit Tangent(float value) : v(value) {}
  explicit Tangent(Lanes value) : v(value) {}
  Tangent(Lanes value, Lanes slope) : v(value), d(slope) {}

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
    return {select(c, a.v, b.v), select(c, a.d, b.d)};
  }
  NOVAPHY_LANE_FN friend Tangent min(const Tangent& a, const Tangent& b) {
    return select(a.v <= b.v, a, b);
  }
  NOVAPHY_LANE_FN friend Tangent max(const Tangent& a, const Tangent& b) {
    return select(a.v >= b.v, a, b);
  }
  friend Tangent sqrt(const Tangent& a) {
    const Lanes root = sqrt(a.v), zero;
    return {root, a.d * select(root > zero, Lanes(0.5f) / root, zero)};
  }
  friend Tangent atan2(const Tangent& y, const Tangent& x) {
    const auto angle = math::functions_detail::atan2_value(y.v, x.v);
    return {angle.value, y.d * angle.dy + x.d * angle.dx};
  }
};

inline Vec3<Tangent> with_slope(const Vec3<Lanes>& value, const Vec3<Lanes>& slope) {
  return {{value.x, slope.x}, {value.y, slope.y}, {value.z, slope.z}};
}
inline Vec3<Lanes> value_of(const Vec3<Tangent>& a) { return {a.x.v, a.y.v, a.z.v}; }
inline Vec3<Lanes> slope_of(const Vec3<Tangent>& a) { return {a.x.d, a.y.d, a.z.d}; }

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
