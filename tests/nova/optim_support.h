// Helpers shared by the tests of optimizers and of gradient clipping.
#pragma once

#include <limits>

#include "novaphy/nova/optim.h"
#include "support.h"

namespace novaphy::testing {

using nova::optim::Adam;
using nova::optim::SGD;
using Floats = std::vector<float>;

inline constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
inline constexpr float kInf = std::numeric_limits<float>::infinity();

inline Floats grad(const Tensor& x) { return x.grad().to_host(); }
inline ::testing::AssertionResult bits(const Tensor& actual, const Floats& expected) {
  const Floats values = actual.to_host();
  return same_bits(std::span<const float>(values), std::span<const float>(expected));
}
// A leaf with a gradient.
inline Tensor leaf(const Floats& values, const Floats& gradient) {
  const Tensor x = tensor(values, true);
  write(x.grad(), gradient);
  return x;
}

}  // namespace novaphy::testing
