// Losses and small operators of rigid bodies. All inputs and results are float32; all gradients are
// exact, those of quaternions as four free numbers.
#pragma once

#include <cstdint>

#include "novaphy/diff/export.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Rows (linear_x, linear_y, linear_z, omega), {b, 6}: a start for SimState::body_qd. omega {b, 3},
// rad/s; the linear velocity (m/s) is that of all bodies and has no gradient.
NOVAPHY_DIFF_API nova::Tensor body_twist_from_omega_generated(const nova::Tensor& omega,
                                                              float linear_x, float linear_y,
                                                              float linear_z);

struct OrientationLossOptions {
  float axis_weight_a = 1.0f, axis_weight_b = 1.0f;
  float target_height = 0.0f;            // m, of the body's origin along z
  float height_weight = 0.0f;            // 1/m^2
  float linear_velocity_weight = 0.0f;   // s^2/m^2
  float angular_velocity_weight = 0.0f;  // s^2
};

// wa (1 - dot(R a, ta)) + wb (1 - dot(R b, tb)) + wh (z - h)^2 + wv |v|^2 + ww |w|^2 of one body,
// {1}. body_q {b, 7}, body_qd {b, 6}. The axes (a, b in the body, ta, tb in the world) are made
// unit vectors. ErrorKind::Index: no such body; ErrorKind::Value: an axis of length 0, numbers that
// are not finite.
NOVAPHY_DIFF_API nova::Tensor rigid_orientation_velocity_loss_generated(
    const nova::Tensor& body_q, const nova::Tensor& body_qd, int64_t body_index,
    const Vec3f& local_axis_a, const Vec3f& target_axis_a, const Vec3f& local_axis_b,
    const Vec3f& target_axis_b, const OrientationLossOptions& options = {});

}  // namespace novaphy::diff
