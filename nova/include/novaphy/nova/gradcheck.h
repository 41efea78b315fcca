// Gradient checks: is what the tape says the derivative of what the code computes?
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

struct GradcheckOptions {
  float epsilon = 1e-3f;  // step of the central difference, relative to max(1, |x|)
  float rtol = 2e-2f;     // |ad - fd| <= atol + rtol * max|fd|: float32 differences are noisy
  float atol = 1e-4f;
  float dot_product_tolerance = 1e-3f;
};

struct GradcheckResult {
  bool ok = true;
  float max_abs_error = 0.0f;
  float max_rel_error = 0.0f;  // relative to the largest difference quotient of that input
  std::string worst;           // "input 1, value 4: ad 0.5, fd 0.4"
  // The dot-product identity: the derivative in one random direction u, once as J u (Tape::jvp) and
  // once as <u, gradient>, which agree to rounding whatever the step of the differences. The error
  // is relative to the sum of |u_i gradient_i|.
  bool has_tangent = true;  // false: an operation of fn has none, and the error is 0
  float dot_product_error = 0.0f;
};

// Compares Tape::backward of the scalar fn(inputs) with central differences, value by value of
// every input, and with Tape::jvp in one random direction. The inputs' values, gradients and
// requires_grad are as before when it returns, or throws what fn threw.
// Errors: ErrorKind::Value for an epsilon that is not positive, a negative tolerance, or one memory
// given twice.
NOVAPHY_NOVA_API GradcheckResult
gradcheck(const std::function<Tensor(const std::vector<Tensor>&)>& fn,
          const std::vector<Tensor>& inputs, const GradcheckOptions& options = {});

}  // namespace nova
