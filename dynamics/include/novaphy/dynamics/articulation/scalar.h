// The scalar functions of articulations, for float and double; dual.h has those for derivatives,
// src/featherstone/lanes.h those of many floats at once.
//
// Nothing here branches on a number, but on all or any of its lanes: comparisons are masks, and
// select takes what holds. A float is one lane, its masks are bool.
#pragma once

#include "novaphy/math/functions.h"

namespace novaphy::articulation {

// Bits, of every lane: what branches a step took.
template <class T>
struct BranchesOf {
  using Type = int32_t;
};
template <class T>
using Branches = typename BranchesOf<T>::Type;
inline bool has(int32_t branches, int32_t any_bit) { return (branches & any_bit) != 0; }
inline int32_t with(int32_t branches, bool c, int32_t bit) { return c ? branches | bit : branches; }
inline bool differ(int32_t a, int32_t b) { return a != b; }
// From and to a number, which holds them exactly.
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
inline bool(any)(bool c) { return c; }  // in device code a macro of the same meaning

template <class T>
struct SinCos {
  T sin{}, cos{};
};
inline SinCos<float> sin_cos(float x) {
  const auto v = math::functions_detail::sin_cos(x);
  return {v.sin, v.cos};
}
inline float square_root(float x) { return math::sqrt(x); }
// Of (cosine, sine) from the x axis.
inline float angle_of(float sine, float cosine) { return math::atan2(sine, cosine); }
inline bool is_finite(float x) { return x - x == 0.0f; }

#ifndef NOVAPHY_KERNEL  // devices have doubles, but not these functions of them
inline int32_t to_branches(double x) { return static_cast<int32_t>(x); }
inline SinCos<double> sin_cos(double x) { return {std::sin(x), std::cos(x)}; }
inline double square_root(double x) { return std::sqrt(x); }
inline double angle_of(double sine, double cosine) { return std::atan2(sine, cosine); }
inline bool is_finite(double x) { return x - x == 0.0; }
// Functions apart, and small: few trees have such joints and contacts.
#define NOVAPHY_SELDOM __attribute__((noinline, cold))
#else
#define NOVAPHY_SELDOM
#endif

}  // namespace novaphy::articulation
