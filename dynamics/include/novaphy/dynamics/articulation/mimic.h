// Links whose joint follows that of another one (URDF's mimic): q_f = multiplier q_l + offset, of
// joints with one dof. With the constant T of qd = T qd_reduced a step moves
//   T^T M T qdd_reduced = T^T f,   qdd = T qdd_reduced
// so M^-1 becomes the symmetric T (T^T M T)^-1 T^T in every formula (contacts, adjoints,
// derivatives), and nothing else changes. A mimic joint's coordinates are written from the leader's
// at the end of a step; at its start they are read as they stand. Mimic joints join branches, so
// the matrix is factored whole, without the tree's sparsity. Source: Featherstone, Rigid Body
// Dynamics Algorithms (2008), section 3.4 (implicit constraints made explicit).
#pragma once

#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

inline bool follows(const Link& link) { return link.leader >= 0; }

// f(mimic joint's dof, leader's dof, multiplier) for each mimic joint; dofs among the tree's.
template <class T, class F>
void for_mimics(const Tree<T>& tree, F&& f) {
  if (tree.mimics == 0) return;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (follows(link))
      f(local_dof(tree, link), local_dof(tree, tree.links[link.leader]), T(link.multiplier));
  }
}

// x = T^T x: numbers of dofs that act (forces, gradients).
template <class T>
void gather_mimics(const Tree<T>& tree, T* x) {
  for_mimics(tree, [x](int32_t mimic, int32_t leader, const T& multiplier) {
    x[leader] = x[leader] + multiplier * x[mimic];
    x[mimic] = T(0.0f);
  });
}
// x = T x: numbers of dofs that move (rates, accelerations).
template <class T>
void spread_leaders(const Tree<T>& tree, T* x) {
  for_mimics(tree, [x](int32_t mimic, int32_t leader, const T& multiplier) {
    x[mimic] = multiplier * x[leader];
  });
}

// A new state's coordinates and rates of mimic joints; rows of the arrays.
template <class T>
void follow(const Tree<T>& tree, T* q, T* qd) {
  if (tree.mimics == 0) return;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (!follows(link)) continue;
    const Link& leader = tree.links[link.leader];
    q[link.coord] = T(link.multiplier) * q[leader.coord] + T(link.offset);
    qd[link.dof] = T(link.multiplier) * qd[leader.dof];
  }
}

// T^T M T in place of what mass_matrix wrote, with 1 on the diagonal of mimic joints.
template <class T>
void reduce_matrix(const Tree<T>& tree, T* m) {
  const int64_t n = tree.dof_count;
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    int32_t above = tree.dof_parent[k];
    for (int32_t j = k; j-- > 0;)
      if (j == above)
        above = tree.dof_parent[j];
      else
        m[k * n + j] = T(0.0f);
  }
  for_mimics(tree, [m, n](int32_t f, int32_t l, const T& multiplier) {
    const auto at = [m, n](int64_t a, int64_t b) -> T& {
      return a > b ? m[a * n + b] : m[b * n + a];
    };
    at(l, l) = at(l, l) + multiplier * (at(f, l) + at(f, l) + multiplier * at(f, f));
    for (int32_t k = 0; k < static_cast<int32_t>(n); ++k) {
      if (k == f) continue;
      if (k != l) at(l, k) = at(l, k) + multiplier * at(f, k);
      at(f, k) = T(0.0f);
    }
    at(f, f) = T(1.0f);
  });
}

}  // namespace novaphy::articulation
