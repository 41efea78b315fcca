// The scalar functions of articulations, for float and double; dual.h has those for derivatives.
#pragma once

#include "novaphy/math/functions.h"

namespace novaphy::articulation {

template <class T>
struct SinCos {
  T sin{}, cos{};
};
inline SinCos<float> sin_cos(float x) {
  const auto v = math::functions_detail::sin_cos(x);
  return {v.sin, v.cos};
}
inline SinCos<double> sin_cos(double x) { return {std::sin(x), std::cos(x)}; }
inline float square_root(float x) { return math::sqrt(x); }
inline double square_root(double x) { return std::sqrt(x); }
inline bool is_finite(float x) { return x - x == 0.0f; }
inline bool is_finite(double x) { return x - x == 0.0; }

}  // namespace novaphy::articulation
