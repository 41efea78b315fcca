// Nearest points of a point and a triangle, or of two segments, as weights of four corners.
//
// The corners x of a pair are a point and the corners a, b, c of a triangle, or the ends a0, a1,
// b0, b1 of two segments. With the weights w, sum w x is the vector from the nearest point of the
// second feature to the nearest point of the first. The weights of the first feature sum to 1,
// those of the second to -1.
//
// Source: C. Ericson, Real-Time Collision Detection (2005), 5.1.5 and 5.1.9.
#pragma once

#include <algorithm>
#include <cmath>

#include "novaphy/math/types.h"

namespace novaphy::geometry {

using Vec3d = Vec3<double>;

struct NearestWeights {
  double weight[4];
  Vec3d apart;      // m
  double distance;  // m
};

inline NearestWeights with_distance(const Vec3d (&x)[4], double w0, double w1, double w2,
                                    double w3) {
  const Vec3d apart = ((x[0] * w0 + x[1] * w1) + x[2] * w2) + x[3] * w3;
  return {{w0, w1, w2, w3}, apart, std::sqrt(math::dot(apart, apart))};
}

// Returns the weights of the point x[0] and the triangle x[1], x[2], x[3].
inline NearestWeights nearest_to_triangle(const Vec3d (&x)[4]) {
  const Vec3d &p = x[0], &a = x[1], &b = x[2], &c = x[3];
  const Vec3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = math::dot(ab, ap), d2 = math::dot(ac, ap);
  if (d1 <= 0.0 && d2 <= 0.0) return with_distance(x, 1.0, -1.0, 0.0, 0.0);
  const double d3 = math::dot(ab, bp), d4 = math::dot(ac, bp);
  if (d3 >= 0.0 && d4 <= d3) return with_distance(x, 1.0, 0.0, -1.0, 0.0);
  const double of_c = d1 * d4 - d3 * d2;
  if (of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3) {
    const double t = d1 / (d1 - d3);
    return with_distance(x, 1.0, t - 1.0, -t, 0.0);
  }
  const double d5 = math::dot(ab, cp), d6 = math::dot(ac, cp);
  if (d6 >= 0.0 && d5 <= d6) return with_distance(x, 1.0, 0.0, 0.0, -1.0);
  const double of_b = d5 * d2 - d1 * d6;
  if (of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
    const double t = d2 / (d2 - d6);
    return with_distance(x, 1.0, t - 1.0, 0.0, -t);
  }
  const double of_a = d3 * d6 - d5 * d4;
  if (of_a <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
    const double t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return with_distance(x, 1.0, 0.0, t - 1.0, -t);
  }
  const double all = (of_a + of_b) + of_c;
  const double ab2 = d1 - d3, ac2 = d2 - d6, bc2 = (d4 - d3) + (d5 - d6);
  if (!(all > 1e-12 * (ab2 * ac2))) {  // without area a triangle is its longest edge
    const auto part = [](double along, double square) {
      return square > 0.0 ? std::min(std::max(along / square, 0.0), 1.0) : 0.0;
    };
    const double t = part(d1, ab2), u = part(d2, ac2), s = part(d4 - d3, bc2);
    if (ab2 >= ac2 && ab2 >= bc2) return with_distance(x, 1.0, t - 1.0, -t, 0.0);
    if (ac2 >= bc2) return with_distance(x, 1.0, u - 1.0, 0.0, -u);
    return with_distance(x, 1.0, 0.0, s - 1.0, -s);
  }
  const double v = of_b / all, w = of_c / all;
  return with_distance(x, 1.0, (v + w) - 1.0, -v, -w);
}

// Returns the weights of the segments x[0], x[1] and x[2], x[3]. Parallel segments may have many
// pairs of nearest points. The function then returns the weights of one pair.
inline NearestWeights nearest_of_edges(const Vec3d (&x)[4]) {
  const auto clamped = [](double along, double square) {
    if (!(along > 0.0) || !(square > 0.0)) return 0.0;
    return along < square ? along / square : 1.0;
  };
  const Vec3d u = x[1] - x[0], v = x[3] - x[2], r = x[2] - x[0], n = math::cross(u, v);
  const double uu = math::dot(u, u), vv = math::dot(v, v);
  double s = clamped(math::dot(math::cross(r, v), n), math::dot(n, n));
  double t = clamped(math::dot(u * s - r, v), vv);
  s = clamped(math::dot(r + v * t, u), uu);
  t = clamped(math::dot(u * s - r, v), vv);
  return with_distance(x, 1.0 - s, s, t - 1.0, -t);
}

// Returns whether the segment from p to q passes through the triangle a, b, c. A segment that
// touches the triangle in its plane or its border does not pass through.
inline bool passes_through(const Vec3d& p, const Vec3d& q, const Vec3d& a, const Vec3d& b,
                           const Vec3d& c) {
  const auto volume = [](const Vec3d& o, const Vec3d& x, const Vec3d& y, const Vec3d& z) {
    return math::dot(math::cross(x - o, y - o), z - o);
  };
  const double of_p = volume(a, b, c, p), of_q = volume(a, b, c, q);
  if (!((of_p > 0.0 && of_q < 0.0) || (of_p < 0.0 && of_q > 0.0))) return false;
  const double ab = volume(p, q, a, b), bc = volume(p, q, b, c), ca = volume(p, q, c, a);
  return (ab > 0.0 && bc > 0.0 && ca > 0.0) || (ab < 0.0 && bc < 0.0 && ca < 0.0);
}

}  // namespace novaphy::geometry
