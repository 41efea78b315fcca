#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kPi = 3.14159265358979f;
constexpr float kLargest = std::numeric_limits<float>::max();
constexpr float kTiny = std::numeric_limits<float>::denorm_min();

// |got - exact| in units of the spacing of floats at `exact`. Infinity counts as 2^128; NaN must
// meet NaN.
double ulp_error(float got, double exact) {
  if (std::isnan(exact) || std::isnan(got))
    return std::isnan(exact) == std::isnan(got) ? 0.0 : HUGE_VAL;
  if (std::isinf(exact)) return static_cast<double>(got) == exact ? 0.0 : HUGE_VAL;
  double value = got;
  if (std::isinf(got)) {
    if (std::signbit(got) != std::signbit(exact)) return HUGE_VAL;
    if (std::fabs(exact) >= 0x1p128) return 0.0;
    value = std::copysign(0x1p128, value);
  }
  const int exponent = std::fabs(exact) < 0x1p-126 ? -126 : std::min(std::ilogb(exact), 127);
  return std::fabs(value - exact) / std::ldexp(1.0, exponent - 23);
}

struct Worst {
  double ulp = 0.0;
  float x = 0.0f, y = 0.0f;
  void take(double error, float at_x, float at_y = 0.0f) {
    if (error > ulp) *this = {error, at_x, at_y};
  }
};
#define EXPECT_ACCURATE(worst, bound) \
  EXPECT_LE((worst).ulp, bound) << std::hexfloat << "at " << (worst).x << ", " << (worst).y

// Visits all bit patterns with |x| <= limit at a prime stride, NaNs and infinities included.
template <class F, class Exact>
Worst sweep(F f, Exact exact, float limit) {
  Worst worst;
  for (uint64_t bits = 0; bits < (uint64_t{1} << 32); bits += 3001) {
    const float x = math::bits_float(static_cast<int32_t>(static_cast<uint32_t>(bits)));
    if (std::fabs(x) > limit) continue;
    worst.take(ulp_error(f(x), exact(static_cast<double>(x))), x);
  }
  return worst;
}
#define SWEEP(function, exact, limit) \
  sweep([](float x) { return math::function(x); }, [](double x) { return exact; }, limit)

double clamp_unit(double x) { return x > 1.0 ? 1.0 : x < -1.0 ? -1.0 : x; }

TEST(MathFunctions, SinAndCosAreWithin1_6Ulp) {
  EXPECT_ACCURATE(SWEEP(sin, std::sin(x), 1e5f), 1.6);
  EXPECT_ACCURATE(SWEEP(cos, std::cos(x), 1e5f), 1.6);
  EXPECT_ACCURATE(SWEEP(sin, std::sin(x), 1e6f), 2.4);
  EXPECT_ACCURATE(SWEEP(cos, std::cos(x), 1e6f), 2.4);
}

TEST(MathFunctions, SinAndCosNearMultiplesOfHalfPiAreWithin1_6Ulp) {
  Worst worst;
  for (int k = 0; k < 63000; k += 5) {
    const int32_t nearest = math::float_bits(static_cast<float>(k * 1.5707963267948966));
    for (int32_t bits = std::max(0, nearest - 3); bits <= nearest + 3; ++bits) {
      const float x = math::bits_float(bits);
      worst.take(ulp_error(math::sin(x), std::sin(static_cast<double>(x))), x);
      worst.take(ulp_error(math::cos(-x), std::cos(static_cast<double>(x))), -x);
    }
  }
  EXPECT_ACCURATE(worst, 1.6);
}

TEST(MathFunctions, SinAndCosOfAnyFiniteNumberAreInTheUnitInterval) {
  for (float x = 1.0f; x < 1e38f; x *= 1.0009f) {
    EXPECT_LE(std::fabs(math::sin(x)), 1.0f) << x;
    EXPECT_LE(std::fabs(math::cos(-x)), 1.0f) << x;
  }
  EXPECT_LE(std::fabs(math::sin(kLargest)), 1.0f);
}

