// Many steps of a pushed box as one kernel row, and their adjoint.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/semi_implicit/push_box_law.h"

namespace novaphy {

inline constexpr int kPushBoxConstants = 10;

struct PushBoxArguments {
  NOVAPHY_ARGUMENTS(
      Detached<Reads<float>> pusher_x, pusher_v;                // one row per step
      Detached<Reads<float>> box_x, box_v;                      // initial state
      Each<Detached<Reads<float>>, kPushBoxConstants> numbers;  // the members of PushBoxConstants
      Number<int64_t> steps;)
};

inline PushBoxConstants<float> push_box_constants(const PushBoxArguments& a) {
  const auto& n = a.numbers;
  return {*n[0], *n[1], *n[2], *n[3], *n[4], *n[5], *n[6], *n[7], *n[8], *n[9]};
}

inline void push_box_list(const PushBoxConstants<float>& n, float (&to)[kPushBoxConstants]) {
  const float list[] = {n.mass, n.half_extent, n.pusher_radius,     n.ke,     n.kd, n.friction,
                        n.dt,   n.softness,    n.friction_velocity, n.gravity};
  for (int k = 0; k < kPushBoxConstants; ++k) to[k] = list[k];
}

struct PushBoxRolloutArguments {
  NOVAPHY_ARGUMENTS(Part<PushBoxArguments> in; Writes<float> x, v;  // values after every step
  )
};
NOVAPHY_ROW_KERNEL(push_box_rollout, PushBoxRolloutArguments) {
  const PushBoxConstants<float> numbers = push_box_constants(a.in);
  PushBoxState<float> box = {*a.in.box_x, *a.in.box_v};
  for (int64_t t = 0; t < a.in.steps; ++t) {
    box = push_box_step(box, {a.in.pusher_x[t], a.in.pusher_v[t]}, numbers);
    a.x[t] = box.x;
    a.v[t] = box.v;
  }
}

struct PushBoxRolloutVjpArguments {
  NOVAPHY_ARGUMENTS(Part<PushBoxArguments> in;
                    Detached<Reads<float>> x, v;  // the results of the rollout
                    Optional<Detached<Reads<float>>> x_adjoint, v_adjoint;  // null: zeros
                    // Gradients of the inputs in the order of PushBoxArguments. A null gradient is
                    // not wanted.
                    Each<Optional<Detached<Updates<float>>>, 4 + kPushBoxConstants> gradient;
                    Number<int64_t> add;  // bit i: add to gradient i instead of overwriting it
  )
};
inline void push_box_give(const PushBoxRolloutVjpArguments& a, int i, int64_t row, float value) {
  float* const to = a.gradient[i];
  if (!to) return;
  to[row] = (a.add >> i) & 1 ? to[row] + value : value;
}
NOVAPHY_ROW_KERNEL(push_box_rollout_vjp, PushBoxRolloutVjpArguments) {
  const PushBoxConstants<float> numbers = push_box_constants(a.in);
  PushBoxState<float> bar = {0.0f, 0.0f};  // gradient of the state after step t
  float sums[kPushBoxConstants] = {};
  for (int64_t t = a.in.steps; t-- > 0;) {
    if (a.x_adjoint) bar.x += a.x_adjoint[t];
    if (a.v_adjoint) bar.v += a.v_adjoint[t];
    const PushBoxState<float> before = {t > 0 ? a.x[t - 1] : *a.in.box_x,
                                        t > 0 ? a.v[t - 1] : *a.in.box_v};
    const PushBoxDerivatives<float> d =
        push_box_derivatives(before, {a.in.pusher_x[t], a.in.pusher_v[t]}, numbers);
    const float of_v = bar.v + numbers.dt * bar.x;
    float by[kPushBoxConstants];
    push_box_list(d.numbers, by);
    for (int k = 0; k < kPushBoxConstants; ++k) sums[k] += of_v * by[k];
    sums[6] += bar.x * a.v[t];  // x' = x + dt v'
    push_box_give(a, 0, t, of_v * d.pusher.x);
    push_box_give(a, 1, t, of_v * d.pusher.v);
    bar = {bar.x + of_v * d.box.x, of_v * d.box.v};
  }
  push_box_give(a, 2, 0, bar.x);
  push_box_give(a, 3, 0, bar.v);
  for (int k = 0; k < kPushBoxConstants; ++k) push_box_give(a, 4 + k, 0, sums[k]);
}

}  // namespace novaphy
