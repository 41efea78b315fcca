// M = L^T D L of a matrix with a tree's sparsity (Featherstone 2008, section 6.5): rows are
// eliminated from the leaves, so L has entries only where M has, and no fill-in. With followers
// (mimic.h) M stands for T^T M T, and M^-1 for T (T^T M T)^-1 T^T.
#pragma once

#include "novaphy/dynamics/articulation/mimic.h"

namespace novaphy::articulation {

// In place, of what mass_matrix wrote: L below the diagonal (its own is 1), D on it. The index of
// the first dof from the leaves whose pivot is not positive (in any lane), or -1; there it stops.
template <class T>
int32_t factor(const Tree<T>& tree, T* m) {
  if (tree.followers > 0) return factor_whole(tree, m);
  const int64_t n = tree.dof_count;
  for (int32_t k = tree.dof_count; k-- > 0;) {
    T* const row = m + k * n;
    if (!all(row[k] > T(0.0f))) return k;
    const T inverse = T(1.0f) / row[k];
    for (int32_t i = tree.dof_parent[k]; i >= 0; i = tree.dof_parent[i]) {
      const T a = row[i] * inverse;
      for (int32_t j = i; j >= 0; j = tree.dof_parent[j]) m[i * n + j] = m[i * n + j] - a * row[j];
      row[i] = a;
    }
  }
  return -1;
}

// x of M x = b, in place.
template <class T>
void solve(const Tree<T>& tree, const T* m, T* x) {
  if (tree.followers > 0) return solve_whole(tree, m, x);
  const int64_t n = tree.dof_count;
  for (int32_t k = tree.dof_count; k-- > 0;)
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j])
      x[j] = x[j] - m[k * n + j] * x[k];
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    x[k] = x[k] / m[k * n + k];
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j])
      x[k] = x[k] - m[k * n + j] * x[j];
  }
}

// y = M x of what mass_matrix wrote.
template <class T>
void apply_matrix(const Tree<T>& tree, const T* m, const T* x, T* y) {
  const int64_t n = tree.dof_count;
  for (int32_t k = 0; k < tree.dof_count; ++k) y[k] = m[k * n + k] * x[k];
  for (int32_t k = 0; k < tree.dof_count; ++k)
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j]) {
      y[k] = y[k] + m[k * n + j] * x[j];
      y[j] = y[j] + m[k * n + j] * x[k];
    }
}

}  // namespace novaphy::articulation