TEST(MathFunctions, TanIsWithin3_5Ulp) { EXPECT_ACCURATE(SWEEP(tan, std::tan(x), 1e5f), 3.5); }
TEST(MathFunctions, ExpIsWithin1_1Ulp) { EXPECT_ACCURATE(SWEEP(exp, std::exp(x), kInf), 1.1); }
TEST(MathFunctions, LogIsWithin1Ulp) { EXPECT_ACCURATE(SWEEP(log, std::log(x), kInf), 1.0); }
TEST(MathFunctions, TanhIsWithin1_8Ulp) { EXPECT_ACCURATE(SWEEP(tanh, std::tanh(x), kInf), 1.8); }
TEST(MathFunctions, AsinOfTheClampedArgumentIsWithin1_9Ulp) {
  EXPECT_ACCURATE(SWEEP(asin, std::asin(clamp_unit(x)), kInf), 1.9);
}
TEST(MathFunctions, AcosOfTheClampedArgumentIsWithin1_2Ulp) {
  EXPECT_ACCURATE(SWEEP(acos, std::acos(clamp_unit(x)), kInf), 1.2);
}
TEST(MathFunctions, RsqrtIsWithin1_5Ulp) {
  EXPECT_ACCURATE(SWEEP(rsqrt, 1.0 / std::sqrt(x), kInf), 1.5);
}

TEST(MathFunctions, Atan2IsWithin1_6Ulp) {
  std::mt19937 random(1);
  Worst worst;
  for (int i = 0; i < 1000000; ++i) {
    const float x = math::bits_float(static_cast<int32_t>(random()));
    float y = math::bits_float(static_cast<int32_t>(random()));
    if (i % 2 == 0) y = x * (0.01f + static_cast<float>(random() % 1000000) * 3e-6f);
    worst.take(
        ulp_error(math::atan2(y, x), std::atan2(static_cast<double>(y), static_cast<double>(x))), x,
        y);
  }
  EXPECT_ACCURATE(worst, 1.6);
}

TEST(MathFunctions, PowIsWithin1_6Ulp) {
  std::mt19937 random(1);
  Worst worst;
  for (int i = 0; i < 1000000; ++i) {
    float x = math::bits_float(static_cast<int32_t>(random()));
    float y = math::bits_float(static_cast<int32_t>(random()));
    if (i % 4 == 0) y = static_cast<float>(static_cast<int>(random() % 17) - 8);
    if (i % 4 >= 2) {  // results over the whole range, from bases of the whole range or near 1
      x = i % 4 == 2 ? std::fabs(x) : 0.5f + static_cast<float>(random() % 1000000) * 1.5e-6f;
      const double log_result =
          static_cast<double>(static_cast<int32_t>(random())) * (104.0 / 0x1p31);
      y = static_cast<float>(log_result / std::log(static_cast<double>(x)));
    }
    worst.take(ulp_error(math::pow(x, y), std::pow(static_cast<double>(x), static_cast<double>(y))),
               x, y);
  }
  EXPECT_ACCURATE(worst, 1.6);
}

void expect_same(float got, float expected, const char* what) {
  if (std::isnan(expected)) {
    EXPECT_TRUE(std::isnan(got)) << what << ": got " << got;
  } else {
    EXPECT_EQ(math::float_bits(got), math::float_bits(expected))
        << what << ": got " << got << ", expected " << expected;
  }
}
#define EXPECT_SAME(expression, expected) expect_same(expression, expected, #expression)

