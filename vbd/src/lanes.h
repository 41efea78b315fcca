// Lanes: LANES floats that formulas treat as one scalar. Every operation acts on each lane and
// rounds as the float's (math/scalar.h), so a lane has the bits that the formula has of a float.
//
// Compiled once for each instruction set, so all of it is in a namespace of the level: nothing of
// it may be merged with what another level made.
#pragma once

#include <cstdint>

#include "novaphy/math/types.h"
#if defined(__AVX__)
#include <immintrin.h>
#endif

namespace novaphy::vbd::NOVAPHY_VBD_LEVEL {

typedef float VectorF __attribute__((vector_size(4 * LANES)));
typedef int32_t VectorI __attribute__((vector_size(4 * LANES)));

#define NOVAPHY_LANE_FN [[gnu::always_inline]] inline

struct Mask {
  VectorI v{};
};

struct Ints {
  VectorI v{};
  friend Ints operator|(Ints a, Ints b) { return {a.v | b.v}; }
  friend Ints operator&(Ints a, int32_t b) { return {a.v & b}; }
  friend Mask operator<(Ints a, int32_t b) { return {a.v < b}; }
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
NOVAPHY_LANE_FN Lanes min(Lanes a, Lanes b) { return Lanes(a.v <= b.v ? a.v : b.v); }
NOVAPHY_LANE_FN Lanes max(Lanes a, Lanes b) { return Lanes(a.v >= b.v ? a.v : b.v); }
NOVAPHY_LANE_FN Ints float_bits(Lanes a) { return {(VectorI)a.v}; }
NOVAPHY_LANE_FN Lanes bits_float(Ints a) { return Lanes((VectorF)a.v); }
NOVAPHY_LANE_FN Lanes abs(Lanes a) { return Lanes((VectorF)((VectorI)a.v & INT32_MAX)); }
NOVAPHY_LANE_FN Lanes detach(Lanes a) { return a; }
NOVAPHY_LANE_FN Lanes with_derivative(Lanes y, Lanes, Lanes) { return y; }

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

// The rows `index` of a table of 4 floats each, but for the last float.
typedef float Row __attribute__((vector_size(16)));
struct Four {
  Row x, y, z;
};
NOVAPHY_LANE_FN Four gather4(const float* table, const int32_t* index) {
  Row r[4];
  for (int l = 0; l < 4; ++l)
    __builtin_memcpy(&r[l], table + 4 * static_cast<int64_t>(index[l]), sizeof(Row));
  const Row a = __builtin_shufflevector(r[0], r[1], 0, 4, 1, 5);
  const Row b = __builtin_shufflevector(r[2], r[3], 0, 4, 1, 5);
  const Row c = __builtin_shufflevector(r[0], r[1], 2, 6, 3, 7);
  const Row d = __builtin_shufflevector(r[2], r[3], 2, 6, 3, 7);
  return {__builtin_shufflevector(a, b, 0, 1, 4, 5), __builtin_shufflevector(a, b, 2, 3, 6, 7),
          __builtin_shufflevector(c, d, 0, 1, 4, 5)};
}
#define NOVAPHY_JOIN8(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7)
#define NOVAPHY_JOIN16(a, b) \
  __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
NOVAPHY_LANE_FN Vec3<Lanes> gather(const float* table, const int32_t* index) {
  const Four p = gather4(table, index);
#if LANES == 4
  return {Lanes(p.x), Lanes(p.y), Lanes(p.z)};
#else
  const Four q = gather4(table, index + 4);
#if LANES == 8
  return {Lanes(NOVAPHY_JOIN8(p.x, q.x)), Lanes(NOVAPHY_JOIN8(p.y, q.y)),
          Lanes(NOVAPHY_JOIN8(p.z, q.z))};
#else
  const Four r = gather4(table, index + 8), s = gather4(table, index + 12);
  const auto join = [](Row a, Row b, Row c, Row d) {
    return Lanes(NOVAPHY_JOIN16(NOVAPHY_JOIN8(a, b), NOVAPHY_JOIN8(c, d)));
  };
  return {join(p.x, q.x, r.x, s.x), join(p.y, q.y, r.y, s.y), join(p.z, q.z, r.z, s.z)};
#endif
#endif
}

}  // namespace novaphy::vbd::NOVAPHY_VBD_LEVEL
