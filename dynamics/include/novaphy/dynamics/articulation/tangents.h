// Gradients with respect to the numbers of q, and to its tangents (tree.h).
//
// With E(r) e = (e, 0) r / 2, a step e of a BALL's tangent is E(r) e in its numbers. The center of
// mass of a FREE joint is at c from the joint's frame, in the anchor's axes. A step of its tangent
// is (e_linear - e_angular x c, E(r) e_angular). Gradients with respect to numbers come out tangent
// to the unit sphere: those of a function of r / |r|.
#pragma once

#include "novaphy/dynamics/articulation/kinematics.h"

namespace novaphy::articulation {

// E(r)^T g
template <class T>
Vec3<T> quat_to_tangent(const Quat<T>& r, const Quat<T>& g) {
  const T half = T(0.5f);
  return {(((r.w * g.x - r.z * g.y) + r.y * g.z) - r.x * g.w) * half,
          (((r.z * g.x + r.w * g.y) - r.x * g.z) - r.y * g.w) * half,
          (((r.x * g.y - r.y * g.x) + r.w * g.z) - r.z * g.w) * half};
}
// 4 E(r) h
template <class T>
Quat<T> quat_from_tangent(const Quat<T>& r, const Vec3<T>& h) {
  const Quat<T> turned = math::multiply(Quat<T>{h.x, h.y, h.z, T(0.0f)}, r);
  return scaled(turned, T(2.0f));
}

// Of the numbers g (rows of the arrays) at q, to tangents (rows of the tree).
template <class T>
void gradient_to_tangent(const Tree<T>& tree, const T* q, const T* g, T* tangent) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    T* const h = tangent + local_dof(tree, link);
    const T *const x = q + link.coord, *const y = g + link.coord;
    if (link.dofs == 1) {
      h[0] = y[0];
    } else if (link.dofs > 1) {
      const int32_t o = is_free(link) ? 3 : 0;
      const Quat<T> raw = {x[o], x[o + 1], x[o + 2], x[o + 3]};
      const Quat<T> r = scaled(raw, T(1.0f) / quat_length(raw));
      Vec3<T> angular = quat_to_tangent(r, Quat<T>{y[o], y[o + 1], y[o + 2], y[o + 3]});
      if (o == 3) {
        const Vec3<T> linear = {y[0], y[1], y[2]};
        angular = angular - math::cross(math::rotate(r, com_in_joint(tree, link)), linear);
        for (int k = 0; k < 3; ++k) h[k] = y[k];
      }
      h[o] = angular.x;
      h[o + 1] = angular.y;
      h[o + 2] = angular.z;
    }
  }
}

// The other way. `put(row, value)` takes the gradient of the coordinate `row` of the arrays.
template <class T, class Put>
void tangent_to_gradient(const Tree<T>& tree, const T* q, const T* tangent, Put&& put) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const T* const h = tangent + local_dof(tree, link);
    const T* const x = q + link.coord;
    if (link.dofs == 1) {
      put(link.coord, h[0]);
    } else if (link.dofs > 1) {
      const int32_t o = is_free(link) ? 3 : 0;
      const Quat<T> raw = {x[o], x[o + 1], x[o + 2], x[o + 3]};
      const T inverse = T(1.0f) / quat_length(raw);
      const Quat<T> r = scaled(raw, inverse);
      Vec3<T> angular = {h[o], h[o + 1], h[o + 2]};
      if (o == 3) {
        const Vec3<T> linear = {h[0], h[1], h[2]};
        angular = angular + math::cross(math::rotate(r, com_in_joint(tree, link)), linear);
        for (int k = 0; k < 3; ++k) put(link.coord + k, h[k]);
      }
      const Quat<T> g = scaled(quat_from_tangent(r, angular), inverse);
      put(link.coord + o, g.x);
      put(link.coord + o + 1, g.y);
      put(link.coord + o + 2, g.z);
      put(link.coord + o + 3, g.w);
    }
  }
}

}  // namespace novaphy::articulation
