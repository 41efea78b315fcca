// The inverse of a tree's mass matrix M = H(q) + diag(ws.diagonal) + c c^T for each BALL joint,
// where c are the joint's entries of ws.cone. Two factorizations exist. The tree alone selects one
// of them:
//
//   M = L^T D L of a matrix with a tree's sparsity (Featherstone 2008, section 6.5). Rows are
//   eliminated from the leaves, so L has entries only where M has entries, without fill-in. With
//   mimic joints (mimic.h), M stands for T^T M T and M^-1 for T (T^T M T)^-1 T^T, and rows are
//   full.
//
//   Articulated bodies (articulated_body.h), for trees with more than kMatrixJoints joints in a
//   row, because float cannot represent the mass matrix of a long chain. c is then 0.
#pragma once

#include "novaphy/dynamics/articulation/articulated_body.h"
#include "novaphy/dynamics/articulation/inverse_dynamics.h"
#include "novaphy/dynamics/articulation/mimic.h"

namespace novaphy::articulation {

template <class T>
bool has_matrix([[maybe_unused]] const Tree<T>& tree) {
#ifdef NOVAPHY_MATRIX_TREES
  return true;
#else
  return tree.mimics > 0 || tree.joints_in_a_row <= kMatrixJoints;
#endif
}
// Returns whether a solve may skip dofs that the sparse factor does not couple.
template <class T>
bool is_sparse(const Tree<T>& tree) {
  return tree.mimics == 0 && has_matrix(tree);
}
// Calls f(above), where above(k) is the next row towards the root in which row k of L has an entry;
// -1: none.
template <class T, class F>
auto with_rows_above(const Tree<T>& tree, const F& f) {
  if (tree.mimics > 0) return f([](int32_t k) { return k - 1; });
  return f([above = tree.dof_parent](int32_t k) { return above[k]; });
}

template <class T>
void add_cones(const Tree<T>& tree, Workspace<T>& ws) {
  const int64_t n = tree.dof_count;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    if (!is_ball(tree.links[i])) continue;
    const int32_t first = local_dof(tree, tree.links[i]);
    for (int64_t k = first; k < first + 3; ++k)
      for (int64_t j = first; j <= k; ++j) {
        T& entry = ws.matrix[k * n + j];
        entry = entry + ws.cone[k] * ws.cone[j];
      }
  }
}

// Factors M after kinematics at q (indexed as in the model's arrays). ws.matrix gets L below the
// diagonal (its diagonal is 1) and D on the diagonal, or the data of articulated bodies. Returns
// the first dof, counted from the leaves, whose pivot is not positive (in any lane), or -1. The
// factorization stops at that dof.
template <class T>
int32_t factor(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  if (!has_matrix(tree)) return factor_links(tree, q, ws);
  mass_matrix(tree, ws);
  const int64_t n = tree.dof_count;
  T* const m = ws.matrix;
  for (int64_t k = 0; k < n; ++k) m[k * n + k] = m[k * n + k] + ws.diagonal[k];
  add_cones(tree, ws);
  if (tree.mimics > 0) reduce_matrix(tree, m);
  return with_rows_above(tree, [&](const auto& above) -> int32_t {
    for (int32_t k = tree.dof_count; k-- > 0;) {
      T* const row = m + k * n;
      if (!all(row[k] > T(0.0f))) return k;
      const T inverse = T(1.0f) / row[k];
      for (int32_t i = above(k); i >= 0; i = above(i)) {
        const T a = row[i] * inverse;
        for (int32_t j = i; j >= 0; j = above(j)) m[i * n + j] = m[i * n + j] - a * row[j];
        row[i] = a;
      }
    }
    return -1;
  });
}

// Solves M x = b in place.
template <class T>
void solve(const Tree<T>& tree, const Workspace<T>& ws, T* x) {
  if (!has_matrix(tree)) return solve_links(tree, ws, x);
  const int64_t n = tree.dof_count;
  const T* const m = ws.matrix;
  gather_mimics(tree, x);
  with_rows_above(tree, [&](const auto& above) {
    for (int32_t k = tree.dof_count; k-- > 0;)
      for (int32_t j = above(k); j >= 0; j = above(j)) x[j] = x[j] - m[k * n + j] * x[k];
    for (int32_t k = 0; k < tree.dof_count; ++k) {
      x[k] = x[k] / m[k * n + k];
      for (int32_t j = above(k); j >= 0; j = above(j)) x[k] = x[k] - m[k * n + j] * x[j];
    }
  });
  spread_leaders(tree, x);
}

// Computes ws.bias = ID(q, qd, 0), indexed by the tree's dofs, and the links' motions. For
// articulated bodies the bias is 0, because find_accelerations includes it.
template <class T>
void bias_forces(const Tree<T>& tree, const T* qd, Workspace<T>& ws) {
  if (has_matrix(tree)) return inverse_dynamics<T>(tree, qd, nullptr, ws, ws.bias);
  link_motions(tree, qd, ws);
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.bias[k] = T(0.0f);
}
// Computes ws.qdd = M^-1 (ws.rhs - ws.bias), after `factor`. With articulated bodies, a dof with
// infinite diagonal keeps its qdd, and its descendants move with it.
template <class T>
void find_accelerations(const Tree<T>& tree, const T* qd, Workspace<T>& ws) {
  if (!has_matrix(tree)) return accelerate_links(tree, qd, ws);
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.qdd[k] = ws.rhs[k];
  solve(tree, ws, ws.qdd);
}

}  // namespace novaphy::articulation
