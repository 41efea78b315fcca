// Philox4x32-10, a counter-based random number generator without a state: a counter of 128 bits and
// a key of 64 bits give 128 random bits.
//
// Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3" (SC 2011). The
// functions are templates over the integer type I: PhiloxWord runs, nova::Int is traced.
#pragma once

#include <cstdint>

namespace novaphy::math {

// A 32-bit integer whose arithmetic wraps.
struct PhiloxWord {
  uint32_t bits = 0;
  PhiloxWord() = default;
  PhiloxWord(int32_t value) : bits(static_cast<uint32_t>(value)) {}
};
inline PhiloxWord philox_word(uint32_t bits) { return {static_cast<int32_t>(bits)}; }
inline PhiloxWord operator+(PhiloxWord a, PhiloxWord b) { return philox_word(a.bits + b.bits); }
inline PhiloxWord operator*(PhiloxWord a, PhiloxWord b) { return philox_word(a.bits * b.bits); }
inline PhiloxWord operator^(PhiloxWord a, PhiloxWord b) { return philox_word(a.bits ^ b.bits); }
inline PhiloxWord operator&(PhiloxWord a, PhiloxWord b) { return philox_word(a.bits & b.bits); }
inline PhiloxWord shift_right_unsigned(PhiloxWord a, PhiloxWord n) {
  return philox_word(a.bits >> n.bits);
}

// Returns the upper 32 bits of a product, computed from halves of 16 bits.
template <class I>
I philox_high(const I& a, uint32_t factor) {
  const I half = I(16), mask = I(0xFFFF);
  const I low = a & mask, high = shift_right_unsigned(a, half);
  const I factor_low = I(static_cast<int32_t>(factor & 0xFFFFu));
  const I factor_high = I(static_cast<int32_t>(factor >> 16));
  const I first = high * factor_low + shift_right_unsigned(low * factor_low, half);
  const I second = low * factor_high + (first & mask);
  return (high * factor_high + shift_right_unsigned(first, half)) +
         shift_right_unsigned(second, half);
}

template <class I>
struct Philox {
  I word[4];
};

template <class I>
Philox<I> philox4x32_10(Philox<I> x, I key0, I key1) {
  constexpr uint32_t kFactor0 = 0xD2511F53u, kFactor1 = 0xCD9E8D57u;
  const I step0 = I(static_cast<int32_t>(0x9E3779B9u)),
          step1 = I(static_cast<int32_t>(0xBB67AE85u));
  for (int round = 0; round < 10; ++round) {
    const I low0 = x.word[0] * I(static_cast<int32_t>(kFactor0));
    const I low1 = x.word[2] * I(static_cast<int32_t>(kFactor1));
    const I high0 = philox_high(x.word[0], kFactor0), high1 = philox_high(x.word[2], kFactor1);
    x = {{(high1 ^ x.word[1]) ^ key0, low1, (high0 ^ x.word[3]) ^ key1, low0}};
    key0 = key0 + step0;
    key1 = key1 + step1;
  }
  return x;
}

}  // namespace novaphy::math
