// Conversion between gradients by the coordinates q and gradients by their tangents (tree.h).
#pragma once

#include "novaphy/dynamics/articulation/kinematics.h"

namespace novaphy::articulation {

// Converts a gradient g by coordinates (indexed as in the model's arrays) at q to one by tangents
// (indexed by the tree's dofs).
template <class T>
void gradient_to_tangent(const Tree<T>& tree, const T* q, const T* g, T* tangent) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    T* const h = tangent + local_dof(tree, link);
    const T *const x = q + link.coord, *const y = g + link.coord;
    Joints::visit(link.joint, [&](auto joint) { joint.gradient_to_tangent(tree, link, x, y, h); });
  }
}

// Converts a gradient by tangents to one by coordinates. put(row, value) receives the gradient by
// the coordinate `row` of the model's arrays.
template <class T, class Put>
void tangent_to_gradient(const Tree<T>& tree, const T* q, const T* tangent, Put&& put) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const T* const h = tangent + local_dof(tree, link);
    const auto put_own = [&](int32_t k, const T& value) { put(link.coord + k, value); };
    Joints::visit(link.joint, [&](auto joint) {
      joint.tangent_to_gradient(tree, link, q + link.coord, h, put_own);
    });
  }
}

}  // namespace novaphy::articulation
