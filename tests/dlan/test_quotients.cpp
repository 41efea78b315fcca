// Quotients and roots of device code with the generic seeds have the bits of the host.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <random>
#include <utility>

namespace device {
namespace {

#include "fake_driver/host_intrinsics.h"
#include "vendors/generic.cuh"
// The prelude needs the includes above.
#include "device_prelude.cuh"

bool same(float a, float b) { return uf_bits(a) == uf_bits(b) || (a != a && b != b); }

}  // namespace
}  // namespace device

namespace {

using device::ubits_f;

// All mantissas at an even and an odd exponent. Other exponents only multiply a root by a power of
// two.
TEST(GenericSeeds, EveryRootIsRoundedCorrectly) {
  for (const uint32_t exponent : {127u, 128u}) {
    for (uint32_t mantissa = 0; mantissa < 1u << 23; ++mantissa) {
      const float a = ubits_f(static_cast<int32_t>(exponent << 23 | mantissa));
      device::magnitudes m = device::kNoMagnitudes;
      ASSERT_TRUE(device::same(device::quick_sqrt(a, m), std::sqrt(a))) << a;
      ASSERT_TRUE(device::are_moderate(m));
    }
  }
}

TEST(GenericSeeds, QuotientsAreRoundedCorrectly) {
  std::mt19937_64 random(7);
  const auto expect = [](float a, float b) {
    ASSERT_TRUE(device::same(device::udiv(a, b), a / b)) << a << " / " << b;
  };
  const auto bits = [](uint64_t word) { return ubits_f(static_cast<int32_t>(word)); };
  // Operands with any exponents, zeros, denormals and NaNs included.
  for (int k = 0; k < 5000000; ++k) {
    const uint64_t word = random();
    expect(bits(word), bits(word >> 32));
  }
  // Moderate ones, where no test sends the quotient elsewhere; and mantissas near all ones and
  // zeros.
  for (int k = 0; k < 20000000; ++k) {
    const uint64_t word = random();
    const uint32_t a = static_cast<uint32_t>(word) & 0x7fffff, b = word >> 23 & 0x7fffff;
    expect(bits(127u << 23 | a), bits((word >> 62 != 0 ? 127u : 126u) << 23 | b));
  }
  for (uint32_t k = 0; k < 2000; ++k)
    for (uint32_t j = 0; j < 1000; ++j)
      expect(bits(127u << 23 | ((k & 1) != 0 ? 0x7fffffu - k / 2 : k / 2)),
             bits(127u << 23 | ((j & 1) != 0 ? 0x7fffffu - j / 2 : j / 2)));
}

}  // namespace
