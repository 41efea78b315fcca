// Gradient checks: compares the gradients of a tape with difference quotients of the computed
// function.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

struct GradcheckOptions {
  float epsilon = 1e-3f;  // step of the central difference, relative to max(1, |x|)
  float rtol = 2e-2f;     // a derivative passes if |ad - fd| <= atol + rtol * max|fd|; float32 is
                          // noisy
  float atol = 1e-4f;
  float dot_product_tolerance = 1e-3f;
};

struct GradcheckResult {
  bool ok = true;
  float max_abs_error = 0.0f;
  float max_rel_error = 0.0f;  // relative to the input's largest difference quotient
  std::string worst;           // "input 1, value 4: ad 0.5, fd 0.4"
  // The dot product test. For a random direction u, the directional derivative J u from Tape::jvp
  // is compared with <u, gradient>. The two agree to rounding, because neither uses differences.
  // The error is relative to the sum of |u_i gradient_i|.
  bool has_tangent = true;  // false: an operation has no tangent; the error is then 0
  float dot_product_error = 0.0f;
};

// Compares Tape::backward of the scalar fn(inputs) with central differences in every value of every
// input, and with Tape::jvp in one random direction. Values, gradients and requires_grad of the
// inputs are restored, also when fn throws. ErrorKind::Value: an epsilon <= 0, a negative
// tolerance, or inputs that share memory.
NOVAPHY_NOVA_API GradcheckResult
gradcheck(const std::function<Tensor(const std::vector<Tensor>&)>& fn,
          const std::vector<Tensor>& inputs, const GradcheckOptions& options = {});

}  // namespace nova
