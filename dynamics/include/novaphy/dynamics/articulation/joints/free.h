// FREE joint: the position x (m) of the joint's frame in the anchor and the unit quaternion r of
// its rotation. The rates are the velocity v of the center of mass and the angular velocity w, in
// the anchor's axes.
//   X_j = (x, r)      S = (R e_k, 0), then (c x R e_k, R e_k)
//   r' = cayley(dt w / 2) r      x' = x + dt v + (R(r) - R(r')) rc
// R is the anchor's rotation. The center of mass is at c about O, and at rc in the joint's frame. A
// tangent (e, f) moves the center of mass by e and rotates the body by exp(f) about it. In the
// coordinates (x, r) this is the change (e - f x R(r) rc, E(r) f), with E of joint_tools.h. S moves
// with the center of mass, so the algorithms have additional terms for is_free links. The rates of
// a kinematic joint are prescribed.
#pragma once

#include "novaphy/dynamics/articulation/joints/joint_tools.h"

namespace novaphy::articulation {

struct FreeJoint {
  static constexpr LinkJoint kType = LinkJoint::Free;
  static constexpr int32_t kLinear = 3, kAngular = 3, kQuaternion = 3;
  static constexpr bool kHasDrive = false;
  static constexpr bool kIsFree = true, kIsKinematic = false;

  template <class T>
  static Transform<T> transform(const Tree<T>&, const Link&, const T* q, T& length) {
    return {{q[0], q[1], q[2]}, unit_quaternion(q + 3, length)};
  }
  template <class T>
  static void set_axes(const Tree<T>&, const Link&, const LinkState<T>& s,
                       SpatialVector<T>* column) {
    for (int k = 0; k < 3; ++k) {
      column[k + 3] = turning_column(s, unit_vector<T>(k), s.com);
      column[k] = {column[k + 3].angular, {T(0.0f), T(0.0f), T(0.0f)}};
    }
  }
  template <class T>
  static void integrate(const Tree<T>& tree, const Link& link, const T* x, const T* u, const T& dt,
                        T* y) {
    const Quat<T> r = unit_quaternion(x + 3);
    const Quat<T> next = turned_quaternion(r, u + 3, dt);
    const Vec3<T> rc = com_in_joint(tree, link);
    const Vec3<T> moved = math::rotate(r, rc) - math::rotate(next, rc);
    y[0] = x[0] + (dt * u[0] + moved.x);
    y[1] = x[1] + (dt * u[1] + moved.y);
    y[2] = x[2] + (dt * u[2] + moved.z);
    store(next, y + 3);
  }
  template <class T>
  static void integrate_vjp(const T* u, const T& dt, T* h, T* g) {
    for (int k = 0; k < 3; ++k) g[k] = g[k] + dt * h[k];
    turned_quaternion_vjp(u + 3, dt, h + 3, g + 3);
  }
  template <class T>
  static void gradient_to_tangent(const Tree<T>& tree, const Link& link, const T* x, const T* y,
                                  T* h) {
    const Quat<T> r = unit_quaternion(x + 3);
    const Vec3<T> linear = {y[0], y[1], y[2]};
    const Vec3<T> angular = quat_to_tangent(r, Quat<T>{y[3], y[4], y[5], y[6]}) -
                            math::cross(math::rotate(r, com_in_joint(tree, link)), linear);
    store(linear, h);
    store(angular, h + 3);
  }
  template <class T, class Put>
  static void tangent_to_gradient(const Tree<T>& tree, const Link& link, const T* x, const T* h,
                                  Put&& put) {
    T length;
    const Quat<T> r = unit_quaternion(x + 3, length);
    const Vec3<T> linear = {h[0], h[1], h[2]};
    const Vec3<T> angular =
        Vec3<T>{h[3], h[4], h[5]} + math::cross(math::rotate(r, com_in_joint(tree, link)), linear);
    for (int k = 0; k < 3; ++k) put(k, h[k]);
    const Quat<T> g = scaled(quat_from_tangent(r, angular), T(1.0f) / length);
    put(3, g.x);
    put(4, g.y);
    put(5, g.z);
    put(6, g.w);
  }
};

struct KinematicJoint : FreeJoint {
  static constexpr LinkJoint kType = LinkJoint::Kinematic;
  static constexpr bool kIsKinematic = true;
};

}  // namespace novaphy::articulation
