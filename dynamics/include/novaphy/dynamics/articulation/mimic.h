// Mimic joints (URDF): q_m = multiplier q_l + offset for joints with one dof, where q_m belongs to
// the mimic joint and q_l to its leader. With the constant matrix T of qd = T qd_reduced, a step
// solves
//   T^T M T qdd_reduced = T^T f,   qdd = T qdd_reduced
// so M^-1 becomes the symmetric matrix T (T^T M T)^-1 T^T in every formula (contacts, adjoints,
// derivatives), and nothing else changes. At the end of a step the coordinates of mimic joints are
// computed from their leaders. At the start of a step they are read unchanged. Mimic joints couple
// branches of the tree, so the matrix is factored without the tree's sparsity.
// Source: Featherstone, Rigid Body Dynamics Algorithms (2008), section 3.4 (explicit form of
// implicit constraints).
#pragma once

#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

inline bool follows(const Link& link) { return link.leader >= 0; }

// Calls f(mimic joint's dof, leader's dof, multiplier) for each mimic joint. Dofs are counted from
// the tree's first dof.
template <class T, class F>
void for_mimics(const Tree<T>& tree, F&& f) {
  if (tree.mimics == 0) return;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (follows(link))
      f(local_dof(tree, link), local_dof(tree, tree.links[link.leader]), T(link.multiplier));
  }
}

// Computes T^T x in place, for forces and gradients.
template <class T>
void gather_mimics(const Tree<T>& tree, T* x) {
  for_mimics(tree, [x](int32_t mimic, int32_t leader, const T& multiplier) {
    x[leader] = x[leader] + multiplier * x[mimic];
    x[mimic] = T(0.0f);
  });
}
// Computes T x in place, for rates and accelerations.
template <class T>
void spread_leaders(const Tree<T>& tree, T* x) {
  for_mimics(tree, [x](int32_t mimic, int32_t leader, const T& multiplier) {
    x[mimic] = multiplier * x[leader];
  });
}

// Writes the coordinates and rates of mimic joints in a new state (indexed as in the model's
// arrays).
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

// Replaces the mass matrix m by T^T M T, with 1 on the diagonal of mimic joints.
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
