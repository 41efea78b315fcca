// Losses and small operators of rigid bodies. All inputs and results are float32. All gradients are
// exact. The four numbers of a quaternion count as independent.
#pragma once

#include <cstdint>

#include "novaphy/diff/export.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Returns rows (linear_x, linear_y, linear_z, omega) {b, 6}, as initial values of
// SimState::body_qd. omega is {b, 3} (rad/s). All bodies have the same linear velocity (m/s), which
// has no gradient.
NOVAPHY_DIFF_API nova::Tensor body_twist_from_omega_generated(const nova::Tensor& omega,
                                                              float linear_x, float linear_y,
                                                              float linear_z);

struct OrientationLossOptions {
  float axis_weight_a = 1.0f, axis_weight_b = 1.0f;
  float target_height = 0.0f;            // m, target of the z coordinate of the body's origin
  float height_weight = 0.0f;            // 1/m^2
  float linear_velocity_weight = 0.0f;   // s^2/m^2
  float angular_velocity_weight = 0.0f;  // s^2
};

// Returns the loss {1} of one body, for body_q {b, 7} and body_qd {b, 6}:
//   wa (1 - dot(R a, ta)) + wb (1 - dot(R b, tb)) + wh (z - h)^2 + wv |v|^2 + ww |w|^2
// R is the rotation of the body, z the height of its origin (m), v its linear velocity (m/s) and w
// its angular velocity (rad/s). wa to ww and h are the weights and the height of the options, in
// order. The axes a, b (body frame) and ta, tb (world frame) are normalized. ErrorKind::Index: no
// such body. ErrorKind::Value: an axis of length 0, or numbers that are not finite.
NOVAPHY_DIFF_API nova::Tensor rigid_orientation_velocity_loss_generated(
    const nova::Tensor& body_q, const nova::Tensor& body_qd, int64_t body_index,
    const Vec3f& local_axis_a, const Vec3f& target_axis_a, const Vec3f& local_axis_b,
    const Vec3f& target_axis_b, const OrientationLossOptions& options = {});

}  // namespace novaphy::diff
