// Losses and small operators of the examples. All inputs and results are float32; all gradients are
// exact.
#pragma once

#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// |q[particle_index] - target|^2, {1}, m^2. particle_q {n, 3}; ErrorKind::Index when the particle
// is not there.
NOVAPHY_DIFF_API nova::Tensor particle_point_loss_generated(const nova::Tensor& particle_q,
                                                            int64_t particle_index, float target_x,
                                                            float target_y, float target_z);
// Mean position, not weighted by mass, {1, 3}, m: each particle's position is divided by n, then
// summed in order.
NOVAPHY_DIFF_API nova::Tensor particle_centroid_generated(const nova::Tensor& particle_q);
// |point - target|^2, {1}, m^2. point {1, 3} or {3}.
NOVAPHY_DIFF_API nova::Tensor vec3_point_loss_generated(const nova::Tensor& point, float target_x,
                                                        float target_y, float target_z);
// x limited to [lower, upper]; gradient 1 inside and at the bounds, 0 outside. ErrorKind::Value
// unless lower <= upper.
NOVAPHY_DIFF_API nova::Tensor clamp_f32_generated(const nova::Tensor& x, float lower, float upper);

}  // namespace novaphy::diff
