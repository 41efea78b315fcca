// SIMD lanes (math/lanes.h) as the scalar type of the algorithms of articulations
// (articulation/scalar.h).
#pragma once

#include "novaphy/dynamics/articulation/scalar.h"

#define NOVAPHY_LANES novaphy::articulation::NOVAPHY_LEVEL
#include "novaphy/core/lanes.h"

namespace novaphy::articulation::NOVAPHY_LEVEL {

NOVAPHY_LANE_FN Mask negate(Mask a) { return {~a.v}; }
NOVAPHY_LANE_FN bool any(Mask a) {
#if LANES == 16 && defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)a.v, (__m512i)a.v) != 0;
#elif LANES == 8 && defined(__AVX__)
  return !_mm256_testz_si256((__m256i)a.v, (__m256i)a.v);
#else
  int32_t sum = 0;
  for (int l = 0; l < LANES; ++l) sum |= a.v[l];
  return sum != 0;
#endif
}
NOVAPHY_LANE_FN bool all(Mask a) { return !any(negate(a)); }

NOVAPHY_LANE_FN Mask has(Ints branches, int32_t any_bit) { return {(branches.v & any_bit) != 0}; }
NOVAPHY_LANE_FN Ints with(Ints branches, Mask c, int32_t bit) { return {branches.v | (c.v & bit)}; }
NOVAPHY_LANE_FN Ints to_branches(Lanes a) { return {__builtin_convertvector(a.v, VectorI)}; }
NOVAPHY_LANE_FN Lanes to_number(Ints a) { return Lanes(__builtin_convertvector(a.v, VectorF)); }
NOVAPHY_LANE_FN Mask differ(Ints a, Ints b) { return {a.v != b.v}; }
NOVAPHY_LANE_FN Ints select(Mask c, Ints a, Ints b) { return {c.v ? a.v : b.v}; }

NOVAPHY_LANE_FN Lanes min(Lanes a, Lanes b) { return select(negate(a > b), a, b); }
NOVAPHY_LANE_FN Lanes max(Lanes a, Lanes b) { return select(negate(a < b), a, b); }
NOVAPHY_LANE_FN Lanes abs(Lanes a) { return Lanes((VectorF)((VectorI)a.v & INT32_MAX)); }
NOVAPHY_LANE_FN Lanes floor(Lanes a) {
#if LANES == 16 && defined(__AVX512F__)
  return Lanes((VectorF)_mm512_roundscale_ps((__m512)a.v, 1));
#elif LANES == 8 && defined(__AVX__)
  return Lanes((VectorF)_mm256_floor_ps((__m256)a.v));
#else
  Lanes r;
  for (int l = 0; l < LANES; ++l) r.v[l] = __builtin_floorf(a.v[l]);
  return r;
#endif
}
// Truncates toward zero and saturates; NaN becomes 0.
NOVAPHY_LANE_FN Ints to_int(Lanes a) {
  const VectorI number = a.v == a.v, low = a.v <= -2147483648.0f, high = a.v >= 2147483648.0f;
  const VectorI inside = number & ~low & ~high;
  const VectorI value = __builtin_convertvector((VectorF)((VectorI)a.v & inside), VectorI);
  return {(value & inside) | (low & INT32_MIN) | (high & INT32_MAX)};
}

NOVAPHY_LANE_FN Lanes square_root(Lanes a) { return sqrt(a); }
// Returns whether all lanes are finite.
NOVAPHY_LANE_FN bool is_finite(Lanes a) { return all(a - a == Lanes(0.0f)); }
NOVAPHY_LANE_FN SinCos<Lanes> sin_cos(Lanes a) {
  const auto v = math::functions_detail::sin_cos(a);
  return {v.sin, v.cos};
}
NOVAPHY_LANE_FN Lanes angle_of(Lanes sine, Lanes cosine) {
  return math::functions_detail::atan2_value(sine, cosine).value;
}

}  // namespace novaphy::articulation::NOVAPHY_LEVEL

namespace novaphy::articulation {
template <>
struct BranchesOf<NOVAPHY_LEVEL::Lanes> {
  using Type = NOVAPHY_LEVEL::Ints;
};
}  // namespace novaphy::articulation
