// Optimiser updates as kernels: in place, never recorded on a tape, capturable.
#pragma once

#include "novaphy/nova/tensor.h"

namespace nova {

// param -= learning_rate * param.grad. Throws ErrorKind::Value when there is no gradient.
NOVAPHY_NOVA_API void sgd_update_f32(const Tensor& param, float learning_rate);

// Per row of param {n, 3}: a gradient with a value that is not finite leaves the row unchanged; a
// gradient longer than max_gradient_norm is scaled to it; p -= learning_rate * g; a result longer
// than max_parameter_norm is scaled to it. A norm <= 0 switches that clip off.
NOVAPHY_NOVA_API void sgd_update_vec3_clipped_f32(const Tensor& param, float learning_rate,
                                                  float max_parameter_norm,
                                                  float max_gradient_norm);

}  // namespace nova
