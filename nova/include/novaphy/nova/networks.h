// Operations of small networks, besides ops.h, and random numbers without a state.
#pragma once

#include <array>
#include <cstdint>

#include "novaphy/nova/tensor.h"

namespace nova {

// max(x, 0): derivative 1 above 0, 0 below and at 0.
NOVAPHY_NOVA_API Tensor relu(const Tensor& x);
// log(1 + e^x) without overflow; derivative 1 / (1 + e^-x).
NOVAPHY_NOVA_API Tensor softplus(const Tensor& x);
// x weight^T + bias: x {n, k} or {k}, weight {m, k}, bias {m} or undefined, to {n, m} or {m}. Sums
// as in matmul.
NOVAPHY_NOVA_API Tensor linear(const Tensor& x, const Tensor& weight, const Tensor& bias = {});

// Numbers that depend on where they stand and on nothing else: value (w, j) of {worlds, width} is
// of Philox4x32-10 with the key `seed` and the counter (j / 4, w, step, stream), lane j % 4. So
// world w has the same numbers however many worlds there are, on every device and for any number of
// threads. `step`: int32 {1}, read when the launch runs, so a captured graph whose step advances
// gives new numbers. No gradient.
struct RandomKey {
  uint64_t seed = 0;
  int32_t stream = 0;  // sets apart what is drawn in the same step
  int32_t first_world = 0;  // the number of the first row: w counts from it
};
// In [0, 1), multiples of 2^-24.
NOVAPHY_NOVA_API Tensor random_uniform(int64_t worlds, int64_t width, const RandomKey& key,
                                       const Tensor& step);
// Mean 0, variance 1, by Box and Muller: lanes 0, 1 and lanes 2, 3 are pairs.
NOVAPHY_NOVA_API Tensor random_normal(int64_t worlds, int64_t width, const RandomKey& key,
                                      const Tensor& step);
// The four words of a counter.
NOVAPHY_NOVA_API std::array<uint32_t, 4> philox4x32(const std::array<uint32_t, 4>& counter,
                                                    const std::array<uint32_t, 2>& key);

}  // namespace nova
