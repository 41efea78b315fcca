// Differentiable operators for a sphere that pushes a box along a line: one step, and many steps as
// one operation. dynamics/semi_implicit/push_box_law.h has the law.
//
// The gradients of the law are exact, in all inputs. The law itself is a surrogate of contact. The
// force is smooth, acts up to a distance of a few times the length `softness`, and has no reaction
// on the sphere.
#pragma once

#include <utility>
#include <variant>

#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// A number, or a tensor {1} on the device of the box, which may have a gradient.
using PushBoxConstant = std::variant<float, nova::Tensor>;

// mass, dt, softness and friction_velocity are > 0, the other numbers >= 0. All are finite. Values
// of tensors are checked on the CPU outside of captures. In other cases a value that is not finite
// enters the results.
struct PushBoxParameters {
  PushBoxConstant mass;                       // kg
  PushBoxConstant half_extent;                // m, half the size of the box along the axis
  PushBoxConstant pusher_radius;              // m
  PushBoxConstant ke;                         // N/m
  PushBoxConstant kd;                         // N s/m
  PushBoxConstant friction;                   // coefficient
  PushBoxConstant dt;                         // s
  PushBoxConstant softness = 1e-3f;           // m
  PushBoxConstant friction_velocity = 1e-2f;  // m/s
  PushBoxConstant gravity = 9.81f;            // m/s^2
};

// Returns (box_x', box_v') {1}: position (m) and velocity (m/s) of the box's center after dt. The
// inputs {1} are position and velocity of the box's and the pusher's center. ErrorKind::Type: not a
// float32 tensor. ErrorKind::Value, with the argument's name: another shape or device, a number out
// of its range, or a state that is not finite.
NOVAPHY_DIFF_API std::pair<nova::Tensor, nova::Tensor> integrate_push_box_generated(
    const nova::Tensor& box_x, const nova::Tensor& box_v, const nova::Tensor& pusher_x,
    const nova::Tensor& pusher_v, const PushBoxParameters& parameters);

// Runs n > 0 steps as one operation, with the bits of n calls of integrate_push_box_generated.
// pusher_x and pusher_v {n} have a row per step. Returns (box_x, box_v) {n} after every step.
// ErrorKind::NotImplemented: a device other than the CPU.
NOVAPHY_DIFF_API std::pair<nova::Tensor, nova::Tensor> integrate_push_box_rollout_generated(
    const nova::Tensor& box_x, const nova::Tensor& box_v, const nova::Tensor& pusher_x,
    const nova::Tensor& pusher_v, const PushBoxParameters& parameters);

}  // namespace novaphy::diff
