// Inverse dynamics, the mass matrix, the center of mass and the energy of a tree (tree.h). Call
// kinematics() first.
//   tau = ID(q, qd, qdd) = H(q) qdd + bias(q, qd), without armature, with wrenches on bodies.
// Source: Featherstone (2008), section 5.3 (recursive Newton-Euler) and 6.2 (composite bodies).
#pragma once

#include "novaphy/dynamics/articulation/kinematics.h"

namespace novaphy::articulation {

// Returns the acceleration of a FREE joint that comes from the change of S: (v x w, 0) for the
// joint's own velocities v and w, in world axes.
template <class T>
SpatialVector<T> free_joint_acceleration(const Quat<T>& anchor_q, const T* qd) {
  SpatialVector<T> a = zero_spatial<T>();
  a.linear = math::cross(turned(anchor_q, qd), turned(anchor_q, qd + 3));
  return a;
}

// Converts a wrench (force, torque about the center of mass) to one about the origin O.
template <class T>
SpatialVector<T> wrench_at_origin(const SpatialVector<T>& wrench, const Vec3<T>& com) {
  return {wrench.linear, wrench.angular + math::cross(com, wrench.linear)};
}

template <class T>
void clear_wrenches(const Tree<T>& tree, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) ws.links[i].wrench = zero_spatial<T>();
}

// Computes the forces tau of dofs (indexed by the tree's dofs), and v, a and f in the workspace.
// Null qdd: 0. External wrenches of the links are included.
template <class T>
void inverse_dynamics(const Tree<T>& tree, const T* qd, const T* qdd, Workspace<T>& ws, T* tau) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    LinkState<T>& s = ws.links[i];
    const SpatialVector<T> moved = joint_motion(tree, link, ws.axes, qd);
    if (link.parent < 0) {
      s.v = moved;
      s.a = {-tree.gravity, {T(0.0f), T(0.0f), T(0.0f)}};
    } else {
      const LinkState<T>& parent = ws.links[link.parent];
      s.v = parent.v + moved;
      s.a = parent.a + math::cross_motion(parent.v, moved);
    }
    if (qdd != nullptr) s.a = s.a + joint_motion(tree, link, ws.axes, qdd);
    if (is_free(link)) s.a = s.a + free_joint_acceleration(s.anchor_q, qd + local_dof(tree, link));
    s.f = (math::apply(s.inertia, s.a) + math::bias_force(s.inertia, s.v)) -
          wrench_at_origin(s.wrench, s.com);
  }
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    const int32_t first = local_dof(tree, link);
    for (int32_t k = first; k < first + link.dofs; ++k)
      tau[k] = math::dot(ws.axes[k], ws.links[i].f);
    if (link.parent >= 0) ws.links[link.parent].f = ws.links[link.parent].f + ws.links[i].f;
  }
}

template <class T>
void composite_inertias(const Tree<T>& tree, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) ws.links[i].composite = ws.links[i].inertia;
  for (int32_t i = tree.link_count; i-- > 0;) {
    const int32_t parent = tree.links[i].parent;
    if (parent >= 0)
      ws.links[parent].composite = ws.links[parent].composite + ws.links[i].composite;
  }
}

// Computes the mass matrix H in ws.matrix, on and below the diagonal: H[k n + j], where dof j is an
// ancestor of dof k. Entries of dofs on different branches of the tree are 0 and are not written.
template <class T>
void mass_matrix(const Tree<T>& tree, Workspace<T>& ws) {
  composite_inertias(tree, ws);
  const int64_t n = tree.dof_count;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const int32_t first = local_dof(tree, link);
    for (int32_t k = first; k < first + link.dofs; ++k) {
      const SpatialVector<T> force = math::apply(ws.links[i].composite, ws.axes[k]);
      for (int32_t j = k; j >= 0; j = tree.dof_parent[j])
        ws.matrix[k * n + j] = math::dot(ws.axes[j], force);
    }
  }
}

template <class T>
struct TreeMass {
  T mass{};
  Vec3<T> com{};  // m, world
};
// Returns the mass (kg) and the center of mass of all links. Without mass, com is 0.
template <class T>
TreeMass<T> center_of_mass(const Tree<T>& tree, const Workspace<T>& ws) {
  TreeMass<T> sum{T(0.0f), {T(0.0f), T(0.0f), T(0.0f)}};
  Vec3<T> first = {T(0.0f), T(0.0f), T(0.0f)};
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const LinkState<T>& s = ws.links[i];
    if (i == 0) first = s.origin;
    sum.mass = sum.mass + s.inertia.mass;
    sum.com = sum.com + (s.com + (s.origin - first)) * s.inertia.mass;
  }
  if (!(sum.mass > T(0.0f))) return sum;
  sum.com = first + sum.com / sum.mass;
  return sum;
}

template <class T>
struct TreeEnergy {
  T kinetic{}, potential{};  // J; potential relative to the world's origin
};
// Returns the energy without armature. Call link_motions first.
template <class T>
TreeEnergy<T> energy(const Tree<T>& tree, const Workspace<T>& ws) {
  TreeEnergy<T> sum{T(0.0f), T(0.0f)};
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const LinkState<T>& s = ws.links[i];
    sum.kinetic = sum.kinetic + T(0.5f) * math::dot(s.v, math::apply(s.inertia, s.v));
    sum.potential = sum.potential - s.inertia.mass * math::dot(tree.gravity, s.origin + s.com);
  }
  return sum;
}

}  // namespace novaphy::articulation
