// Nearest points of two segments. The parameter s of the first segment is clamped, and gives the
// parameter t of the second. If t was clamped, s is no longer the nearest parameter. The code
// therefore computes s from t, and t from s, once more. Source: C. Ericson, Real-Time Collision
// Detection (2005), 5.1.9.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::geometry {

struct SegmentPoints {
  Vec3f a{}, b{};
  float s{}, t{};  // a = a0 + s (a1 - a0), b = b0 + t (b1 - b0)
};

inline float nearest_parameter(const Vec3f& p, const Vec3f& begin, const Vec3f& edge) {
  const float square = math::dot(edge, edge);
  return square > 0.0f ? math::clamp(math::dot(p - begin, edge) / square, 0.0f, 1.0f) : 0.0f;
}

// Returns the nearest points. Parallel segments may have many pairs of nearest points. The function
// then returns one pair.
inline SegmentPoints nearest_of_segments(const Vec3f& a0, const Vec3f& a1, const Vec3f& b0,
                                         const Vec3f& b1) {
  const Vec3f u = a1 - a0, v = b1 - b0, n = math::cross(u, v);
  const float square = math::dot(n, n);
  SegmentPoints r;
  // Parameter s of the common perpendicular, computed by a cross product. The usual denominator u.u
  // v.v - (u.v)^2 would lose half of the digits for nearly parallel segments.
  r.s = square > 0.0f ? math::clamp(math::dot(math::cross(b0 - a0, v), n) / square, 0.0f, 1.0f)
                      : 0.0f;
  r.t = nearest_parameter(a0 + u * r.s, b0, v);
  r.s = nearest_parameter(b0 + v * r.t, a0, u);
  r.t = nearest_parameter(a0 + u * r.s, b0, v);
  r.a = a0 + u * r.s;
  r.b = b0 + v * r.t;
  return r;
}

}  // namespace novaphy::geometry
