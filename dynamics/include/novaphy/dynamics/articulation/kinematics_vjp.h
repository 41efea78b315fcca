// The adjoint of forward kinematics: converts gradients by body_q and body_qd to gradients by q
// (tangents), qd and centers of mass.
//
// The velocity of a link's center of mass c is v + w x c. If it has the gradient (u, t), then V =
// (u, t + c x u) is the gradient by the motion about O. A rotation of all descendants of link i by
// S_k moves poses and centers of mass, and rotates all motions except link i's own
// (inverse_dynamics_vjp.h).
#pragma once

#include "novaphy/dynamics/articulation/inverse_dynamics.h"
#include "novaphy/dynamics/articulation/tangents.h"

namespace novaphy::articulation {

template <class T>
struct KinematicsGradient {
  T *q = nullptr, *qd = nullptr;  // rows of the tree's dofs; stored, not added
  Vec3<T>* com = nullptr;         // rows of links, body frame; stored, not added
};

// Converts the gradient g by the seven numbers of a link's pose to a force about O.
template <class T>
SpatialVector<T> pose_force(const LinkState<T>& s, const Transform<T>& g) {
  return {g.p, quat_to_tangent(s.q, g.q) + math::cross(s.p, g.p)};
}

// Computes the gradients. Call link_frames and link_motions first. A null input gradient is zero.
// Overwrites v_adjoint and f of the links.
template <class T>
void kinematics_vjp(const Tree<T>& tree, const T* qd, const Transform<T>* body_q,
                    const SpatialVector<T>* body_qd, Workspace<T>& ws, KinematicsGradient<T>& g) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    LinkState<T>& s = ws.links[i];
    s.f = s.v_adjoint = zero_spatial<T>();
    g.com[i] = {T(0.0f), T(0.0f), T(0.0f)};
    if (link.body < 0) continue;
    if (body_q) s.f = pose_force(s, body_q[link.body]);
    if (!body_qd) continue;
    const SpatialVector<T>& u = body_qd[link.body];
    const Vec3<T> moved = math::cross(u.linear, s.v.angular);  // gradient by c
    s.v_adjoint = wrench_at_origin(u, s.com);
    s.f = s.f + math::cross_force(s.v, s.v_adjoint) +
          SpatialVector<T>{moved, math::cross(s.com, moved)};
    g.com[i] = math::rotate_inverse(s.q, moved);
  }
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    const LinkState<T>& s = ws.links[i];
    const int32_t first = local_dof(tree, link);
    const SpatialVector<T> turn = s.f - math::cross_force(s.v, s.v_adjoint);
    for (int32_t k = first; k < first + link.dofs; ++k) {
      g.q[k] = math::dot(ws.axes[k], turn);
      g.qd[k] = math::dot(ws.axes[k], s.v_adjoint);
    }
    if (is_free(link)) {  // the columns of the angular rates move with the center of mass
      const Vec3<T> columns = math::cross(turned(s.anchor_q, qd + first + 3), s.v_adjoint.linear);
      for (int k = 0; k < 3; ++k)
        g.q[first + k] = g.q[first + k] + math::dot(ws.axes[first + k].linear, columns);
      g.com[i] = g.com[i] + math::rotate_inverse(s.q, columns);
    }
    if (link.parent < 0) continue;
    LinkState<T>& parent = ws.links[link.parent];
    parent.f = parent.f + s.f;
    parent.v_adjoint = parent.v_adjoint + s.v_adjoint;
  }
}

}  // namespace novaphy::articulation
