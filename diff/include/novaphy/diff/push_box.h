// A box on a line that a sphere pushes, as differentiable operators: one step, and many as one
// operation. The law: dynamics/semi_implicit/push_box_law.h.
//
// Gradients: those of the law are exact, in all inputs. The law itself is a surrogate of contact:
// it is smooth, acts at a distance of a few `softness`, and does not push back on the pusher.
#pragma once

#include <utility>
#include <variant>

#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// A number, or a tensor {1} with the device of the box, whose gradient is wanted.
using PushBoxNumber = std::variant<float, nova::Tensor>;

// mass, dt, softness and friction_velocity are > 0, the others >= 0; all finite. Values of tensors
// are looked at on the cpu outside of captures; elsewhere what is not finite goes into the results.
struct PushBoxParameters {
  PushBoxNumber mass;                       // kg
  PushBoxNumber half_extent;                // m, of the box along the axis
  PushBoxNumber pusher_radius;              // m
  PushBoxNumber ke;                         // N/m
  PushBoxNumber kd;                         // N s/m
  PushBoxNumber friction;                   // coefficient
  PushBoxNumber dt;                         // s
  PushBoxNumber softness = 1e-3f;           // m
  PushBoxNumber friction_velocity = 1e-2f;  // m/s
  PushBoxNumber gravity = 9.81f;            // m/s^2
};

// (box_x', box_v') {1}: position (m) and velocity (m/s) of the box's center after dt, from those of
// the box and of the pusher's center {1}. ErrorKind::Type: no float32 tensor; ErrorKind::Value,
// naming the argument: another shape or device, a number out of its range, a state not finite.
NOVAPHY_DIFF_API std::pair<nova::Tensor, nova::Tensor> integrate_push_box_generated(
    const nova::Tensor& box_x, const nova::Tensor& box_v, const nova::Tensor& pusher_x,
    const nova::Tensor& pusher_v, const PushBoxParameters& parameters);

// n steps as one operation: the pusher is at row t in step t, pusher_x and pusher_v {n}; (box_x,
// box_v) {n} behind every step. The bits of n calls of the above; n > 0. On the cpu:
// ErrorKind::NotImplemented elsewhere.
NOVAPHY_DIFF_API std::pair<nova::Tensor, nova::Tensor> integrate_push_box_rollout_generated(
    const nova::Tensor& box_x, const nova::Tensor& box_v, const nova::Tensor& pusher_x,
    const nova::Tensor& pusher_v, const PushBoxParameters& parameters);

}  // namespace novaphy::diff
