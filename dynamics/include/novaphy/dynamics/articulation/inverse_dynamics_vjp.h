// The adjoint of inverse dynamics in one outward and one inward sweep, without matrices.
//
//   Phi = lambda . ID(q, qd, qdd)   (tree.h; without armature)
// With the virtual motion w_i = w_parent + S_i lambda_i, Phi is the sum over the links of w_i .
// f_i, where f_i = Y_i a_i + v_i x* Y_i v_i - wrench_i. The adjoints of a, v and w are
//   A_i = Y_i w_i,  V_i = -w_i x* Y_i v_i + Y_i (w_i x v_i),  F_i = f_i
// summed over the descendants of the link. A rotation of all descendants with their motions by S_k
// leaves Phi unchanged. But v, a and w of link i itself do not rotate with its q:
//   dPhi/dq_k = -S_k . (v_i x* V_i + a_i x* A_i + w_i x* F_i) + (angular S_k) . torque_i
// where torque_i is f x w_c + t x w_w of the wrenches (f, t), which are constant in the world. The
// rates of a FREE joint refer to its center of mass, so its angular columns move with the center of
// mass.
#pragma once

#include "novaphy/dynamics/articulation/inverse_dynamics.h"

namespace novaphy::articulation {

// Gradients of Phi. q (by tangents), qd and qdd are indexed by the tree's dofs, other arrays by its
// links. Gradients are stored, not added. Null: not computed.
template <class T>
struct InverseDynamicsGradient {
  T *q = nullptr, *qd = nullptr, *qdd = nullptr;
  SpatialVector<T>* wrench = nullptr;  // about the center of mass, world axes
  T* mass = nullptr;                   // at constant com and inertia about com
  Vec3<T>* com = nullptr;              // body frame; at constant q
  Mat33<T>* inertia = nullptr;         // body axes, symmetric
  Vec3<T> gravity = {};
};

// Returns the part of dPhi/d(com) of the link alone, in world axes, at constant v_com and frames:
// the derivative of m w_c . a_c - w_c . f.
template <class T>
Vec3<T> com_gradient(const LinkState<T>& s) {
  const Vec3<T> a_com = math::motion_at(s.a, s.com).linear +
                        math::cross(s.v.angular, math::motion_at(s.v, s.com).linear);
  const Vec3<T> w_com = math::motion_at(s.w, s.com).linear;
  const Vec3<T> g = math::cross(a_com, s.w.angular) + math::cross(w_com, s.a.angular) +
                    math::cross(s.v.angular, math::cross(s.v.angular, w_com));
  return g * s.inertia.mass - math::cross(s.wrench.linear, s.w.angular);
}

// Returns the symmetric dPhi/dI in body axes: the derivative of w_w . (I alpha + omega x I omega).
template <class T>
Mat33<T> inertia_gradient(const LinkState<T>& s) {
  const Vec3<T> w = math::rotate_inverse(s.q, s.w.angular);
  const Vec3<T> alpha = math::rotate_inverse(s.q, s.a.angular);
  const Vec3<T> omega = math::rotate_inverse(s.q, s.v.angular);
  const Vec3<T> u = math::cross(w, omega);
  const T h = T(0.5f);
  const auto pair = [&](const T& wi, const T& ai, const T& ui, const T& oi, const T& wj,
                        const T& aj, const T& uj,
                        const T& oj) { return ((wi * aj + wj * ai) + (ui * oj + uj * oi)) * h; };
  const T xy = pair(w.x, alpha.x, u.x, omega.x, w.y, alpha.y, u.y, omega.y);
  const T xz = pair(w.x, alpha.x, u.x, omega.x, w.z, alpha.z, u.z, omega.z);
  const T yz = pair(w.y, alpha.y, u.y, omega.y, w.z, alpha.z, u.z, omega.z);
  return {{{w.x * alpha.x + u.x * omega.x, xy, xz},
           {xy, w.y * alpha.y + u.y * omega.y, yz},
           {xz, yz, w.z * alpha.z + u.z * omega.z}}};
}

// Returns the change of Phi if the angular columns of a FREE joint move by d together with its
// center of mass: through the joint's a, v and w, and through its descendants.
template <class T>
T moved_columns(const LinkState<T>& s, const SpatialVector<T>& v_parent, const Vec3<T>& d,
                const Vec3<T>& omega, const Vec3<T>& alpha, const Vec3<T>& lambda) {
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  const SpatialVector<T> dv = {math::cross(d, omega), none};
  const SpatialVector<T> da =
      SpatialVector<T>{math::cross(d, alpha), none} + math::cross_motion(v_parent, dv);
  return (math::dot(dv, s.v_adjoint) + math::dot(da, s.a_adjoint)) +
         math::dot(math::cross(d, lambda), s.f.linear);
}

// Computes the gradients by a joint's q, qd and qdd from the summed adjoints of its link, and a
// FREE joint's contribution to the gradient by `com`.
template <class T>
void joint_gradient(const Tree<T>& tree, const Link& link, const T* qd, const T* qdd,
                    const T* lambda, const SpatialVector<T>& v_parent, const Workspace<T>& ws,
                    const LinkState<T>& s, const InverseDynamicsGradient<T>& g, Vec3<T>* com) {
  const int32_t first = local_dof(tree, link);
  const SpatialVector<T> turn = math::cross_force(s.v, s.v_adjoint) +
                                (math::cross_force(s.a, s.a_adjoint) + math::cross_force(s.w, s.f));
  const SpatialVector<T> rate = s.v_adjoint - math::cross_force(v_parent, s.a_adjoint);
  for (int32_t k = first; k < first + link.dofs; ++k) {
    const SpatialVector<T>& axis = ws.axes[k];
    if (g.q) g.q[k] = math::dot(axis.angular, s.wrench_torque) - math::dot(axis, turn);
    if (g.qd) g.qd[k] = math::dot(axis, rate);
    if (g.qdd) g.qdd[k] = math::dot(axis, s.a_adjoint);
  }
  if (!is_free(link)) return;
  const Vec3<T> v = turned(s.anchor_q, qd + first), omega = turned(s.anchor_q, qd + first + 3);
  const Vec3<T> alpha = qdd ? turned(s.anchor_q, qdd + first + 3) : Vec3<T>{};
  const Vec3<T> lambda_angular = turned(s.anchor_q, lambda + first + 3);
  const auto moved = [&](const Vec3<T>& d) {
    return moved_columns(s, v_parent, d, omega, alpha, lambda_angular);
  };
  const Vec3<T> linear = math::rotate_inverse(s.anchor_q, math::cross(omega, s.a_adjoint.linear));
  const Vec3<T> angular = math::rotate_inverse(s.anchor_q, math::cross(s.a_adjoint.linear, v));
  if (g.qd) {
    const T add[6] = {linear.x, linear.y, linear.z, angular.x, angular.y, angular.z};
    for (int k = 0; k < 6; ++k) g.qd[first + k] = g.qd[first + k] + add[k];
  }
  if (g.q)  // nothing depends on the position of a root
    for (int k = 0; k < 3; ++k)
      g.q[first + k] =
          link.parent < 0 ? T(0.0f) : g.q[first + k] + moved(ws.axes[first + k].linear);
  if (com) {
    const Vec3<T> d = {moved(unit_vector<T>(0)), moved(unit_vector<T>(1)),
                       moved(unit_vector<T>(2))};
    *com = *com + math::rotate_inverse(s.q, d);
  }
}

// Computes the gradients of Phi, after inverse_dynamics at (q, qd, qdd). `lambda` is indexed by the
// tree's dofs.
template <class T>
void inverse_dynamics_vjp(const Tree<T>& tree, const T* qd, const T* qdd, const T* lambda,
                          Workspace<T>& ws, InverseDynamicsGradient<T>& g) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    LinkState<T>& s = ws.links[i];
    s.w = joint_motion(tree, link, ws.axes, lambda);
    if (link.parent >= 0) s.w = ws.links[link.parent].w + s.w;
    s.a_adjoint = math::apply(s.inertia, s.w);
    s.v_adjoint = math::apply(s.inertia, math::cross_motion(s.w, s.v)) -
                  math::cross_force(s.w, math::apply(s.inertia, s.v));
    const SpatialVector<T> w_com = math::motion_at(s.w, s.com);
    s.wrench_torque =
        math::cross(s.wrench.linear, w_com.linear) + math::cross(s.wrench.angular, w_com.angular);
    if (g.wrench) g.wrench[i] = -w_com;
    if (g.mass)
      g.mass[i] =
          math::dot(w_com.linear, math::motion_at(s.a, s.com).linear +
                                      math::cross(s.v.angular, math::motion_at(s.v, s.com).linear));
    if (g.com) g.com[i] = math::rotate_inverse(s.q, com_gradient(s));
    if (g.inertia) g.inertia[i] = inertia_gradient(s);
  }
  g.gravity = {T(0.0f), T(0.0f), T(0.0f)};
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    const LinkState<T>& s = ws.links[i];
    LinkState<T>* parent = link.parent < 0 ? nullptr : &ws.links[link.parent];
    const SpatialVector<T> v_parent = parent ? parent->v : zero_spatial<T>();
    joint_gradient(tree, link, qd, qdd, lambda, v_parent, ws, s, g, g.com ? g.com + i : nullptr);
    if (!parent) {
      g.gravity = g.gravity - s.a_adjoint.linear;
      continue;
    }
    const SpatialVector<T> moved = joint_motion(tree, link, ws.axes, qd);
    parent->v_adjoint = parent->v_adjoint + (s.v_adjoint + math::cross_force(moved, s.a_adjoint));
    parent->a_adjoint = parent->a_adjoint + s.a_adjoint;
    parent->wrench_torque = parent->wrench_torque + s.wrench_torque;
  }
}

}  // namespace novaphy::articulation