TEST(MathFunctions, SpecialValuesOfOneArgument) {
  EXPECT_SAME(math::sin(0.0f), 0.0f);
  EXPECT_SAME(math::sin(-0.0f), -0.0f);
  EXPECT_SAME(math::sin(kTiny), kTiny);
  EXPECT_SAME(math::sin(kInf), kNan);
  EXPECT_SAME(math::sin(kNan), kNan);
  EXPECT_SAME(math::cos(-0.0f), 1.0f);
  EXPECT_SAME(math::cos(-kInf), kNan);
  EXPECT_SAME(math::cos(kNan), kNan);
  EXPECT_SAME(math::tan(-0.0f), -0.0f);
  EXPECT_SAME(math::exp(-0.0f), 1.0f);
  EXPECT_SAME(math::exp(kInf), kInf);
  EXPECT_SAME(math::exp(-kInf), 0.0f);
  EXPECT_SAME(math::exp(88.72284f), std::exp(88.72284f));  // the last finite one
  EXPECT_SAME(math::exp(88.7229f), kInf);
  EXPECT_SAME(math::exp(-103.97f), kTiny);
  EXPECT_SAME(math::exp(-103.98f), 0.0f);
  EXPECT_SAME(math::exp(kNan), kNan);
  EXPECT_SAME(math::log(1.0f), 0.0f);
  EXPECT_SAME(math::log(0.0f), -kInf);
  EXPECT_SAME(math::log(-0.0f), -kInf);
  EXPECT_SAME(math::log(-kTiny), kNan);
  EXPECT_SAME(math::log(-kInf), kNan);
  EXPECT_SAME(math::log(kInf), kInf);
  EXPECT_SAME(math::log(kNan), kNan);
  EXPECT_SAME(math::tanh(-0.0f), -0.0f);
  EXPECT_SAME(math::tanh(-kTiny), -kTiny);
  EXPECT_SAME(math::tanh(9.02f), 1.0f);
  EXPECT_SAME(math::tanh(-kInf), -1.0f);
  EXPECT_SAME(math::tanh(kNan), kNan);
  EXPECT_SAME(math::asin(-0.0f), -0.0f);
  EXPECT_SAME(math::asin(1.0f), kPi / 2.0f);
  EXPECT_SAME(math::asin(-1.5f), -kPi / 2.0f);
  EXPECT_SAME(math::asin(kInf), kPi / 2.0f);
  EXPECT_SAME(math::asin(kNan), kNan);
  EXPECT_SAME(math::acos(1.0f), 0.0f);
  EXPECT_SAME(math::acos(1.0000001f), 0.0f);
  EXPECT_SAME(math::acos(-0.0f), kPi / 2.0f);
  EXPECT_SAME(math::acos(-1.0f), kPi);
  EXPECT_SAME(math::acos(-kInf), kPi);
  EXPECT_SAME(math::acos(kNan), kNan);
  EXPECT_SAME(math::rsqrt(4.0f), 0.5f);
  EXPECT_SAME(math::rsqrt(0.0f), kInf);
  EXPECT_SAME(math::rsqrt(kInf), 0.0f);
  EXPECT_SAME(math::rsqrt(-1.0f), kNan);
}

// The standard library's double functions are exact on such arguments and follow C99's annex F.
TEST(MathFunctions, PowAndAtan2OfSpecialArgumentsFollowC99) {
  const float magnitudes[] = {0.0f,        kTiny,       1e-38f,        0.25f,    0.5f,  1.0f,
                              1.5f,        2.0f,        3.0f,          4.0f,     1e10f, 1e30f,
                              16777215.0f, 16777216.0f, 4294967296.0f, kLargest, kInf,  kNan};
  for (const float x_magnitude : magnitudes) {
    for (const float y_magnitude : magnitudes) {
      for (int signs = 0; signs < 4; ++signs) {
        const float x = signs & 1 ? -x_magnitude : x_magnitude,
                    y = signs & 2 ? -y_magnitude : y_magnitude;
        const double power = std::pow(static_cast<double>(x), static_cast<double>(y));
        const double angle = std::atan2(static_cast<double>(y), static_cast<double>(x));
        EXPECT_LE(ulp_error(math::pow(x, y), power), 1.6)
            << x << " ^ " << y << " = " << math::pow(x, y);
        EXPECT_LE(ulp_error(math::atan2(y, x), angle), 1.6)
            << y << " / " << x << ": " << math::atan2(y, x);
        if (!std::isnan(power)) {
          EXPECT_EQ(std::signbit(math::pow(x, y)), std::signbit(power)) << x << " ^ " << y;
        }
        if (!std::isnan(angle)) {
          EXPECT_EQ(std::signbit(math::atan2(y, x)), std::signbit(angle)) << y << " / " << x;
        }
      }
    }
  }
}

