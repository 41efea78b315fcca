// Actuators: their contribution to the drives and forces of a step.
//
// An actuator has the length l = gear q and the rate v = gear qd of its degree of freedom, and
//   c      the control, clipped to ctrl_range, or the activation if the actuator has dynamics
//   force  (gain0 + gain1 l + gain2 v) c + bias0 + bias1 l + bias2 v, clipped to force_range
// The force on the degree of freedom is gear times this force. The coefficients of l and v must not
// be positive. These coefficients become a stiffness and a damping of the drive (drives.h), so a
// step is as stable as with drives. The remaining coefficients give the drive's target, or a plain
// force if nothing depends on l and v. The force range of a servo becomes the effort limit of the
// drive about the middle of the range. Dynamics:
//   integrator   act' = c
//   filter       act' = (c - act) / time, explicit; filter_exact: its solution over the step
// Afterwards act is clipped to act_range. Source: MuJoCo, "Computation", actuation model.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/dual.h"

namespace novaphy::articulation {

// The arrays that actuators read in a step. The first six are inputs of drives, which actuators
// modify and write as outputs.
enum ActuationInput : int32_t {
  kJointForce,
  kTarget,
  kTargetRate,
  kStiffness,
  kDamping,
  kEffort,
  kActuated,  // number of inputs that are also outputs
  kControl = kActuated,
  kActivation,
  kGear,
  kTime,
  kGain,
  kBias,
  kControlRange,
  kForceRange,
  kActivationRange,
  kActuationInputs,
  kWrench = kActuationInputs,  // for actuators on bodies (body_actuation.h)
  kActuatorInputs
};
inline constexpr int32_t kNextActivation = kActuated, kActuationOutputs = kActuated + 1;
inline int32_t numbers_of_input(int32_t input) {
  if (input < kGain) return 1;
  if (input == kWrench) return 6;
  return input < kControlRange ? 3 : 2;
}

// The arguments of an actuation kernel, with one row per dof. The actuators of dof d are
// order[first[d]] to order[first[d + 1] - 1]. `coord` is the coordinate of each dof. A negative
// value marks a dof of a BALL, FREE or DISTANCE joint. The first dof of a BALL joint has -2 - its
// first coordinate, since its four targets are copied. Actuators on bodies (`dof` -1) are listed
// with an arbitrary dof, for their activations.
struct Actuation {
  NOVAPHY_ARGUMENTS(Reads<int32_t> first, order, coord, dof, state, dynamics;
                    novaphy::Each<Detached<Reads<float>>, kActuationInputs> in; Number<float> dt;)
};

inline DualFloat clipped(const DualFloat& x, const DualFloat& lower, const DualFloat& upper) {
  if (x < lower) return lower;
  return x > upper ? upper : x;
}
// Returns 1 - exp(-x) for x >= 0, accurate for small x. This is the part of a filter's step that
// the activation covers.
inline DualFloat part_reached(const DualFloat& x) {
  const float left = math::exp(-x.value), v = x.value;
  const float small =
      v * (1.0f - v / 2.0f * (1.0f - v / 3.0f * (1.0f - v / 4.0f * (1.0f - v / 5.0f))));
  return {v < 0.1f ? small : 1.0f - left, left * x.tangent};
}

// Computes the activation after the step. number(input, row, k) returns number k of a row of an
// input. put(output, row, value) writes an output.
template <class Number, class Put>
void next_activation(const Actuation& a, int32_t actuator, const DualFloat& control,
                     const Number& number, const Put& put) {
  const int32_t state = a.state[actuator], dynamics = a.dynamics[actuator];
  const DualFloat act = number(kActivation, state, 0), dt = a.dt.value;
  DualFloat part = dt;
  if (dynamics > 1) {
    const DualFloat time = number(kTime, actuator, 0), least = 1e-15f;
    part = dt / (time < least ? least : time);
  }
  if (dynamics == 3) part = part_reached(part);
  const DualFloat next = dynamics == 1 ? act + part * control : act + part * (control - act);
  put(kNextActivation, state,
      clipped(next, number(kActivationRange, actuator, 0), number(kActivationRange, actuator, 1)));
}

// The force of one actuator at its control or activation: part + by_length l + by_rate v (before
// the clip).
struct ActuatorForce {
  DualFloat gear, part, by_length, by_rate, lower, upper;
  bool is_servo, is_limited;
};
template <class Number>
ActuatorForce actuator_force(int32_t actuator, const DualFloat& input, const Number& number) {
  const auto gain = [&](int32_t k) { return number(kGain, actuator, k); };
  const auto bias = [&](int32_t k) { return number(kBias, actuator, k); };
  ActuatorForce f;
  f.gear = number(kGear, actuator, 0);
  f.part = gain(0) * input + bias(0);
  f.by_length = gain(1) * input + bias(1);
  f.by_rate = gain(2) * input + bias(2);
  f.lower = number(kForceRange, actuator, 0);
  f.upper = number(kForceRange, actuator, 1);
  f.is_servo = gain(1).value != 0.0f || gain(2).value != 0.0f || bias(1).value != 0.0f ||
               bias(2).value != 0.0f;
  f.is_limited = f.lower.value > -1e10f || f.upper.value < 1e10f;
  return f;
}
template <class Number>
DualFloat clipped_control(int32_t actuator, const Number& number) {
  return clipped(number(kControl, actuator, 0), number(kControlRange, actuator, 0),
                 number(kControlRange, actuator, 1));
}
// Returns the control or the activation of an actuator. `state`: row of its activation; -1: none.
template <class Number>
DualFloat actuator_input(int32_t actuator, int32_t state, const Number& number) {
  return state < 0 ? clipped_control(actuator, number) : number(kActivation, state, 0);
}

// Writes the target of a coordinate, or copies the four targets of a BALL joint, which no actuator
// changes.
template <class Number, class Put>
void put_targets(int32_t coord, const DualFloat& target, const Number& number, const Put& put) {
  if (coord >= 0) put(kTarget, coord, target);
  for (int32_t c = -2 - coord; coord < -1 && c < 2 - coord; ++c)
    put(kTarget, c, number(kTarget, c, 0));
}

// Computes the drive and the force of a degree of freedom, and the activations of its actuators.
template <class Number, class Put>
void actuate(const Actuation& a, int32_t dof, const Number& number, const Put& put) {
  const DualFloat none = 0.0f, half = 0.5f;
  const int32_t coord = a.coord[dof];
  DualFloat force = number(kJointForce, dof, 0), rate = number(kTargetRate, dof, 0),
            stiffness = number(kStiffness, dof, 0), damping = number(kDamping, dof, 0),
            effort = number(kEffort, dof, 0), target = coord < 0 ? none : number(kTarget, coord, 0);
  if (a.first[dof] < a.first[dof + 1]) {
    const DualFloat pull = stiffness * target, drag = damping * rate;
    DualFloat servo = none;
    for (int32_t i = a.first[dof]; i < a.first[dof + 1]; ++i) {
      const int32_t k = a.order[i];
      DualFloat input = clipped_control(k, number);
      if (a.state[k] >= 0) {
        next_activation(a, k, input, number, put);
        input = number(kActivation, a.state[k], 0);
      }
      if (a.dof[k] < 0) continue;
      const ActuatorForce f = actuator_force(k, input, number);
      const bool is_cut = !f.is_servo && (f.part < f.lower || f.part > f.upper);
      if (!is_cut) {
        stiffness = stiffness - f.gear * f.gear * f.by_length;
        damping = damping - f.gear * f.gear * f.by_rate;
      }
      if (!f.is_servo) {
        force = force + f.gear * clipped(f.part, f.lower, f.upper);
        continue;
      }
      DualFloat part = f.part;
      if (f.is_limited) {
        const DualFloat middle = half * (f.lower + f.upper);
        const DualFloat most = f.gear * (half * (f.upper - f.lower));
        const DualFloat size = most < none ? -most : most;
        if (size < effort) effort = size;
        force = force + f.gear * middle;
        part = part - middle;
      }
      servo = servo + f.gear * part;
    }
    if (stiffness > none) {
      target = (pull + servo) / stiffness;
    } else {
      target = none;
      force = force + pull;
    }
    const DualFloat to_rate = stiffness > none ? drag : drag + servo;
    if (damping > none) {
      rate = to_rate / damping;
    } else {
      rate = none;
      force = force + to_rate;
    }
  }
  put(kJointForce, dof, force);
  put_targets(coord, target, number, put);
  put(kTargetRate, dof, rate);
  put(kStiffness, dof, stiffness);
  put(kDamping, dof, damping);
  put(kEffort, dof, effort);
}

}  // namespace novaphy::articulation
