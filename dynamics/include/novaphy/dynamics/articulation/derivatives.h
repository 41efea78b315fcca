// Analytic derivative matrices of inverse and forward dynamics.
//
// All quantities are about the origin O, in world axes. Y (inertia), B and F (force) are sums over
// a link and its descendants. The vectors v and a are the motion and acceleration of link i, v_p is
// the motion of its parent. For a dof k of joint i
//   psi = v x S_k,   psi' = a x S_k + v x psi,   sigma = v_p x S_k + v x S_k
// (for a FREE joint, sigma has the additional term (R e_k x omega, 0) for linear dofs and (v_rel x
// R e_k, 0) for angular dofs):
//   d tau_r / d q_k  = S_r . (Y psi' + B psi + S_k x* F)   for r of joint i or nearer to the root
//                    = S_r . (Y_j psi' + B_j psi)          for r of a descendant joint j
//   d tau_r / d qd_k = S_r . (Y sigma + B S_k), and with Y_j, B_j for a descendant joint j.
// B m = v x* Y m - Y (v x m) + m x* Y v does not depend on the linear part of m:
//   (-2 P x m_w,  (2 (v.h) 1 - 2 v h^T + 2 [w] I - tr(I) [w]) m_w)
// with the momentum P = m v + w x h of the link. B has 12 numbers, which can be summed over links.
// The row of a descendant joint is (Y_j S_r) . psi' + (B_j^T S_r) . psi, whose factors are the same
// for all columns k.
// Source: Carpentier and Mansard, Analytical derivatives of rigid body dynamics algorithms (RSS
// 2018), for columns of S that are fixed in the parent.
#pragma once

#include "novaphy/dynamics/articulation/factor.h"
#include "novaphy/math/matrix.h"

