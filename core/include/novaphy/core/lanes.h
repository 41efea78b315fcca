// Lanes: a SIMD vector of LANES floats that formulas treat as one scalar. Every operation acts on
// each lane and rounds like the operation on a float (math/scalar.h). Each lane therefore has the
// same bits as the formula in float.
//
// This header is compiled once for each instruction set. Its content lies in the namespace
// NOVAPHY_LANES, which differs between instruction sets, so that the linker never merges code of
// two sets. An operation that only one header needs is defined in that header.
#pragma once

#include <cstdint>

#if defined(__AVX__)
#include <immintrin.h>
#endif

#define NOVAPHY_LANE_FN [[gnu::always_inline]] inline

namespace NOVAPHY_LANES {

typedef float VectorF __attribute__((vector_size(4 * LANES)));
typedef int32_t VectorI __attribute__((vector_size(4 * LANES)));

struct Mask {
  VectorI v{};
};
struct Ints {
  VectorI v{};
  NOVAPHY_LANE_FN friend Ints operator|(Ints a, Ints b) { return {a.v | b.v}; }
  NOVAPHY_LANE_FN friend Ints operator^(Ints a, Ints b) { return {a.v ^ b.v}; }
  NOVAPHY_LANE_FN friend Ints operator&(Ints a, int32_t b) { return {a.v & b}; }
  NOVAPHY_LANE_FN friend Ints operator<<(Ints a, int b) { return {a.v << b}; }
  NOVAPHY_LANE_FN friend Mask operator==(Ints a, int32_t b) { return {a.v == b}; }
  NOVAPHY_LANE_FN friend Mask operator<(Ints a, int32_t b) { return {a.v < b}; }
};

struct Lanes {
  VectorF v{};
  Lanes() = default;
  NOVAPHY_LANE_FN explicit Lanes(float value) : v(VectorF{} + value) {}
  NOVAPHY_LANE_FN explicit Lanes(VectorF values) : v(values) {}

  NOVAPHY_LANE_FN friend Lanes operator+(Lanes a, Lanes b) { return Lanes(a.v + b.v); }
  NOVAPHY_LANE_FN friend Lanes operator-(Lanes a, Lanes b) { return Lanes(a.v - b.v); }
  NOVAPHY_LANE_FN friend Lanes operator*(Lanes a, Lanes b) { return Lanes(a.v * b.v); }
  NOVAPHY_LANE_FN friend Lanes operator/(Lanes a, Lanes b) { return Lanes(a.v / b.v); }
  NOVAPHY_LANE_FN friend Lanes operator-(Lanes a) { return Lanes(-a.v); }
  NOVAPHY_LANE_FN friend Mask operator<(Lanes a, Lanes b) { return {a.v < b.v}; }
  NOVAPHY_LANE_FN friend Mask operator>(Lanes a, Lanes b) { return {a.v > b.v}; }
  NOVAPHY_LANE_FN friend Mask operator<=(Lanes a, Lanes b) { return {a.v <= b.v}; }
  NOVAPHY_LANE_FN friend Mask operator>=(Lanes a, Lanes b) { return {a.v >= b.v}; }
  NOVAPHY_LANE_FN friend Mask operator==(Lanes a, Lanes b) { return {a.v == b.v}; }
};

NOVAPHY_LANE_FN Lanes select(Mask c, Lanes a, Lanes b) { return Lanes(c.v ? a.v : b.v); }
NOVAPHY_LANE_FN Mask both(Mask a, Mask b) { return {a.v & b.v}; }
NOVAPHY_LANE_FN Mask either(Mask a, Mask b) { return {a.v | b.v}; }
NOVAPHY_LANE_FN Ints float_bits(Lanes a) { return {(VectorI)a.v}; }
NOVAPHY_LANE_FN Lanes bits_float(Ints a) { return Lanes((VectorF)a.v); }
NOVAPHY_LANE_FN Lanes detach(Lanes a) { return a; }

NOVAPHY_LANE_FN Lanes sqrt(Lanes a) {
#if LANES == 16 && defined(__AVX512F__)
  return Lanes((VectorF)_mm512_sqrt_ps((__m512)a.v));
#elif LANES == 8 && defined(__AVX__)
  return Lanes((VectorF)_mm256_sqrt_ps((__m256)a.v));
#else
  Lanes r;
  for (int l = 0; l < LANES; ++l) r.v[l] = __builtin_sqrtf(a.v[l]);
  return r;
#endif
}
NOVAPHY_LANE_FN Lanes fma(Lanes a, Lanes b, Lanes c) {
#if LANES == 16 && defined(__AVX512F__)
  return Lanes((VectorF)_mm512_fmadd_ps((__m512)a.v, (__m512)b.v, (__m512)c.v));
#elif LANES == 8 && defined(__FMA__)
  return Lanes((VectorF)_mm256_fmadd_ps((__m256)a.v, (__m256)b.v, (__m256)c.v));
#else
  Lanes r;
  for (int l = 0; l < LANES; ++l) r.v[l] = __builtin_fmaf(a.v[l], b.v[l], c.v[l]);
  return r;
#endif
}

NOVAPHY_LANE_FN Lanes load(const float* p) {
  Lanes r;
  __builtin_memcpy(&r.v, p, sizeof(r.v));
  return r;
}
NOVAPHY_LANE_FN void store(float* p, Lanes a) { __builtin_memcpy(p, &a.v, sizeof(a.v)); }

}  // namespace NOVAPHY_LANES
