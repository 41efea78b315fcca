// The rest shapes of elements, as they are stored: the inverse of the matrix of edges, and the
// size.
//
// The differences of positions are float32; determinant and inverse are taken in double
// (elimination with partial pivoting) and rounded once. These are the numerics of Newton 1.8.0,
// whose NumPy calls do the same; the bits of its model arrays follow.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::detail {

// Below this the size of an element, relative to its longest edge, is no size.
inline constexpr double kSmallestRelativeSize = 1e-7;

struct TriangleRest {
  Mat22f pose;      // inverse of the columns q - p, r - p in the basis e1 = unit(q - p),
                    // e2 = unit(cross(normal, e1)); all zero where there is none
  float area;       // m^2
  double relative;  // area / longest edge^2, from the positions in double; NaN for NaN positions
};
TriangleRest triangle_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r);

struct TetrahedronRest {
  Mat33f pose;      // inverse of the columns q - p, r - p, s - p
  float volume;     // m^3, < 0 for an inverted one
  double relative;  // volume / longest edge^3
};
TetrahedronRest tetrahedron_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r, const Vec3f& s);

}  // namespace novaphy::detail