namespace novaphy::articulation {

template <class T>
struct MotionBias {
  Vec3<T> momentum{};  // P
  Mat33<T> angular{};
};
template <class T>
MotionBias<T> motion_bias(const SpatialInertia<T>& y, const SpatialVector<T>& v) {
  const Vec3<T>&l = v.linear, w = v.angular, h = y.moment;
  const T two = T(2.0f);
  const T trace = (y.xx + y.yy) + y.zz, d = two * math::dot(l, h);
  // [w] I, column by column: w x (column of I).
  const Vec3<T> cx = math::cross(w, {y.xx, y.xy, y.xz}), cy = math::cross(w, {y.xy, y.yy, y.yz}),
                cz = math::cross(w, {y.xz, y.yz, y.zz});
  return {l * y.mass + math::cross(w, h),
          {{{d + two * (cx.x - l.x * h.x), two * (cy.x - l.x * h.y) + trace * w.z,
             two * (cz.x - l.x * h.z) - trace * w.y},
            {two * (cx.y - l.y * h.x) - trace * w.z, d + two * (cy.y - l.y * h.y),
             two * (cz.y - l.y * h.z) + trace * w.x},
            {two * (cx.z - l.z * h.x) + trace * w.y, two * (cy.z - l.z * h.y) - trace * w.x,
             d + two * (cz.z - l.z * h.z)}}}};
}
template <class T>
MotionBias<T> operator+(const MotionBias<T>& a, const MotionBias<T>& b) {
  MotionBias<T> sum{a.momentum + b.momentum, {}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum.angular.m[i][j] = a.angular.m[i][j] + b.angular.m[i][j];
  return sum;
}
template <class T>
SpatialVector<T> apply(const MotionBias<T>& b, const SpatialVector<T>& m) {
  return {math::cross(b.momentum, m.angular) * T(-2.0f), math::multiply(b.angular, m.angular)};
}
// Returns the angular part of B^T m. The linear part is 0.
template <class T>
Vec3<T> apply_transposed(const MotionBias<T>& b, const SpatialVector<T>& m) {
  return math::multiply(math::transpose(b.angular), m.angular) -
         math::cross(m.linear, b.momentum) * T(2.0f);
}

// The quantities psi, psi' and sigma of dof k. For linear dofs of a FREE root, psi and psi' are 0,
// because nothing depends on the root's position. For a FREE joint below a body, psi and psi'
// include the change of the joint's twist with its position.
template <class T>
struct DofMotion {
  SpatialVector<T> psi{}, psi_rate{}, sigma{};
};

// Memory for the derivatives: `motions` {dofs}, `biases` {links}.
template <class T>
struct DerivativeWorkspace {
  DofMotion<T>* motions = nullptr;
  MotionBias<T>* biases = nullptr;
};

template <class T>
DofMotion<T> dof_motion(const Tree<T>& tree, const Link& link, int32_t k, const T* qd, const T* qdd,
                        const Workspace<T>& ws, const LinkState<T>& s) {
  const SpatialVector<T> v_parent = link.parent < 0 ? zero_spatial<T>() : ws.links[link.parent].v;
  const SpatialVector<T>& axis = ws.axes[k];
  DofMotion<T> m;
  m.psi = math::cross_motion(s.v, axis);
  m.psi_rate = math::cross_motion(s.a, axis) + math::cross_motion(s.v, m.psi);
  m.sigma = math::cross_motion(v_parent, axis) + m.psi;
  if (!is_free(link)) return m;
  const int32_t first = local_dof(tree, link);
  const Vec3<T> omega = turned(s.anchor_q, qd + first + 3);
  if (k >= first + 3) {
    m.sigma.linear = m.sigma.linear + math::cross(turned(s.anchor_q, qd + first), axis.angular);
    return m;
  }
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  const SpatialVector<T> dv = {math::cross(axis.linear, omega), none};
  m.sigma = m.sigma + dv;
  if (link.parent < 0) {
    m.psi = m.psi_rate = zero_spatial<T>();
    return m;
  }
  const Vec3<T> alpha = turned(s.anchor_q, qdd + first + 3);
  m.psi = m.psi + dv;
  m.psi_rate = m.psi_rate + (SpatialVector<T>{math::cross(axis.linear, alpha), none} +
                             (math::cross_motion(v_parent, dv) - math::cross_motion(dv, s.v)));
  return m;
}

// Computes the full row-major matrices d tau / d q (by tangents of q) and d tau / d qd {dofs, dofs}
// of tau = ID(q, qd, qdd). Call this after composite_inertias, and after inverse_dynamics at (q,
// qd, qdd) without wrenches.
template <class T>
void inverse_dynamics_derivatives(const Tree<T>& tree, const T* qd, const T* qdd, Workspace<T>& ws,
                                  DerivativeWorkspace<T>& memory, T* dq, T* dqd) {
  const int64_t n = tree.dof_count;
  for (int64_t i = 0; i < n * n; ++i) dq[i] = dqd[i] = T(0.0f);
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const LinkState<T>& s = ws.links[i];
    memory.biases[i] = motion_bias(s.inertia, s.v);
    const int32_t first = local_dof(tree, link);
    for (int32_t k = first; k < first + link.dofs; ++k)
      memory.motions[k] = dof_motion(tree, link, k, qd, qdd, ws, s);
  }
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    const LinkState<T>& s = ws.links[i];
    const MotionBias<T>& b = memory.biases[i];
    const int32_t first = local_dof(tree, link);
    for (int32_t k = first; k < first + link.dofs; ++k) {
      const SpatialVector<T>& axis = ws.axes[k];
      const DofMotion<T>& m = memory.motions[k];
      const bool free_linear = is_free(link) && k < first + 3;
      const bool still = free_linear && link.parent < 0;
      SpatialVector<T> fq = math::apply(s.composite, m.psi_rate) + apply(b, m.psi);
      if (!still) fq = fq + math::cross_force(axis, s.f);
      const SpatialVector<T> fv = math::apply(s.composite, m.sigma) + apply(b, axis);
      // Rows of the joint itself and of its ancestors.
      for (int32_t r = first + link.dofs - 1; r >= 0; r = tree.dof_parent[r]) {
        dq[r * n + k] = math::dot(ws.axes[r], fq);
        dqd[r * n + k] = math::dot(ws.axes[r], fv);
      }
      if (free_linear && !still)
        for (int32_t r = first + 3; r < first + 6; ++r)
          dq[r * n + k] =
              dq[r * n + k] + math::dot(math::cross(axis.linear, ws.axes[r].angular), s.f.linear);
    }
    // Columns of the ancestors.
    for (int32_t r = first; r < first + link.dofs; ++r) {
      const SpatialVector<T> y = math::apply(s.composite, ws.axes[r]);
      const Vec3<T> turning = apply_transposed(b, ws.axes[r]);
      for (int32_t k = tree.dof_parent[first]; k >= 0; k = tree.dof_parent[k]) {
        const DofMotion<T>& m = memory.motions[k];
        dq[r * n + k] = math::dot(y, m.psi_rate) + math::dot(turning, m.psi.angular);
        dqd[r * n + k] = math::dot(y, m.sigma) + math::dot(turning, ws.axes[k].angular);
      }
    }
    if (link.parent >= 0) memory.biases[link.parent] = memory.biases[link.parent] + b;
  }
}

