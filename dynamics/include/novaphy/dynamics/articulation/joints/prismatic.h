// PRISMATIC joint: a translation by q (m) along the axis a of the anchor.
//   X_j = (q a, 1)      S = (R a, 0)
#pragma once

#include "novaphy/dynamics/articulation/joints/one_coordinate.h"

namespace novaphy::articulation {

struct PrismaticJoint : OneCoordinate {
  static constexpr LinkJoint kType = LinkJoint::Prismatic;
  static constexpr int32_t kLinear = 1, kAngular = 0;

  template <class T>
  static Transform<T> transform(const Tree<T>& tree, const Link& link, const T* q, T&) {
    return {tree.axis[link.dof] * q[0], Quat<T>::identity()};
  }
  template <class T>
  static void set_axes(const Tree<T>& tree, const Link& link, const LinkState<T>& s,
                       SpatialVector<T>* column) {
    column[0] = {math::rotate(s.anchor_q, tree.axis[link.dof]), {T(0.0f), T(0.0f), T(0.0f)}};
  }
};

}  // namespace novaphy::articulation