TEST(MathFunctions, FloatTwinsOfTheCastsDoWhatTheProgramOpsDo) {
  EXPECT_EQ(math::to_int(2.9f), 2);
  EXPECT_EQ(math::to_int(-2.9f), -2);
  EXPECT_EQ(math::to_int(2147483648.0f), INT32_MAX);
  EXPECT_EQ(math::to_int(kInf), INT32_MAX);
  EXPECT_EQ(math::to_int(-2147483648.0f), INT32_MIN);
  EXPECT_EQ(math::to_int(-kInf), INT32_MIN);
  EXPECT_EQ(math::to_int(kNan), 0);
  EXPECT_SAME(math::to_real(16777217), 16777216.0f);
  EXPECT_EQ(math::float_bits(-0.0f), INT32_MIN);
  EXPECT_SAME(math::bits_float(1), kTiny);
  EXPECT_SAME(math::detach(3.0f), 3.0f);
  EXPECT_SAME(math::with_derivative(3.0f, 1.0f, kNan), 3.0f);
}

static_assert(math::FormulaScalar<float>);
static_assert(!math::FormulaScalar<double>);
static_assert(!math::FormulaScalar<int>);

}  // namespace

// A scalar that has the operations of a traced one and no others: its truth values do not convert
// to bool. Its derivative moves through with_derivative only.
namespace probe {

struct Flag {
  bool on = false;
};
struct Word {
  int32_t bits = 0;
  Word() = default;
  Word(int32_t value) : bits(value) {}
};
struct Number {
  float value = 0.0f;
  double derivative = 0.0;
  Number() = default;
  Number(float v) : value(v) {}
  Number(float v, double d) : value(v), derivative(d) {}
};

#define PROBE_ARITHMETIC(op) \
  Number operator op(const Number& a, const Number& b) { return a.value op b.value; }
#define PROBE_COMPARE(Operand, member, op) \
  Flag operator op(const Operand& a, const Operand& b) { return {a.member op b.member}; }
#define PROBE_WORD(op) \
  Word operator op(const Word& a, const Word& b) { return a.bits op b.bits; }
PROBE_ARITHMETIC(+)
PROBE_ARITHMETIC(-)
PROBE_ARITHMETIC(*)
PROBE_ARITHMETIC(/)
PROBE_COMPARE(Number, value, <)
PROBE_COMPARE(Number, value, >)
PROBE_COMPARE(Number, value, ==)
PROBE_COMPARE(Number, value, !=)
PROBE_COMPARE(Word, bits, <)
PROBE_COMPARE(Word, bits, ==)
PROBE_WORD(+)
PROBE_WORD(-)
PROBE_WORD(&)
PROBE_WORD(|)
PROBE_WORD(^)
PROBE_WORD(<<)
PROBE_WORD(>>)
Number operator-(const Number& a) { return -a.value; }
Number fma(const Number& a, const Number& b, const Number& c) {
  return math::fma(a.value, b.value, c.value);
}
Number min(const Number& a, const Number& b) { return math::min(a.value, b.value); }
Number max(const Number& a, const Number& b) { return math::max(a.value, b.value); }
Number abs(const Number& a) { return math::abs(a.value); }
Number sqrt(const Number& a) { return math::sqrt(a.value); }
Number floor(const Number& a) { return math::floor(a.value); }
Number select(const Flag& c, const Number& a, const Number& b) { return c.on ? a.value : b.value; }
Flag both(const Flag& a, const Flag& b) { return {a.on && b.on}; }
Flag either(const Flag& a, const Flag& b) { return {a.on || b.on}; }
Flag negate(const Flag& a) { return {!a.on}; }
Word to_int(const Number& a) { return math::to_int(a.value); }
Number to_real(const Word& a) { return math::to_real(a.bits); }
Word float_bits(const Number& a) { return math::float_bits(a.value); }
Number bits_float(const Word& a) { return math::bits_float(a.bits); }
Number detach(const Number& a) { return a.value; }
Number with_derivative(const Number& y, const Number& x, const Number& dy_dx) {
  const bool moves = x.derivative != 0.0;
  return {y.value, y.derivative + (moves ? static_cast<double>(dy_dx.value) * x.derivative : 0.0)};
}

}  // namespace probe

