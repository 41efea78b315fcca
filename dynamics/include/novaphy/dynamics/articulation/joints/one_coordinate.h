// Common code of joints with one coordinate: q' = q + dt qd, and the tangent is the change of q.
#pragma once

#include "novaphy/dynamics/articulation/joints/joint_tools.h"

namespace novaphy::articulation {

struct OneCoordinate {
  static constexpr int32_t kQuaternion = -1;
  static constexpr bool kHasDrive = true;
  static constexpr bool kIsFree = false, kIsKinematic = false;

  template <class T>
  static void integrate(const Tree<T>&, const Link&, const T* x, const T* u, const T& dt, T* y) {
    y[0] = x[0] + dt * u[0];
  }
  template <class T>
  static void integrate_vjp(const T*, const T& dt, T* h, T* g) {
    g[0] = g[0] + dt * h[0];
  }
  template <class T>
  static void gradient_to_tangent(const Tree<T>&, const Link&, const T*, const T* y, T* h) {
    h[0] = y[0];
  }
  template <class T, class Put>
  static void tangent_to_gradient(const Tree<T>&, const Link&, const T*, const T* h, Put&& put) {
    put(0, h[0]);
  }
};

}  // namespace novaphy::articulation
