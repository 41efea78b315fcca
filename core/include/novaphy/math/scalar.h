// The scalar functions that formulas use. A formula is a template over its scalar T. T = float runs
// in the forward engine, and T = nova::Real is traced into a Program. Every function here also
// exists for nova::Real, with the same rounding and the same result at ties. Argument-dependent
// lookup finds it.
//
// Freestanding: the only library headers are <cstdint>, and <cmath> for correctly rounded
// operations.
#pragma once

#include <cmath>
#include <cstdint>

namespace novaphy::math {

// min is a <= b ? a : b, and max is a >= b ? a : b. With a NaN both return the second operand.
inline float min(float a, float b) { return a <= b ? a : b; }
inline float max(float a, float b) { return a >= b ? a : b; }
inline float abs(float a) { return __builtin_fabsf(a); }
inline float sign(float a) { return a < 0.0f ? -1.0f : 1.0f; }  // sign(0) = +1
inline float sqrt(float a) { return __builtin_sqrtf(a); }
inline float floor(float a) { return __builtin_floorf(a); }
inline float fma(float a, float b, float c) { return std::fma(a, b, c); }

// Returns c ? a : b. Formulas use select instead of `if`, so that they can be traced.
inline float select(bool c, float a, float b) { return c ? a : b; }
inline bool select(bool c, bool a, bool b) { return c ? a : b; }
inline bool both(bool a, bool b) { return a && b; }
inline bool either(bool a, bool b) { return a || b; }
inline bool negate(bool a) { return !a; }

// Casts and bit patterns. A traced integer wraps, but an int32_t must not overflow. Integer
// formulas must therefore stay in range; the count of a shift is 0 .. 31.
inline int32_t to_int(float a) {  // truncates and saturates; NaN gives 0
  if (a != a) return 0;
  if (a >= 2147483648.0f) return INT32_MAX;
  if (a <= -2147483648.0f) return INT32_MIN;
  return static_cast<int32_t>(a);
}
inline float to_real(int32_t a) { return static_cast<float>(a); }  // rounds to nearest even
inline int32_t float_bits(float a) { return __builtin_bit_cast(int32_t, a); }
inline float bits_float(int32_t a) { return __builtin_bit_cast(float, a); }

// Declarations about derivatives, which change no value. detach(a) returns a with the derivative 0.
// with_derivative(y, x, dy_dx) returns y with the derivative dy_dx with respect to x.
inline float detach(float a) { return a; }
inline float with_derivative(float y, float, float) { return y; }

// Returns c x for a coefficient c that is often 0, such as a damping. The result is 0 for c = 0,
// whatever x is, so traced code can skip the computation of x. The derivatives are those of the
// product, also with respect to c.
template <class T>
T optional_product(const T& c, const T& x) {
  return with_derivative(select(c == T(0.0f), T(0.0f), detach(c) * x), c, detach(x));
}

template <class T>
T clamp(const T& x, const T& lo, const T& hi) {
  return min(max(x, lo), hi);
}
template <class T>
T step(const T& x) {  // 1 if x < 0, else 0
  return select(x < T(0.0f), T(1.0f), T(0.0f));
}
template <class T>
T inverse_or_zero(const T& x) {  // 1/x, and 0 where x == 0
  return select(x == T(0.0f), T(0.0f), T(1.0f) / x);
}
template <class T>
T nonzero(const T& x) {  // 0 if x == 0, else 1
  return select(x == T(0.0f), T(0.0f), T(1.0f));
}

}  // namespace novaphy::math
