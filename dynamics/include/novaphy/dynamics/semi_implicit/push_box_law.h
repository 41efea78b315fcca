// A sphere pushes a box along a line: one axis, smooth penalty contact, symplectic Euler.
//
//   gap = x - h - r - x_p,  z = -gap / s
//   N   = ke s softplus(z) + kd sigmoid(z) v_s softplus((v_p - v) / v_s)      >= 0
//   v'  = v + dt (N - mu m g tanh(v / v_s)) / m,  x' = x + dt v'
// Symbols:
//   x, v       position (m) and velocity (m/s) of the box's center along the axis
//   x_p, v_p   those of the pusher's center, which is on the side of smaller x
//   m, h, r    mass (kg) and half extent (m) of the box, radius of the pusher (m)
//   N          contact force (N); ke, kd: its stiffness (N/m) and damping (N s/m)
//   mu, g      coefficient of friction under the box, gravity (m/s^2)
//   s, v_s     softness of the contact (m), velocity at which friction is fully developed (m/s)
// The damping acts only on approach. The step is stable for dt mu g / v_s < 1 and dt^2 ke / m < 1.
// The pusher feels no reaction.
//
// Gradient: exact in all symbols. The law is smooth. Beyond gap = 104 s, where exp underflows, N
// and its derivatives are 0.
//
// Freestanding: T = float runs in the rollout, T = nova::Real is traced.
#pragma once

#include "novaphy/math/activations.h"

namespace novaphy {

template <class T>
struct PushBoxState {
  T x{}, v{};
};

template <class T>
struct PushBoxConstants {
  T mass{}, half_extent{}, pusher_radius{}, ke{}, kd{}, friction{}, dt{}, softness{},
      friction_velocity{}, gravity{};
};

// The terms of the law.
template <class T>
struct PushBoxTerms {
  T z{}, depth{}, touch{};  // depth and touch: softplus and sigmoid of z
  T ratio{}, closing{};     // (v_p - v) / v_s and its softplus
  T slide{};                // tanh(v / v_s)
  T normal{};               // N
};

template <class T>
PushBoxTerms<T> push_box_terms(const PushBoxState<T>& box, const PushBoxState<T>& pusher,
                               const PushBoxConstants<T>& n) {
  using namespace math;
  PushBoxTerms<T> t;
  const T gap = ((box.x - n.half_extent) - n.pusher_radius) - pusher.x;
  t.z = -gap / n.softness;
  t.depth = softplus(t.z);
  t.touch = sigmoid(t.z);
  t.ratio = (pusher.v - box.v) / n.friction_velocity;
  t.closing = softplus(t.ratio);
  t.slide = tanh(box.v / n.friction_velocity);
  t.normal = n.ke * (n.softness * t.depth) + n.kd * (t.touch * (n.friction_velocity * t.closing));
  return t;
}

template <class T>
PushBoxState<T> push_box_step(const PushBoxState<T>& box, const PushBoxState<T>& pusher,
                              const PushBoxConstants<T>& n) {
  const PushBoxTerms<T> t = push_box_terms(box, pusher, n);
  const T friction = n.friction * (n.mass * (n.gravity * t.slide));
  const T v = box.v + n.dt * ((t.normal - friction) / n.mass);
  return {box.x + n.dt * v, v};
}

// The derivatives of v' by the inputs of a step. Those of x' follow from x' = x + dt v'.
template <class T>
struct PushBoxDerivatives {
  PushBoxState<T> box{}, pusher{};
  PushBoxConstants<T> numbers{};
};
template <class T>
PushBoxDerivatives<T> push_box_derivatives(const PushBoxState<T>& box,
                                           const PushBoxState<T>& pusher,
                                           const PushBoxConstants<T>& n) {
  using namespace math;
  const PushBoxTerms<T> t = push_box_terms(box, pusher, n);
  const T one = T(1.0f), per_force = n.dt / n.mass, vs = n.friction_velocity;
  const T normal_by_z =
      n.ke * (n.softness * t.touch) + n.kd * (vs * t.closing) * (t.touch * sigmoid(-t.z));
  const T normal_by_ratio = n.kd * (t.touch * vs) * sigmoid(t.ratio);
  const T by_gap = -(per_force * normal_by_z) / n.softness;
  const T by_closing = per_force * normal_by_ratio / vs;  // by v_p - v
  const T weight = n.dt * n.friction * n.gravity;
  const T by_slide = weight * (one - t.slide * t.slide) / vs;  // derivative of friction by v
  PushBoxDerivatives<T> d;
  d.box = {by_gap, one - by_closing - by_slide};
  d.pusher = {-by_gap, by_closing};
  d.numbers.mass = -(per_force * t.normal) / n.mass;
  d.numbers.half_extent = -by_gap;
  d.numbers.pusher_radius = -by_gap;
  d.numbers.ke = per_force * (n.softness * t.depth);
  d.numbers.kd = per_force * (t.touch * (vs * t.closing));
  d.numbers.friction = -(n.dt * n.gravity * t.slide);
  d.numbers.dt = t.normal / n.mass - n.friction * n.gravity * t.slide;
  d.numbers.softness = per_force * (n.ke * t.depth) - per_force * normal_by_z * t.z / n.softness;
  d.numbers.friction_velocity =
      per_force * (n.kd * (t.touch * t.closing)) - by_closing * t.ratio + by_slide * (box.v / vs);
  d.numbers.gravity = -(n.dt * n.friction * t.slide);
  return d;
}

}  // namespace novaphy
