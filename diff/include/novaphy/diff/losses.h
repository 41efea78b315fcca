// Losses and small operators of the examples. All inputs and results are float32; all gradients are
// exact.
#pragma once

#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Returns |q[particle_index] - target|^2 {1} (m^2) for particle_q {n, 3}. ErrorKind::Index: no such
// particle.
NOVAPHY_DIFF_API nova::Tensor particle_point_loss_generated(const nova::Tensor& particle_q,
                                                            int64_t particle_index, float target_x,
                                                            float target_y, float target_z);
// Returns the mean position {1, 3} (m), not weighted by mass. Each position is divided by n, and
// the quotients are summed in order.
NOVAPHY_DIFF_API nova::Tensor particle_centroid_generated(const nova::Tensor& particle_q);
// Returns |point - target|^2 {1} (m^2) for a point {1, 3} or {3}.
NOVAPHY_DIFF_API nova::Tensor vec3_point_loss_generated(const nova::Tensor& point, float target_x,
                                                        float target_y, float target_z);
// Returns x limited to [lower, upper]. The gradient is 1 inside and at the bounds, 0 outside.
// ErrorKind::Value: not lower <= upper.
NOVAPHY_DIFF_API nova::Tensor clamp_f32_generated(const nova::Tensor& x, float lower, float upper);

}  // namespace novaphy::diff
