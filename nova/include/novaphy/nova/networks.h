// Operations of small neural networks, besides those of ops.h, and counter-based random numbers.
#pragma once

#include <array>
#include <cstdint>

#include "novaphy/nova/tensor.h"

namespace nova {

// Returns max(x, 0). The derivative is 1 above 0, and 0 below and at 0.
NOVAPHY_NOVA_API Tensor relu(const Tensor& x);
// Returns log(1 + e^x) without overflow. The derivative is 1 / (1 + e^-x).
NOVAPHY_NOVA_API Tensor softplus(const Tensor& x);
// Returns x weight^T + bias for x {n, k} or {k}, weight {m, k} and bias {m} or undefined. The
// result is {n, m} or {m}. Sums have the order of matmul.
NOVAPHY_NOVA_API Tensor linear(const Tensor& x, const Tensor& weight, const Tensor& bias = {});

// Random numbers that depend only on their position and key. Value (w, j) of {worlds, width} is
// lane j % 4 of Philox4x32-10 with the key `seed` and the counter (j / 4, w, step, stream). World w
// therefore has the same numbers for any number of worlds, threads and any device. `step` is int32
// {1} and is read when the launch runs, so a captured graph that advances the step draws new
// numbers. The numbers have no gradient.
struct RandomKey {
  uint64_t seed = 0;
  int32_t stream = 0;  // separates several draws of the same step
  int32_t first_world = 0;  // the world of the first row
};
// Returns numbers in [0, 1), multiples of 2^-24.
NOVAPHY_NOVA_API Tensor random_uniform(int64_t worlds, int64_t width, const RandomKey& key,
                                       const Tensor& step);
// Returns normal numbers with mean 0 and variance 1 (Box and Muller). Lanes 0, 1 and lanes 2, 3 are
// pairs.
NOVAPHY_NOVA_API Tensor random_normal(int64_t worlds, int64_t width, const RandomKey& key,
                                      const Tensor& step);
// Returns the four random words of Philox4x32-10 for a counter and a key.
NOVAPHY_NOVA_API std::array<uint32_t, 4> philox4x32(const std::array<uint32_t, 4>& counter,
                                                    const std::array<uint32_t, 2>& key);

}  // namespace nova