namespace {

using probe::Number;

// f at x: the derivative to a relative 1e-6 of `exact`, and the value of the float function.
#define EXPECT_DERIVATIVE(function, x, exact)                            \
  {                                                                      \
    const Number result = math::function(Number(x, 1.0));                \
    const double expected = exact;                                       \
    EXPECT_SAME(result.value, math::function(x));                        \
    EXPECT_NEAR(result.derivative, expected, 1e-6 * std::fabs(expected)) \
        << #function << " at " << (x);                                   \
  }

TEST(MathFunctions, DerivativesOfOneArgumentAreTheAnalyticOnes) {
  for (int i = -400; i <= 400; ++i) {
    const float x = static_cast<float>(i) * 0.0171f + 0.0013f;
    const double d = x;
    EXPECT_DERIVATIVE(sin, x, std::cos(d));
    EXPECT_DERIVATIVE(cos, x, -std::sin(d));
    EXPECT_DERIVATIVE(tan, x, 1.0 / (std::cos(d) * std::cos(d)));
    EXPECT_DERIVATIVE(exp, x, std::exp(d));
    EXPECT_DERIVATIVE(tanh, x, 1.0 / (std::cosh(d) * std::cosh(d)));
    const float unit = static_cast<float>(i) / 400.5f;
    const double slope =
        1.0 / std::sqrt(1.0 - static_cast<double>(unit) * static_cast<double>(unit));
    EXPECT_DERIVATIVE(asin, unit, slope);
    EXPECT_DERIVATIVE(acos, unit, -slope);
    const float positive = std::fabs(x);
    EXPECT_DERIVATIVE(log, positive, 1.0 / std::fabs(d));
    EXPECT_DERIVATIVE(rsqrt, positive, -0.5 * std::pow(std::fabs(d), -1.5));
  }
}

TEST(MathFunctions, DerivativesOfTwoArgumentsAreTheAnalyticOnes) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(-4.0f, 4.0f);
  for (int i = 0; i < 2000; ++i) {
    const float x = uniform(random), y = uniform(random), base = std::fabs(x);
    const double dx = x, dy = y, norm = dx * dx + dy * dy, power = std::pow(std::fabs(dx), dy);
    auto near = [&](const Number& got, double expected, float value, double scale = 0.0) {
      EXPECT_SAME(got.value, value);
      EXPECT_NEAR(got.derivative, expected, 2e-6 * std::max(std::fabs(expected), scale))
          << x << ", " << y;
    };
    near(math::atan2(Number(y, 1.0), Number(x)), dx / norm, math::atan2(y, x));
    near(math::atan2(Number(y), Number(x, 1.0)), -dy / norm, math::atan2(y, x));
    near(math::atan2(Number(y, 2.0), Number(x, 3.0)), (2.0 * dx - 3.0 * dy) / norm,
         math::atan2(y, x), 3.0 / std::sqrt(norm));
    near(math::pow(Number(base, 1.0), Number(y)), dy * power / std::fabs(dx), math::pow(base, y));
    near(math::pow(Number(base), Number(y, 1.0)), power * std::log(std::fabs(dx)),
         math::pow(base, y));
  }
}