// Solves M X = B in place, {dofs, dofs} row-major, by the factor of M (`solve` of factor.h for all
// columns). `upper`: B is the identity and the factor is sparse. X is then symmetric, and only the
// columns from k on are computed in row k.
template <class T>
void solve_columns(const Tree<T>& tree, const Workspace<T>& ws, T* x, bool upper = false) {
  const int64_t n = tree.dof_count;
  const T* const m = ws.matrix;
  if (!has_matrix(tree)) {
    for (int64_t c = 0; c < n; ++c) {
      for (int64_t k = 0; k < n; ++k) ws.rhs[k] = x[k * n + c];
      solve(tree, ws, ws.rhs);
      for (int64_t k = 0; k < n; ++k) x[k * n + c] = ws.rhs[k];
    }
    return;
  }
  const auto subtract = [&](int64_t to, int64_t from, const T& l, int64_t begin) {
    T* const y = x + to * n;
    const T* const z = x + from * n;
    for (int64_t c = begin; c < n; ++c) y[c] = y[c] - l * z[c];
  };
  const auto scale = [&](int64_t to, const T& l, int64_t begin) {
    for (int64_t c = begin; c < n; ++c) x[to * n + c] = l * x[to * n + c];
  };
  for_mimics(tree, [&](int32_t mimic, int32_t leader, const T& multiplier) {
    subtract(leader, mimic, -multiplier, 0);
    scale(mimic, T(0.0f), 0);
  });
  with_rows_above(tree, [&](const auto& above) {
    for (int32_t k = tree.dof_count; k-- > 0;)
      for (int32_t j = above(k); j >= 0; j = above(j)) subtract(j, k, m[k * n + j], upper ? k : 0);
    for (int32_t k = 0; k < tree.dof_count; ++k) {
      scale(k, T(1.0f) / m[k * n + k], upper ? k : 0);
      for (int32_t j = above(k); j >= 0; j = above(j)) subtract(k, j, m[k * n + j], upper ? k : 0);
    }
  });
  for_mimics(tree, [&](int32_t mimic, int32_t leader, const T& multiplier) {
    subtract(mimic, leader, -multiplier, 0);  // the row of the mimic joint is 0
  });
}

// Converts the derivatives of inverse dynamics at qdd = M^-1 (tau - ID(q, qd, 0)) to d qdd / d q
// and d qdd / d qd, in place, by the factor of M. Also computes M^-1 = d qdd / d tau.
template <class T>
void forward_dynamics_derivatives(const Tree<T>& tree, const Workspace<T>& ws, T* dq, T* dqd,
                                  T* inverse) {
  const int64_t n = tree.dof_count;
  for (int64_t i = 0; i < n * n; ++i) {
    inverse[i] = T(0.0f);
    dq[i] = -dq[i];
    dqd[i] = -dqd[i];
  }
  for (int64_t k = 0; k < n; ++k) inverse[k * n + k] = T(1.0f);
  const bool upper = is_sparse(tree);
  solve_columns(tree, ws, inverse, upper);
  for (int64_t i = 0; upper && i < n; ++i)
    for (int64_t j = 0; j < i; ++j) inverse[i * n + j] = inverse[j * n + i];
  solve_columns(tree, ws, dq);
  solve_columns(tree, ws, dqd);
}

}  // namespace novaphy::articulation
