// The scalar functions of articulations for float and double. dual.h has them for dual numbers, and
// src/featherstone/lanes.h for SIMD lanes.
//
// A scalar may have several SIMD lanes. The algorithms therefore never branch on one number, but
// only on whether all or any of the lanes meet a condition. Comparisons return masks, and `select`
// chooses by mask. A float has one lane, and its masks are bool.
#pragma once

#include "novaphy/math/functions.h"

namespace novaphy::articulation {

// The type of branch bits (limits.h), per lane.
template <class T>
struct BranchesOf {
  using Type = int32_t;
};
template <class T>
using Branches = typename BranchesOf<T>::Type;
inline bool has(int32_t branches, int32_t any_bit) { return (branches & any_bit) != 0; }
inline int32_t with(int32_t branches, bool c, int32_t bit) { return c ? branches | bit : branches; }
inline bool differ(int32_t a, int32_t b) { return a != b; }
// Convert branch bits to a number and back, exactly.
inline int32_t to_branches(float x) { return static_cast<int32_t>(x); }
inline float to_number(int32_t branches) { return static_cast<float>(branches); }

using math::both;
using math::either;
using math::negate;
template <class T>
T select(bool c, const T& a, const T& b) {
  return c ? a : b;
}
inline bool all(bool c) { return c; }
inline bool(any)(bool c) { return c; }  // a macro of the same meaning in device code

template <class T>
struct SinCos {
  T sin{}, cos{};
};
inline SinCos<float> sin_cos(float x) {
  const auto v = math::functions_detail::sin_cos(x);
  return {v.sin, v.cos};
}
inline float square_root(float x) { return math::sqrt(x); }
// Returns the angle of the direction (cosine, sine) from the x axis (rad).
inline float angle_of(float sine, float cosine) { return math::atan2(sine, cosine); }
inline bool is_finite(float x) { return x - x == 0.0f; }

#ifndef NOVAPHY_KERNEL  // devices have double, but not these functions
inline int32_t to_branches(double x) { return static_cast<int32_t>(x); }
inline SinCos<double> sin_cos(double x) { return {std::sin(x), std::cos(x)}; }
inline double square_root(double x) { return std::sqrt(x); }
inline double angle_of(double sine, double cosine) { return std::atan2(sine, cosine); }
inline bool is_finite(double x) { return x - x == 0.0; }
// For functions that few trees need: not inlined, which keeps their callers small.
#define NOVAPHY_SELDOM __attribute__((noinline, cold))
#define NOVAPHY_ROLLED
inline constexpr int kDirectionsAtOnce = 6;
#else
#define NOVAPHY_SELDOM
// Keeps a loop rolled. Device compilers take minutes for the unrolled code of six directions.
#define NOVAPHY_ROLLED _Pragma("unroll 1")
inline constexpr int kDirectionsAtOnce = 1;
#endif

}  // namespace novaphy::articulation
