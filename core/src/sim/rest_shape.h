// The rest shape of an element: the inverse of the matrix of its edges, and its size.
//
// Differences of positions are float32. Determinant and inverse are computed in double (elimination
// with partial pivoting) and rounded once. NumPy calls in Newton 1.8.0 do the same, so the model
// arrays have the same bits.
#pragma once

#include <string_view>

#include "novaphy/math/types.h"

namespace novaphy {
class Model;
}

namespace novaphy::detail {

// An element whose size relative to its longest edge is below this value is degenerate.
inline constexpr double kSmallestRelativeSize = 1e-7;

struct TriangleRest {
  Mat22f pose;      // inverse of the columns q - p, r - p in the basis e1 = unit(q - p), e2 =
                    // unit(cross(normal, e1)); zero for a degenerate triangle
  float area;       // m^2
  double relative;  // area / longest edge^2, from the positions in double; NaN for NaN positions
};
TriangleRest triangle_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r);

struct TetrahedronRest {
  Mat33f pose;      // inverse of the columns q - p, r - p, s - p
  float volume;     // m^3, < 0 for an inverted tetrahedron
  double relative;  // volume / longest edge^3
};
TetrahedronRest tetrahedron_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r, const Vec3f& s);

// Checks k_lambda of all tetrahedra of a model: >= 0, or with Lame parameters a bulk modulus >= 0
// up to rounding. ErrorKind::Value names the solver and the row.
void check_elasticity(std::string_view solver, const Model& model);

}  // namespace novaphy::detail
