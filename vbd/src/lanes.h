// SIMD lanes (core/lanes.h) as the scalar of the sweeps of VBD (sweep_kernels.h). The file also has
// the kernels for one instruction set.
#pragma once

#include "novaphy/math/types.h"

#define NOVAPHY_LANES novaphy::vbd::NOVAPHY_LEVEL
#include "novaphy/core/lanes.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

NOVAPHY_LANE_FN Lanes min(Lanes a, Lanes b) { return Lanes(a.v <= b.v ? a.v : b.v); }
NOVAPHY_LANE_FN Lanes max(Lanes a, Lanes b) { return Lanes(a.v >= b.v ? a.v : b.v); }
NOVAPHY_LANE_FN Lanes abs(Lanes a) { return Lanes((VectorF)((VectorI)a.v & INT32_MAX)); }
NOVAPHY_LANE_FN Lanes with_derivative(Lanes y, Lanes, Lanes) { return y; }

// gather4 loads the rows `index` of a table with 4 floats in a row, and drops the fourth float.
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

}  // namespace novaphy::vbd::NOVAPHY_LEVEL

// Included here because the templates use the lane functions above.
#define NOVAPHY_LANE_FN_APART [[gnu::noinline]]
#include "novaphy/vbd/sweep_kernels.h"
#include "sweep.h"

namespace novaphy::vbd {

template <>
struct LaneAccess<NOVAPHY_LEVEL::Lanes> {
  using Lanes = NOVAPHY_LEVEL::Lanes;
  using Mask = NOVAPHY_LEVEL::Mask;
  static constexpr int kLanes = LANES, kStride = LANES;
  using Particles = const int32_t*;
  NOVAPHY_LANE_FN static Vec3<Lanes> gather(const VbdRow* rows, const int32_t* index) {
    return NOVAPHY_LEVEL::gather(reinterpret_cast<const float*>(rows), index);
  }
  NOVAPHY_LANE_FN static Lanes load(const float* from) { return NOVAPHY_LEVEL::load(from); }
  NOVAPHY_LANE_FN static void store(float* to, Lanes values) { NOVAPHY_LEVEL::store(to, values); }
  NOVAPHY_LANE_FN static float get(Lanes values, int lane) { return values.v[lane]; }
  NOVAPHY_LANE_FN static void set(Lanes& values, int lane, float value) { values.v[lane] = value; }
  NOVAPHY_LANE_FN static bool get(Mask mask, int lane) { return mask.v[lane] != 0; }
  NOVAPHY_LANE_FN static void set(Mask& mask, int lane, bool value) { mask.v[lane] = -value; }
  NOVAPHY_LANE_FN static void put(VbdRow* rows, int32_t p, const Vec3<Lanes>& v, int lane) {
    rows[p].x = v.x.v[lane];
    rows[p].y = v.y.v[lane];
    rows[p].z = v.z.v[lane];
  }
  NOVAPHY_LANE_FN static void add(VbdRow* rows, int32_t p, const Vec3<Lanes>& v, int lane) {
    rows[p].x += v.x.v[lane];
    rows[p].y += v.y.v[lane];
    rows[p].z += v.z.v[lane];
  }
};

namespace NOVAPHY_LEVEL {

// Wraps a kernel over groups as a function over the rows of a launch. A row is one lane of a group.
template <class A, void (*body)(const A&, const LaneGroup<Lanes>&)>
void over_groups(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = novaphy::detail::arguments_of<A>(words);
  const VbdSweepArguments* sweep;
  if constexpr (__is_same(A, VbdSweepArguments)) {
    sweep = &a;
  } else {
    sweep = &a.sweep;
  }
  for (int64_t row = (begin + LANES - 1) / LANES * LANES; row < end; row += LANES)
    body(a, LaneGroup<Lanes>(*sweep, row));
}
template <void (*body)(const LaneGroup<Lanes>&)>
void of_sweep(const VbdSweepArguments&, const LaneGroup<Lanes>& g) {
  body(g);
}

// Defined in other files, which are compiled for the same instruction set: see SweepLevel.
GroupKernel adjoint, adjoint_outer, adjoint_stiffness, adjoint_start, tangent, tangent_stiffness,
    tangent_start, coarse_rows, coarse_force, coarse_outer;

}  // namespace NOVAPHY_LEVEL
}  // namespace novaphy::vbd
