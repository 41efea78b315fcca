// BALL joint: a rotation by the unit quaternion q. The rates are the angular velocity in the
// anchor's axes.
//   X_j = (0, q)      S_k = (p x R e_k, R e_k)      q' = cayley(dt qd / 2) q
// A tangent e rotates by exp(e) on the left, which changes the numbers of q by E(q) e
// (joint_tools.h). Gradients by q are tangent to the unit sphere, as those of a function of q /
// |q|.
#pragma once

#include "novaphy/dynamics/articulation/joints/joint_tools.h"

namespace novaphy::articulation {

struct BallJoint {
  static constexpr LinkJoint kType = LinkJoint::Ball;
  static constexpr int32_t kLinear = 0, kAngular = 3, kQuaternion = 0;
  static constexpr bool kHasDrive = false;
  static constexpr bool kIsFree = false, kIsKinematic = false;

  template <class T>
  static Transform<T> transform(const Tree<T>&, const Link&, const T* q, T& length) {
    return {{T(0.0f), T(0.0f), T(0.0f)}, unit_quaternion(q, length)};
  }
  template <class T>
  static void set_axes(const Tree<T>&, const Link&, const LinkState<T>& s,
                       SpatialVector<T>* column) {
    for (int k = 0; k < 3; ++k) column[k] = turning_column(s, unit_vector<T>(k), s.anchor_p);
  }
  template <class T>
  static void integrate(const Tree<T>&, const Link&, const T* x, const T* u, const T& dt, T* y) {
    store(turned_quaternion(unit_quaternion(x), u, dt), y);
  }
  template <class T>
  static void integrate_vjp(const T* u, const T& dt, T* h, T* g) {
    turned_quaternion_vjp(u, dt, h, g);
  }
  template <class T>
  static void gradient_to_tangent(const Tree<T>&, const Link&, const T* x, const T* y, T* h) {
    store(quat_to_tangent(unit_quaternion(x), Quat<T>{y[0], y[1], y[2], y[3]}), h);
  }
  template <class T, class Put>
  static void tangent_to_gradient(const Tree<T>&, const Link&, const T* x, const T* h, Put&& put) {
    T length;
    const Quat<T> r = unit_quaternion(x, length);
    const Quat<T> g = scaled(quat_from_tangent(r, {h[0], h[1], h[2]}), T(1.0f) / length);
    put(0, g.x);
    put(1, g.y);
    put(2, g.z);
    put(3, g.w);
  }
};

}  // namespace novaphy::articulation
