// FIXED joint: X_j is the identity. The joint has no degrees of freedom.
#pragma once

#include "novaphy/dynamics/articulation/joints/joint_tools.h"

namespace novaphy::articulation {

struct FixedJoint {
  static constexpr LinkJoint kType = LinkJoint::Fixed;
  static constexpr int32_t kLinear = 0, kAngular = 0, kQuaternion = -1;
  static constexpr bool kHasDrive = false;
  static constexpr bool kIsFree = false, kIsKinematic = false;

  template <class T>
  static Transform<T> transform(const Tree<T>&, const Link&, const T*, T&) {
    return Transform<T>::identity();
  }
  template <class T>
  static void set_axes(const Tree<T>&, const Link&, const LinkState<T>&, SpatialVector<T>*) {}
  template <class T>
  static void integrate(const Tree<T>&, const Link&, const T*, const T*, const T&, T*) {}
  template <class T>
  static void integrate_vjp(const T*, const T&, T*, T*) {}
  template <class T>
  static void gradient_to_tangent(const Tree<T>&, const Link&, const T*, const T*, T*) {}
  template <class T, class Put>
  static void tangent_to_gradient(const Tree<T>&, const Link&, const T*, const T*, Put&&) {}
};

}  // namespace novaphy::articulation
