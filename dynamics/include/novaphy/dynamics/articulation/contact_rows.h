// Constraint rows of contacts between trees and with the world. A row has the Jacobian J of the
// contact's points by the rates of dofs, and the response Y to impulses.
//
// A contact has the unit normal n from side A to side B, and a point P on each surface: the core
// point moved by the margin. The gap is d = n . (P_B - P_A). The impulses on both sides act at the
// midpoint of the two points. Rows are along n, t1 and t2: J qd = (velocity of B - velocity of A)
// at the midpoint. Each row has J and the response Y = M^-1 J^T for the tree of each side, computed
// by the tree's factor (factor.h).
//
// The tangent t1 is n x e normalized, where e is the axis along which n is smallest (the first on a
// tie), and t2 = n x t1. Points are relative to the origins of the trees' roots, so contacts
// between trees do not depend on the world position.
#pragma once

#include "novaphy/dynamics/articulation/factor.h"
#include "novaphy/dynamics/articulation/kinematics.h"

namespace novaphy::articulation {

template <class T>
struct ContactFrame {
  Vec3<T> axes[3];  // n, t1, t2
};
template <class T>
ContactFrame<T> contact_frame(const Vec3<T>& n) {
  const T o = T(0.0f), one = T(1.0f);
  const auto size = [&](const T& x) { return select(x < o, -x, x); };
  const T x = size(n.x), y = size(n.y), z = size(n.z);
  const auto along_x = both(negate(y < x), negate(z < x));
  const auto along_y = both(negate(along_x), negate(z < y));
  const Vec3<T> axis = {select(along_x, one, o), select(along_y, one, o),
                        select(either(along_x, along_y), o, one)};
  const Vec3<T> across = math::cross(n, axis);
  const Vec3<T> t1 = across * (T(1.0f) / square_root(math::dot(across, across)));
  return {{n, t1, math::cross(n, t1)}};
}

// A surface point relative to the origin of a tree's root. `origin`: that origin in the world (m).
template <class T>
struct SurfacePoint {
  Vec3<T> at{}, origin{};
};
// Returns a surface point of the world. `out`: vector from the core to the surface (m).
template <class T>
SurfacePoint<T> world_point(const Vec3<T>& core, const Vec3<T>& out) {
  return {core + out, {T(0.0f), T(0.0f), T(0.0f)}};
}
// Returns a surface point of a link. `core`: core point in the frame of the link's body (m).
template <class T>
SurfacePoint<T> surface_point(const LinkState<T>& link, const Vec3<T>& core, const Vec3<T>& out) {
  return {(link.p + math::rotate(link.q, core)) + out, link.origin};
}

template <class T>
struct ContactPlace {
  T gap{};           // m, < 0 for penetration
  Vec3<T> a{}, b{};  // midpoint relative to the origins of A and B
};
template <class T>
ContactPlace<T> contact_place(const SurfacePoint<T>& a, const SurfacePoint<T>& b,
                              const Vec3<T>& normal) {
  const Vec3<T> apart = (b.origin - a.origin) + (b.at - a.at);
  const Vec3<T> half = apart * T(0.5f);
  return {math::dot(apart, normal), a.at + half, b.at - half};
}

// Returns the last dof that moves a link, counted from the tree's first dof; -1: none.
template <class T>
int32_t last_dof(const Tree<T>& tree, int32_t link) {
  for (int32_t i = link; i >= 0; i = tree.links[i].parent)
    if (tree.links[i].dofs > 0) return local_dof(tree, tree.links[i]) + tree.links[i].dofs - 1;
  return -1;
}

// Returns whether impulses may move the joint of a link.
inline bool is_moved(const Link& link) { return link.dofs > 0 && !is_kinematic(link); }
// Returns whether a link is the link `above` or its descendant. With `above` -1: whether any joint
// on the way to the root is one that impulses may move.
template <class T>
bool hangs_on(const Tree<T>& tree, int32_t link, int32_t above) {
  while (link > above && !(above < 0 && is_moved(tree.links[link]))) link = tree.links[link].parent;
  return above < 0 ? link >= 0 : link == above;
}
// Returns the mass of the links that hang on `above` (kg); see hangs_on.
template <class T>
T hanging_mass(const Tree<T>& tree, const Workspace<T>& ws, int32_t above) {
  T sum = T(0.0f);
  for (int32_t i = 0; i < tree.link_count; ++i)
    if (hangs_on(tree, i, above)) sum = sum + ws.links[i].inertia.mass;
  return sum;
}
// For a contact of a tree with itself: finds the joint nearest to the root that moves only one of
// the two sides. Returns the link below it, on the side with the smaller mass. -1: no such joint,
// or sides of two trees.
template <class T, class Side>
int32_t parted_link(const Tree<T>& tree, const Workspace<T>& ws, const Side (&sides)[2]) {
  if (sides[0].tree != sides[1].tree) return -1;
  const auto nearest = [&](int32_t link, int32_t other) {
    int32_t found = -1;
    for (; link >= 0 && !hangs_on(tree, other, link); link = tree.links[link].parent)
      if (is_moved(tree.links[link])) found = link;
    return found;
  };
  const int32_t a = sides[0].link, b = sides[1].link, of_a = nearest(a, b), of_b = nearest(b, a);
  if (of_a < 0 || of_b < 0) return of_a < 0 ? of_b : of_a;
  return hanging_mass(tree, ws, of_b) < hanging_mass(tree, ws, of_a) ? of_b : of_a;
}
// Returns the mass (kg) of the links that a contact of a tree with itself pushes apart.
template <class T, class Side>
T parted_mass(const Tree<T>& tree, const Workspace<T>& ws, const Side (&sides)[2]) {
  return hanging_mass(tree, ws, parted_link(tree, ws, sides));
}

// Adds the velocity of a link's point along the three axes of the frame, times `sign`, to the rows
// J {3, stride}.
template <class T>
void add_point_rows(const Tree<T>& tree, const SpatialVector<T>* axes, int32_t link,
                    const Vec3<T>& point, const ContactFrame<T>& frame, const T& sign,
                    int64_t stride, T* jacobian) {
  for (int32_t k = last_dof(tree, link); k >= 0; k = tree.dof_parent[k]) {
    const Vec3<T> v = math::motion_at(axes[k], point).linear * sign;
    for (int r = 0; r < 3; ++r) {
      T& to = jacobian[r * stride + k];
      to = to + math::dot(frame.axes[r], v);
    }
  }
}

// For a contact of a tree with itself: returns the coupling of the two sides, the part of J_n Y_n
// that is missing if each side is taken alone. `link`, `point`: those of side A. `response`: Y_n of
// both sides. Overwrites ws.rhs.
template <class T>
T shared_in_tree(const Tree<T>& tree, const Workspace<T>& ws, int32_t link, const Vec3<T>& point,
                 const Vec3<T>& normal, const T* response) {
  T* const x = ws.rhs;
  for (int32_t k = 0; k < tree.dof_count; ++k) x[k] = T(0.0f);
  T of_both = T(0.0f), alone = T(0.0f);
  for (int32_t k = last_dof(tree, link); k >= 0; k = tree.dof_parent[k]) {
    x[k] = -math::dot(normal, math::motion_at(ws.axes[k], point).linear);
    of_both = of_both + x[k] * response[k];
  }
  solve(tree, ws, x);
  for (int32_t k = last_dof(tree, link); k >= 0; k = tree.dof_parent[k])
    alone = alone - x[k] * math::dot(normal, math::motion_at(ws.axes[k], point).linear);
  return T(2.0f) * (alone - of_both);
}

// Computes the responses Y {3, stride} of the rows J by the factor. Only entries of the dof `last`
// and of the dofs between it and the root may be nonzero in J. `last` -1: all entries may be
// nonzero.
template <class T>
void response_rows(const Tree<T>& tree, const Workspace<T>& ws, int32_t last, int64_t stride,
                   const T* jacobian, T* response) {
  const int64_t n = tree.dof_count;
  for (int64_t k = 0; k < 3 * stride; ++k) response[k] = jacobian[k];
  if (!is_sparse(tree)) {
    for (int r = 0; r < 3; ++r) solve(tree, ws, response + r * stride);
    return;
  }
  const T* const matrix = ws.matrix;
  T *const y0 = response, *const y1 = y0 + stride, *const y2 = y1 + stride;
  const auto above = [&](int32_t k) { return last < 0 ? k - 1 : tree.dof_parent[k]; };
  const int32_t first = last < 0 ? tree.dof_count - 1 : last;
  for (int32_t k = first; k >= 0; k = above(k)) {
    const T a0 = y0[k], a1 = y1[k], a2 = y2[k];
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j]) {
      const T l = matrix[k * n + j];
      y0[j] = y0[j] - l * a0;
      y1[j] = y1[j] - l * a1;
      y2[j] = y2[j] - l * a2;
    }
  }
  for (int32_t k = first; k >= 0; k = above(k)) {
    const T inverse = T(1.0f) / matrix[k * n + k];
    y0[k] = y0[k] * inverse;
    y1[k] = y1[k] * inverse;
    y2[k] = y2[k] * inverse;
  }
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    T a0 = y0[k], a1 = y1[k], a2 = y2[k];
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j]) {
      const T l = matrix[k * n + j];
      a0 = a0 - l * y0[j];
      a1 = a1 - l * y1[j];
      a2 = a2 - l * y2[j];
    }
    y0[k] = a0;
    y1[k] = a1;
    y2[k] = a2;
  }
}

}  // namespace novaphy::articulation
