// REVOLUTE joint: a rotation by q (rad) about the axis a of the anchor. q is not wrapped.
//   X_j = (0, exp(q a))      S = (p x R a, R a)
#pragma once

#include "novaphy/dynamics/articulation/joints/one_coordinate.h"

namespace novaphy::articulation {

struct RevoluteJoint : OneCoordinate {
  static constexpr LinkJoint kType = LinkJoint::Revolute;
  static constexpr int32_t kLinear = 0, kAngular = 1;

  template <class T>
  static Transform<T> transform(const Tree<T>& tree, const Link& link, const T* q, T&) {
    const SinCos<T> half = sin_cos(T(0.5f) * q[0]);
    const Vec3<T> v = tree.axis[link.dof] * half.sin;
    return {{T(0.0f), T(0.0f), T(0.0f)}, {v.x, v.y, v.z, half.cos}};
  }
  template <class T>
  static void set_axes(const Tree<T>& tree, const Link& link, const LinkState<T>& s,
                       SpatialVector<T>* column) {
    column[0] = turning_column(s, tree.axis[link.dof], s.anchor_p);
  }
};

}  // namespace novaphy::articulation