TEST(MathFunctions, DerivativesWhereThereIsNoneFollowTheConventions) {
  auto of = [](const Number& result) { return static_cast<float>(result.derivative); };
  auto x = [](float value) { return Number(value, 1.0); };
  for (const float outside : {1.0f, 1.5f, kInf}) {
    EXPECT_EQ(of(math::acos(x(outside))), 0.0f);
    EXPECT_EQ(of(math::acos(x(-outside))), 0.0f);
    EXPECT_EQ(of(math::asin(x(outside))), 0.0f);
    EXPECT_EQ(of(math::asin(x(-outside))), 0.0f);
  }
  EXPECT_SAME(of(math::log(x(0.0f))), kInf);
  EXPECT_SAME(of(math::log(x(-0.0f))), -kInf);
  EXPECT_EQ(of(math::rsqrt(x(0.0f))), 0.0f);
  EXPECT_EQ(of(math::rsqrt(x(-1.0f))), 0.0f);
  EXPECT_EQ(of(math::atan2(x(0.0f), Number(0.0f))), 0.0f);
  EXPECT_EQ(of(math::atan2(Number(-0.0f), x(-0.0f))), 0.0f);
  EXPECT_SAME(of(math::pow(x(0.0f), Number(-1.0f))), -kInf);
  EXPECT_EQ(of(math::pow(x(0.0f), Number(0.0f))), 0.0f);
  EXPECT_SAME(of(math::pow(x(0.0f), Number(0.5f))), kInf);
  EXPECT_EQ(of(math::pow(x(0.0f), Number(1.0f))), 1.0f);
  EXPECT_EQ(of(math::pow(x(0.0f), Number(2.0f))), 0.0f);
  EXPECT_EQ(of(math::pow(x(-2.0f), Number(3.0f))), 12.0f);
  EXPECT_EQ(of(math::pow(Number(0.0f), x(2.0f))), 0.0f);
  EXPECT_SAME(of(math::pow(Number(-2.0f), x(3.0f))), kNan);
}

TEST(MathFunctions, TracedOperationsGiveTheBitsOfTheFloatFunctions) {
  std::mt19937 random(7);
  std::vector<float> grid = {0.0f, -0.0f, kTiny, -kTiny,    0.5f, 1.0f,  -1.0f,
                             2.0f, -3.0f, 1e7f,  -kLargest, kInf, -kInf, kNan};
  for (int i = 0; i < 100; ++i) grid.push_back(math::bits_float(static_cast<int32_t>(random())));
  for (const float x : grid) {
    EXPECT_SAME(math::sin(Number(x)).value, math::sin(x));
    EXPECT_SAME(math::cos(Number(x)).value, math::cos(x));
    EXPECT_SAME(math::tan(Number(x)).value, math::tan(x));
    EXPECT_SAME(math::exp(Number(x)).value, math::exp(x));
    EXPECT_SAME(math::log(Number(x)).value, math::log(x));
    EXPECT_SAME(math::tanh(Number(x)).value, math::tanh(x));
    EXPECT_SAME(math::asin(Number(x)).value, math::asin(x));
    EXPECT_SAME(math::acos(Number(x)).value, math::acos(x));
    EXPECT_SAME(math::rsqrt(Number(x)).value, math::rsqrt(x));
    for (const float y : grid) {
      EXPECT_SAME(math::pow(Number(x), Number(y)).value, math::pow(x, y));
      EXPECT_SAME(math::atan2(Number(y), Number(x)).value, math::atan2(y, x));
    }
  }
}

}  // namespace
}  // namespace novaphy
