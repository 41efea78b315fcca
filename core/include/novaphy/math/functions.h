// Elementary functions as branch-free templates over the scalar T. T = float runs in the forward
// engine, T = nova::Real is traced. The formulas avoid libm and use only + - * / sqrt floor fma,
// comparisons, selects, casts and bit patterns, which every device rounds to the same bits.
//
//   function    worst error  where        special values (NaN in gives NaN out)
//   sin, cos    1.6 ulp      |x| <= 1e5   sin(-0) = -0, +-inf gives NaN
//   tan         3.5 ulp      |x| <= 1e5   as sin
//   exp         1.1 ulp      everywhere   inf above 88.722839, 0 below -103.97208
//   log         1.0 ulp      everywhere   log(+-0) = -inf, NaN for x < 0
//   pow         1.6 ulp      everywhere   as C99: pow(x, +-0) = pow(1, y) = 1 even for NaN; x < 0
//                                         gives NaN unless y is whole, then the sign of an odd y
//   tanh        1.8 ulp      everywhere   tanh(-0) = -0
//   asin, acos  1.9, 1.2     everywhere   x is clamped to [-1, 1] (Newton's convention)
//   atan2       1.6 ulp      everywhere   as C99: all quadrants, signed zeros, infinities
//   rsqrt       1.5 ulp      everywhere   1/sqrt(x): rsqrt(+-0) = +-inf, NaN for x < 0
//
// "Everywhere" includes denormal arguments and results. The reference is double precision, over all
// arguments for functions of one argument, and over 4e8 random pairs for functions of two. The
// error of sin and cos is 2.4 ulp up to |x| = 1e6. Beyond, the argument reduction runs out of bits.
// The result stays in [-1, 1] and the same on every device, but is meaningless above about 1e7.
//
// Derivatives are analytic. Conventions where the derivative does not exist:
//   log         1/x everywhere, so +-inf at +-0
//   pow         d/dx = y pow(x, y - 1), and 0 for y = 0: at x = 0 that is 0 for y > 1, 1 for y = 1,
//               and infinite for other y. d/dy = pow(x, y) log(x); 0 where x or the value is 0; NaN
//               for x < 0, where pow is NaN between whole y
//   asin, acos  0 at +-1 and beyond
//   atan2       0 for both arguments at the origin
//   rsqrt       0 for x <= 0, as sqrt
//
// Call the functions from namespace novaphy or nova, or as math::sin(x). At global scope an
// unqualified sin(x) of a float is the function of libm.
//
// The coefficients are minimax fits of the relative error. Lawson's iteration (reweighted least
// squares until the error is level) runs on 1500 Chebyshev nodes against 50-digit values. Rounding
// to binary32 goes from the lowest degree up, with a new fit of the other coefficients each time. A
// last search tries neighboring floats. The comment at each use has the interval and the error.
#pragma once

#include "novaphy/math/scalar.h"

