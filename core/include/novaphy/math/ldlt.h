// Factorization A = L D L^T of small symmetric matrices of a fixed size, as a template over the
// scalar like types.h. The code has no branch, no allocation and no pivoting. A positive definite
// A, such as an inertia, needs no pivoting (Golub and Van Loan, Matrix Computations, section 4.2).
#pragma once

#include "novaphy/math/scalar.h"

namespace novaphy::math {

template <class T, int N>
struct Ldlt {
  T l[N][N]{};  // L below the diagonal; the diagonal of L is 1
  T d[N]{};     // all > 0 if and only if A is positive definite, which `solve` needs
  T reciprocal[N]{};  // 1 / d
};

// Factors A. Only its entries on and below the diagonal are read. Rows are computed in order; each
// entry subtracts its terms in ascending order.
template <int N, class T>
Ldlt<T, N> ldlt(const T (&a)[N][N]) {
  Ldlt<T, N> f;
  for (int i = 0; i < N; ++i) {
    T d = a[i][i];
    for (int j = 0; j < i; ++j) {
      T scaled = a[i][j];  // L_ij d_j
      for (int k = 0; k < j; ++k) scaled = scaled - (f.l[i][k] * f.d[k]) * f.l[j][k];
      f.l[i][j] = scaled * f.reciprocal[j];
      d = d - f.l[i][j] * scaled;
    }
    f.d[i] = d;
    f.reciprocal[i] = T(1.0f) / d;
  }
  return f;
}

// Solves A x = b: forward substitution with L, division by D, backward substitution with L^T.
template <int N, class T>
void solve(const Ldlt<T, N>& f, const T (&b)[N], T (&x)[N]) {
  for (int i = 0; i < N; ++i) {
    x[i] = b[i];
    for (int k = 0; k < i; ++k) x[i] = x[i] - f.l[i][k] * x[k];
  }
  for (int i = N; i-- > 0;) {
    x[i] = x[i] * f.reciprocal[i];
    for (int k = i + 1; k < N; ++k) x[i] = x[i] - f.l[k][i] * x[k];
  }
}

}  // namespace novaphy::math
