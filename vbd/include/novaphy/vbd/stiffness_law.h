// The stiffness between two particles of an element: a 3x3 matrix, built as a sum of simple parts.
//
// An element of VBD has the energy E. Its stiffness between the corners k and l is the block H_kl
// of a matrix H over all corners. H is positive semidefinite everywhere. H equals the second
// derivative of E where that is positive semidefinite. H_kk may be smaller than the block of a
// sweep (block_law.h), because H has no stiffness against a rotation of the whole element.
//
// Freestanding: T = float, lanes of floats, or a scalar of a test.
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

// Adds to H: s I, s a b^T, or the matrix [v] with d.([v] e) = v.(d x e).
template <class T>
void add_identity(Mat33<T>& h, const T& s) {
  for (int r = 0; r < 3; ++r) h.m[r][r] = h.m[r][r] + s;
}
template <class T>
void add_outer(Mat33<T>& h, const T& s, const Vec3<T>& a, const Vec3<T>& b) {
  const Vec3<T> sa = a * s;
  const T rows[3] = {sa.x, sa.y, sa.z}, columns[3] = {b.x, b.y, b.z};
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) h.m[r][c] = h.m[r][c] + rows[r] * columns[c];
}
template <class T>
void add_turn(Mat33<T>& h, const Vec3<T>& v) {
  h.m[0][1] = h.m[0][1] + v.z;
  h.m[1][0] = h.m[1][0] - v.z;
  h.m[0][2] = h.m[0][2] - v.y;
  h.m[2][0] = h.m[2][0] + v.y;
  h.m[1][2] = h.m[1][2] + v.x;
  h.m[2][1] = h.m[2][1] - v.x;
}

}  // namespace novaphy::vbd
