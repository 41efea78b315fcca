// Rows of contacts between trees, and with the world: where they are, how the rates of dofs move
// their points, and how impulses answer.
//
// A contact has the unit normal n from side A to side B and one point P of each surface, moved by
// its margin. Its gap is d = n . (P_B - P_A); both sides push at the midpoint of the two points.
// Rows are along n, t1 and t2: J qd = (velocity of B - velocity of A) at the midpoint. Per row and
// tree on a side there are J and the response Y = M^-1 J^T, by the tree's factor (factor.h).
// t1 is n x e made unit, e the axis along which n is smallest (of two alike the first), t2 = n x
// t1. Points are about the origins of the trees' roots, so contacts of trees among each other do
// not depend on where they are.
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
  const auto size = [](const T& x) { return x < T(0.0f) ? -x : x; };
  const T x = size(n.x), y = size(n.y), z = size(n.z);
  const int axis = !(y < x) && !(z < x) ? 0 : !(z < y) ? 1 : 2;
  const Vec3<T> across = math::cross(n, unit_vector<T>(axis));
  const Vec3<T> t1 = across * (T(1.0f) / square_root(math::dot(across, across)));
  return {{n, t1, math::cross(n, t1)}};
}

// A point of a surface: about its root's origin, which is at `origin` in the world.
template <class T>
struct SurfacePoint {
  Vec3<T> at{}, origin{};
};
// `core` in the frame of the link's body, or (link null) of the world; `out` from it to the
// surface.
template <class T>
SurfacePoint<T> surface_point(const LinkState<T>* link, const Vec3<T>& core, const Vec3<T>& out) {
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  if (link == nullptr) return {core + out, none};
  return {(link->p + math::rotate(link->q, core)) + out, link->origin};
}

template <class T>
struct ContactPlace {
  T gap{};           // m, < 0 is penetration
  Vec3<T> a{}, b{};  // the midpoint about the origins of A and B
};
template <class T>
ContactPlace<T> contact_place(const SurfacePoint<T>& a, const SurfacePoint<T>& b,
                              const Vec3<T>& normal) {
  const Vec3<T> apart = (b.origin - a.origin) + (b.at - a.at);
  const Vec3<T> half = apart * T(0.5f);
  return {math::dot(apart, normal), a.at + half, b.at - half};
}

// The dof that moves a link and is the nearest to it, among the tree's; -1: none.
template <class T>
int32_t last_dof(const Tree<T>& tree, int32_t link) {
  for (int32_t i = link; i >= 0; i = tree.links[i].parent)
    if (tree.links[i].dofs > 0) return local_dof(tree, tree.links[i]) + tree.links[i].dofs - 1;
  return -1;
}

// Adds to the rows of J {3, stride} the velocity of a link's point along the three axes, times
// `sign`.
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

// The responses Y {rows, stride} of rows J, by the factor.
template <class T>
void response_rows(const Tree<T>& tree, const T* matrix, int32_t rows, int64_t stride,
                   const T* jacobian, T* response) {
  for (int32_t r = 0; r < rows; ++r) {
    T* const y = response + r * stride;
    for (int64_t k = 0; k < stride; ++k) y[k] = jacobian[r * stride + k];
    solve(tree, matrix, y);
  }
}

}  // namespace novaphy::articulation
