// The stiffness (N/m) between two particles of an element: a 3x3 matrix.
//
// An element of VBD with the energy E has a stiffness matrix H over all its corners. The stiffness
// between the corners k and l is the 3x3 block H_kl. H is positive semidefinite everywhere. H
// equals the second derivative of E where this derivative is positive semidefinite. H_kk may be
// smaller than the matrix that a sweep solves with (block_law.h), because H does not resist a
// rotation of the whole element.
//
// Freestanding (no standard headers). T is a float, SIMD lanes of floats, or a scalar of a test.
#pragma once

#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

template <class T>
Mat33<T> stiffness_matrix(const Block<T>& b) {
  return {{{b.h00, b.h01, b.h02}, {b.h01, b.h11, b.h12}, {b.h02, b.h12, b.h22}}};
}
template <class T>
void add_to(Mat33<T>& sum, const Mat33<T>& h) {
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) sum.m[r][c] = sum.m[r][c] + h.m[r][c];
}

// Returns the outer product a b^T.
template <class T>
Mat33<T> outer_product(const Vec3<T>& a, const Vec3<T>& b) {
  return {{{a.x * b.x, a.x * b.y, a.x * b.z},
           {a.y * b.x, a.y * b.y, a.y * b.z},
           {a.z * b.x, a.z * b.y, a.z * b.z}}};
}

}  // namespace novaphy::vbd