namespace novaphy::math {

// Matches float and nova::Real. Excludes double and int, which would be converted silently.
template <class T>
concept FormulaScalar = requires(const T& x) {
  requires __is_same(decltype(detach(x)), T);
  requires __is_same(decltype(bits_float(float_bits(x))), T);
};

namespace functions_detail {

inline constexpr int32_t kSignBit = INT32_MIN;
inline constexpr int32_t kBitsOfSqrtHalf = 0x3F3504F3;
inline constexpr float kInfinity = __builtin_inff();
inline constexpr float kNaN = __builtin_nanf("");
inline constexpr float kSmallest = 0x1p-149f;
inline constexpr float kSmallestNormal = 0x1p-126f;
inline constexpr float kThird = 0x1.555556p-2f;
inline constexpr float kLog2e = 0x1.715476p+0f;
// ln 2 in two parts. The first part has 15 bits, so that its product with an exponent is exact.
inline constexpr float kLn2Hi = 0x1.62e4p-1f, kLn2Lo = 0x1.7f7d1cp-20f;
inline constexpr float kTwoOverPi = 0x1.45f306p-1f;
// pi/2 as the sum of three parts, to 2^-73. The first two are truncated instead of rounded. All
// parts are therefore positive, which keeps the sign of a zero.
inline constexpr float kHalfPi1 = 0x1.921fb4p+0f;
inline constexpr float kHalfPi2 = 0x1.4442dp-24f;
inline constexpr float kHalfPi3 = 0x1.84698ap-48f;
// pi/2 as the nearest float plus the rounding error.
inline constexpr float kHalfPiHi = 0x1.921fb6p+0f, kHalfPiLo = -0x1.777a5cp-25f;

// Returns c + rest[0] u + rest[1] u^2 + ..., by Horner's rule.
template <class T, class... Rest>
T polynomial(const T& u, float c, Rest... rest) {
  if constexpr (sizeof...(rest) == 0) {
    return T(c);
  } else {
    return fma(u, polynomial(u, rest...), T(c));
  }
}

// Returns x limited to [lo, hi]. NaN stays NaN, because min and max return the second operand then.
template <class T>
T clamp_to(const T& x, float lo, float hi) {
  return max(T(lo), min(T(hi), x));
}

template <class T>
auto has_sign(const T& x) {  // true for -0 too
  return float_bits(x) < 0;
}
// Returns `magnitude`, which must be >= 0, with the sign of s.
template <class T>
T with_sign_of(const T& s, const T& magnitude) {
  return bits_float(float_bits(magnitude) | (float_bits(s) & kSignBit));
}

template <class T>
struct SinCos {
  T sin{}, cos{};
};
// Returns sine and cosine together, because each is the derivative of the other up to sign. The
// reduction x = k pi/2 + r (Cody and Waite) comes first, then polynomials in r. For |x| <= 1e5 the
// error of x 2/pi is at most 2^-8, so |r| exceeds pi/4 = 0.7854 only slightly.
template <class T>
SinCos<T> sin_cos(const T& x) {
  const T k = floor(fma(x, T(kTwoOverPi), T(0.5f)));
  // The first subtraction is exact, because x and k kHalfPi1 agree in their leading bits. The other
  // two round relative to r.
  const T exact = fma(k, T(-kHalfPi1), x);
  const T reduced = fma(k, T(-kHalfPi3), fma(k, T(-kHalfPi2), exact));
  const T r = clamp_to(reduced, -1.0f, 1.0f);  // bounds the result if k is wrong
  const T u = r * r;
  // The polynomials give sin(r) to 2^-27.7 and cos(r) to 2^-32.6 for |r| <= 0.80.
  const T s = fma(r * u, polynomial(u, -0.166666538f, 0.00833209511f, -0.0001950554f), r);
  const T c = polynomial(u, 1.0f, -0.5f, 0.0416666418f, -0.00138871302f, 2.44120856e-05f);
  const auto quadrant = to_int(k);
  const auto odd = (quadrant & 1) == 1;
  const auto sin_sign = (quadrant << 30) & kSignBit;  // negative in quadrants 2 and 3
  // negative in quadrants 1 and 2
  const auto cos_sign = ((quadrant ^ (quadrant << 1)) << 30) & kSignBit;
  const T sine = bits_float(float_bits(select(odd, c, s)) ^ sin_sign);
  const T cosine = bits_float(float_bits(select(odd, s, c)) ^ cos_sign);
  return {select(x == T(0.0f), x, sine), cosine};  // the polynomial would lose the sign of -0
}

// Returns the exponent n of x = n ln 2 + r with |r| <= 0.3471. exp(x) = 2^n (1 + exp_minus_1(r)).
template <class T>
T nearest_exponent(const T& x) {
  return floor(fma(x, T(kLog2e), T(0.5f)));
}
template <class T>
T without_exponent(const T& x, const T& n) {
  return fma(n, T(-kLn2Lo), fma(n, T(-kLn2Hi), x));
}
template <class T>
T exp_minus_1(const T& r) {  // error: 2^-28.2 of exp(r)
  const T p =
      polynomial(r, 0.49999994f, 0.166665211f, 0.0416682847f, 0.00836869422f, 0.0013819189f);
  return fma(r * r, p, r);
}
// Returns x 2^n for whole |n| <= 252. Only the second product can round, overflow or underflow.
template <class T>
T scale(const T& x, const T& n) {
  const auto k = to_int(n);
  const auto half = k >> 1;
  return (x * bits_float((half + 127) << 23)) * bits_float(((k - half) + 127) << 23);
}

template <class T>
T exp_value(const T& x) {
  const T clamped = clamp_to(x, -104.0f, 89.0f);  // beyond these bounds, exp is 0 or inf in float
  const T n = nearest_exponent(clamped);
  return scale(T(1.0f) + exp_minus_1(without_exponent(clamped, n)), n);
}

template <class T>
struct Scientific {
  T mantissa{}, exponent{};
};
// Splits a finite a > 0 into mantissa * 2^exponent, with the mantissa in [sqrt(1/2), sqrt(2)).
// Other inputs give meaningless numbers.
template <class T>
Scientific<T> split(const T& a) {
  const auto denormal = a < T(kSmallestNormal);
  const auto bits = float_bits(select(denormal, a * T(0x1p23f), a));
  const auto exponent = (bits - kBitsOfSqrtHalf) >> 23;
  return {bits_float(bits - (exponent << 23)),
          to_real(exponent) - select(denormal, T(23.0f), T(0.0f))};
}

template <class T>
T log_value(const T& x) {
  const Scientific<T> part = split(abs(x));
  const T f = part.mantissa - T(1.0f);
  // (log(1 + f) - f) / f^2 for sqrt(1/2) <= 1 + f < sqrt(2). The error is 2^-27.8 of log(1 + f).
  const T p = polynomial(f, -0.499999881f, 0.333333254f, -0.250016093f, 0.200020134f, -0.166084543f,
                         0.141806036f, -0.132470503f, 0.129145741f, -0.0762491301f);
  const T small = f + fma(part.exponent, T(kLn2Lo), (f * f) * p);
  const T y = fma(part.exponent, T(kLn2Hi), small);
  return select(x > T(0.0f), select(x < T(kInfinity), y, x),
                select(x == T(0.0f), T(-kInfinity), T(kNaN)));
}

template <class T>
struct Pair {  // the unevaluated sum hi + lo, hi = fl(hi + lo)
  T hi{}, lo{};
};
// Returns log(a) for finite a > 0 as a pair. The relative error is 2^-31; pow multiplies it by up
// to 88. With the mantissa m: exponent ln 2 + 2 atanh(s), s = (m - 1) / (m + 1), |s| <= 0.1716.
template <class T>
Pair<T> log_pair(const T& a) {
  const Scientific<T> part = split(a);
  const T m = part.mantissa, one = T(1.0f), third = T(kThird);
  const T f = m - one, d = m + one;  // f is exact; d + d_lo equals m + 1
  const T d_lo = m - (d - one);
  const T inverse = one / d;
  const T s = f * inverse;
  const T s_lo = fma(-s, d_lo, fma(-s, d, f)) * inverse;
  const T u = s * s, cube = s * u;
  const T cube_lo = fma(s, fma(s, s, -u), fma(s, u, -cube));
  // Polynomial for (atanh(s) / s - 1) / s^2 without its first coefficient 1/3. The error is 2^-35.5
  // of atanh(s). The term s_lo has the factor 1 + s^2, the derivative of atanh to first order.
  const T p = polynomial(u, 0.199998766f, 0.142850175f, 0.115100279f);
  const T tail = fma(cube, third, fma(cube * u, p, fma(cube_lo, third, fma(s_lo, u, s_lo))));
  const T exponent_hi = part.exponent * T(kLn2Hi), s2 = s + s;
  const T sum = exponent_hi + s2;
  const T sum_lo = s2 - (sum - exponent_hi);
  const T lo = fma(part.exponent, T(kLn2Lo), tail + tail) + sum_lo;
  const T hi = sum + lo;
  return {hi, lo - (hi - sum)};
}

template <class T>
struct Pow {
  T value{}, log{};  // log of |x|
};
template <class T>
Pow<T> pow_value(const T& x, const T& y) {
  const T zero = T(0.0f), one = T(1.0f), infinity = T(kInfinity);
  const T a = abs(x);
  const Pair<T> log_a = log_pair(a);
  const T l = select(a < infinity, select(a == zero, -infinity, log_a.hi), a);
  // The product y log(a) as a pair. The clamp of y avoids overflow and does not change the result:
  // for larger |y| the result is 0, 1 or inf, because |log(a)| > 2^-25 for a != 1.
  const T yc = clamp_to(y, -0x1p40f, 0x1p40f);
  const T hi = yc * l;
  const T lo = select(abs(hi) < T(128.0f), fma(yc, log_a.lo, fma(yc, l, -hi)), zero);
  const T e = clamp_to(hi, -128.0f, 128.0f);  // beyond these bounds, the result is 0 or inf
  const T n = nearest_exponent(e);
  const T magnitude = scale(one + exp_minus_1(without_exponent(e, n) + lo), n);

  const T half = y * T(0.5f);
  const auto whole = floor(y) == y;
  const auto odd = both(whole, floor(half) != half);
  const T value = select(both(has_sign(x), odd), -magnitude, magnitude);
  const auto negative = both(-infinity < x, x < zero);
  return {select(either(x == one, y == zero), one,
                 select(both(negative, negate(whole)), T(kNaN), value)),
          l};
}

template <class T>
struct Tanh {
  T value{}, derivative{};
};
// tanh = m / (m + 2) with m = exp(2|x|) - 1. The quotient is corrected by its remainder.
template <class T>
Tanh<T> tanh_value(const T& x) {
  const T a = abs(x), two = T(2.0f);
  const T z = min(T(87.0f), a + a);
  const T n = nearest_exponent(z);
  const T p = exp_minus_1(without_exponent(z, n));
  const T power = bits_float((to_int(n) + 127) << 23);
  const T m = fma(p, power, power - T(1.0f));
  const T d = m + two;
  const T d_lo = m - (d - two);
  const T inverse = T(1.0f) / d;
  const T q = m * inverse;
  const T value = fma(fma(-q, d_lo, fma(-q, d, m)), inverse, q);
  // 1 - tanh^2 without cancellation: 4 exp(2|x|) / (exp(2|x|) + 1)^2, never below 6e-38.
  const T derivative = (fma(p, power, power) * (inverse + inverse)) * (inverse + inverse);
  return {with_sign_of(x, value), derivative};
}

template <class T>
struct Asin {
  T small{};  // asin(|x|); for |x| > 1/2, asin(sqrt((1 - |x|) / 2)) = acos(|x|) / 2
  decltype(T{} < T{}) large{};
  T derivative{};  // derivative of asin
};
template <class T>
Asin<T> asin_parts(const T& x) {
  const T one = T(1.0f);
  const T a = min(one, abs(x));
  const auto large = a > T(0.5f);
  const T u = select(large, fma(a, T(-0.5f), T(0.5f)), a * a);
  const T s = select(large, sqrt(u), a);
  // Polynomial for (asin(s) / s - 1) / s^2 for s <= 1/2. The error is 2^-27.6 of asin(s).
  const T p =
      polynomial(u, 0.166667521f, 0.0749530941f, 0.0454691499f, 0.0241847783f, 0.0421583056f);
  const T derivative = select(a == one, T(0.0f), one / sqrt((one - a) * (one + a)));
  return {fma(s * u, p, s), large, derivative};
}

template <class T>
struct Atan2 {
  T value{}, dy{}, dx{};
};
// Returns the angle of (x, y) from atan(q), where q <= 1 is the ratio of the smaller to the larger.
template <class T>
Atan2<T> atan2_value(const T& y, const T& x) {
  const T zero = T(0.0f), one = T(1.0f);
  const T ax = abs(x), ay = abs(y);
  const auto steep = ay > ax;
  const T smaller = select(steep, ax, ay), larger = select(steep, ay, ax);
  const T d = max(T(kSmallest), larger);  // makes 0/0 = 0; inf/inf is set to 1
  const auto both_infinite = both(smaller == T(kInfinity), larger == T(kInfinity));
  const T q = select(both_infinite, one, smaller / d);
  const T u = q * q;
  // Polynomial for (atan(q) / q - 1) / q^2 for q <= 1. The error is 2^-28.5 of atan(q).
  const T p =
      polynomial(u, -0.333332986f, 0.199985296f, -0.142640159f, 0.109508805f, -0.0839930624f,
                 0.0578813925f, -0.0310970023f, 0.0108687095f, -0.00178283197f);
  const T a = fma(q * u, p, q);
  const auto left = has_sign(x);
  const T quarters = select(steep, one, select(left, T(2.0f), zero));
  const T b = select(steep, -a, a);
  const T angle = fma(quarters, T(kHalfPiHi), fma(quarters, T(kHalfPiLo), select(left, -b, b)));

  const T norm = d * (one + u);  // (x^2 + y^2) / larger, which cannot overflow
  const T dy = with_sign_of(x, select(steep, q, one)) / norm;
  const T dx = -with_sign_of(y, select(steep, one, q)) / norm;
  const auto origin = larger == zero;
  return {with_sign_of(y, angle), select(origin, zero, dy), select(origin, zero, dx)};
}

}  // namespace functions_detail

template <FormulaScalar T>
T sin(const T& x) {
  const auto v = functions_detail::sin_cos(x);
  return with_derivative(detach(v.sin), x, v.cos);
}

template <FormulaScalar T>
T cos(const T& x) {
  const auto v = functions_detail::sin_cos(x);
  return with_derivative(detach(v.cos), x, -v.sin);
}

template <FormulaScalar T>
T tan(const T& x) {
  const auto v = functions_detail::sin_cos(x);
  const T t = v.sin / v.cos;
  return with_derivative(detach(t), x, fma(t, t, T(1.0f)));
}

template <FormulaScalar T>
T exp(const T& x) {
  const T v = functions_detail::exp_value(x);
  return with_derivative(detach(v), x, v);
}

template <FormulaScalar T>
T log(const T& x) {
  return with_derivative(detach(functions_detail::log_value(x)), x, T(1.0f) / x);
}

template <FormulaScalar T>
T pow(const T& x, const T& y) {
  const T zero = T(0.0f);
  const auto v = functions_detail::pow_value(x, y);
  // The derivatives need a second pow. For float, which has no derivative, the early return skips
  // it, because some compilers would not.
  if constexpr (__is_same(T, float)) return v.value;
  const T dx = select(y == zero, zero, y * functions_detail::pow_value(x, y - T(1.0f)).value);
  const T dy = select(either(x == zero, v.value == zero), zero,
                      select(x > zero, v.value * v.log, T(functions_detail::kNaN)));
  return with_derivative(with_derivative(detach(v.value), x, dx), y, dy);
}

template <FormulaScalar T>
T tanh(const T& x) {
  const auto v = functions_detail::tanh_value(x);
  return with_derivative(detach(v.value), x, v.derivative);
}

// Returns asin(clamp(x, -1, 1)), in [-pi/2, pi/2].
template <FormulaScalar T>
T asin(const T& x) {
  using namespace functions_detail;
  const auto v = asin_parts(x);
  const T rest = fma(T(-2.0f), v.small, T(kHalfPiHi)) + T(kHalfPiLo);
  return with_derivative(detach(with_sign_of(x, select(v.large, rest, v.small))), x, v.derivative);
}

// Returns acos(clamp(x, -1, 1)), in [0, pi].
template <FormulaScalar T>
T acos(const T& x) {
  using namespace functions_detail;
  const auto v = asin_parts(x);
  const auto negative = x < T(0.0f);
  const T quarters = select(v.large, select(negative, T(2.0f), T(0.0f)), T(1.0f));
  const T a = select(v.large, v.small + v.small, -v.small);
  const T angle = fma(quarters, T(kHalfPiHi), fma(quarters, T(kHalfPiLo), select(negative, -a, a)));
  return with_derivative(detach(angle), x, -v.derivative);
}

// Returns the angle of (x, y) from the x axis, in [-pi, pi].
template <FormulaScalar T>
T atan2(const T& y, const T& x) {
  const auto v = functions_detail::atan2_value(y, x);
  return with_derivative(with_derivative(detach(v.value), y, v.dy), x, v.dx);
}

template <FormulaScalar T>
T rsqrt(const T& x) {
  const T v = T(1.0f) / sqrt(x);
  const T dx = select(x > T(0.0f), (v * T(-0.5f)) / x, T(0.0f));
  return with_derivative(detach(v), x, dx);
}

}  // namespace novaphy::math
