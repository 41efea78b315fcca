// Products, determinants and columns of small matrices, as templates over the scalar like types.h.
//
// A product of two matrices is a chain of explicit fused multiply-adds per entry,
//   fma(a_i2, b_2j, fma(a_i1, b_1j, a_i0 b_0j)),
// so every device rounds in the same places. Products with vectors and determinants are not fused.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::math {

template <class T>
Mat33<T> from_columns(const Vec3<T>& a, const Vec3<T>& b, const Vec3<T>& c) {
  return {{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}};
}
template <class T>
Vec3<T> column(const Mat33<T>& a, int j) {
  return {a.m[0][j], a.m[1][j], a.m[2][j]};
}
template <class T>
Vec3<T> row(const Mat33<T>& a, int i) {
  return {a.m[i][0], a.m[i][1], a.m[i][2]};
}

template <class T>
Mat33<T> transpose(const Mat33<T>& a) {
  return from_columns(row(a, 0), row(a, 1), row(a, 2));
}
template <class T>
Mat33<T> add(const Mat33<T>& a, const Mat33<T>& b) {
  Mat33<T> sum;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum.m[i][j] = a.m[i][j] + b.m[i][j];
  return sum;
}
template <class T>
Mat33<T> scale(const Mat33<T>& a, const T& s) {
  Mat33<T> scaled;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) scaled.m[i][j] = a.m[i][j] * s;
  return scaled;
}
template <class T>
Mat33<T> multiply(const Mat33<T>& a, const Mat33<T>& b) {
  Mat33<T> product;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      product.m[i][j] = fma(a.m[i][2], b.m[2][j], fma(a.m[i][1], b.m[1][j], a.m[i][0] * b.m[0][j]));
  return product;
}

// Returns the product of a and v, rounded as (column 0 * x + column 1 * y) + column 2 * z.
template <class T>
Vec3<T> multiply(const Mat33<T>& a, const Vec3<T>& v) {
  return {(a.m[0][0] * v.x + a.m[0][1] * v.y) + a.m[0][2] * v.z,
          (a.m[1][0] * v.x + a.m[1][1] * v.y) + a.m[1][2] * v.z,
          (a.m[2][0] * v.x + a.m[2][1] * v.y) + a.m[2][2] * v.z};
}

template <class T>
T determinant(const Mat22<T>& a) {
  return a.m[0][0] * a.m[1][1] - a.m[0][1] * a.m[1][0];
}
template <class T>
T determinant(const Mat33<T>& a) {
  return dot(row(a, 0), cross(row(a, 1), row(a, 2)));
}

}  // namespace novaphy::math
