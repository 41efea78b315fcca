// Adjoints against an oracle that uses forward mode and central differences in double precision.
// The tests cover the rule of every operation, its kinks, and every way in which a source is read.
#include <cmath>
#include <limits>
#include <set>

#include "support.h"

namespace novaphy::testing {
namespace {

using nova::Bool;
using nova::make_kernel;
using nova::make_reduce_kernel;
using nova::ir::Op;

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// out = f(a, b, c) of three direct sources.
using Formula = Real (*)(const Real&, const Real&, const Real&);
Kernel pointwise(Formula f) {
  return make_kernel("pointwise",
                     {{"a", DType::F32, 1, Access::Direct},
                      {"b", DType::F32, 1, Access::Direct},
                      {"c", DType::F32, 1, Access::Direct}},
                     {{"out", 1}},
                     [f](TraceContext& t) { return std::vector{f(t.f32(0), t.f32(1), t.f32(2))}; });
}

// The three gradients of sum(seed * f) at one point.
std::vector<float> gradients_at(Formula f, float a, float b = 0.0f, float c = 0.0f,
                                float seed = 1.0f) {
  const std::vector<Tensor> in = {tensor({a}, true), tensor({b}, true), tensor({c}, true)};
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(pointwise(f)(1, in)[0], tensor({seed}));
  return {in[0].grad().item(), in[1].grad().item(), in[2].grad().item()};
}
std::vector<float> three(float a, float b, float c) { return {a, b, c}; }

struct Rule {
  Op op;
  Formula f;
  float lo = -2.0f, hi = 2.0f;
};

// Every op with a float result that takes a float or makes one: x + 0.5 keeps away from the kinks
// at 0.
const Rule kRules[] = {
    {Op::ADD, [](const Real& a, const Real& b, const Real& c) { return (a + b) + (a + c); }},
    {Op::SUB, [](const Real& a, const Real& b, const Real& c) { return (a - b) - (c - a); }},
    {Op::MUL, [](const Real& a, const Real& b, const Real& c) { return (a * b) * c + a * a; }},
    {Op::DIV,
     [](const Real& a, const Real& b, const Real& c) { return a / b + (a / c) / (Real(3.0f) / a); },
     0.5f, 2.0f},
    {Op::NEG, [](const Real& a, const Real& b, const Real& c) { return -(a * -b) + -c; }},
    {Op::ABS, [](const Real& a, const Real& b, const Real& c) { return abs(a) * abs(b * c); }},
    {Op::SIGN,
     [](const Real& a, const Real& b, const Real& c) { return sign(a) * b + c * sign(b); }},
    {Op::MIN,
     [](const Real& a, const Real& b, const Real& c) { return min(a, b) * min(b, min(c, a)); }},
    {Op::MAX,
     [](const Real& a, const Real& b, const Real& c) { return max(a, b) * max(b, max(c, a)); }},
    {Op::SQRT, [](const Real& a, const Real& b, const Real& c) { return sqrt(a) * sqrt(b * c); },
     0.1f, 2.0f},
    {Op::FMA, [](const Real& a, const Real& b,
                 const Real& c) { return fma(a, b, c) * fma(c, a, fma(b, b, a)); }},
    {Op::FLOOR,
     [](const Real& a, const Real& b, const Real& c) { return floor(a) * b + floor(c * b) * c; }},
    {Op::SELECT_F, [](const Real& a, const Real& b,
                      const Real& c) { return select(a < b, a * c, select(b < c, b * b, c)); }},
    {Op::I_TO_F,
     [](const Real& a, const Real& b, const Real& c) { return to_real(to_int(a)) * b + c; }},
    {Op::CONST_F, [](const Real& a, const Real&,
                     const Real& c) { return a * Real(1.5f) + c / Real(3.0f) - Real(2.0f); }},
    {Op::LOAD_F, [](const Real& a, const Real&, const Real&) { return a; }},
};

TEST(AdjointRule, EveryOpHasTheDerivativeOfItsValue) {
  Random random(1);
  for (const Rule& rule : kRules) {
    SCOPED_TRACE(nova::ir::kOpNames[static_cast<int>(rule.op)]);
    const auto leaf = [&] { return random.leaf({24}, rule.lo, rule.hi); };
    const Call call{pointwise(rule.f), 24, {leaf(), leaf(), leaf()}};
    const auto& instrs = call.kernel.traced().instrs;
    EXPECT_TRUE(std::any_of(instrs.begin(), instrs.end(),
                            [&](const auto& in) { return in.op == rule.op; }));
    expect_gradients(call, random);
  }
}

TEST(AdjointRule, ExistsInThisTestForEveryOpWithAFloatResult) {
  std::set<Op> known = {Op::PARAM_F, Op::SUM, Op::PARTIAL, Op::DETACH,
                        Op::BITS_F};  // tests of their own below
  for (const Rule& rule : kRules) known.insert(rule.op);
  for (int k = 0; k < nova::ir::kOpCount; ++k) {
    if (nova::ir::kOpSignatures[k][0] != 'f') continue;
    EXPECT_TRUE(known.contains(static_cast<Op>(k))) << nova::ir::kOpNames[k];
  }
}

TEST(AdjointRule, OfAParameterIsThatOfAConstant) {
  const Kernel kernel = make_kernel(
      "scaled", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}}, [](TraceContext& c) {
        return std::vector{c.f32(0) * c.param(0) + to_real(c.param_i32(1)) * c.f32(0) + c.param(2)};
      });
  Random random(2);
  expect_gradients({kernel, 5, {random.leaf({5})}, {2.5f, int32_t{3}, -1.0f}}, random);
}

TEST(AdjointRule, OfADetachedValueIsNothingAndOfADeclaredDerivativeWhatWasDeclared) {
  const Kernel kernel = make_kernel(
      "declared", {{"x", DType::F32, 1, Access::Direct}, {"y", DType::F32, 1, Access::Direct}},
      {{"out", 1}}, [](TraceContext& c) {
        const Real x = c.f32(0), y = c.f32(1);
        return std::vector{detach(x * y) * x + with_derivative(detach(x * x), x, Real(7.0f)) +
                           with_derivative(x * y, y, x * x)};
      });
  Random random(3);
  const Call call{kernel, 9, {random.leaf({9}), random.leaf({9})}};
  expect_gradients(call, random, 2e-5, false);
  // x*y + 7 + y, and x + x^2, at one point.
  const Tensor x = tensor({2.0f}, true), y = tensor({3.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(kernel(1, {x, y})[0]);
  EXPECT_EQ(x.grad().item(), 6.0f + 7.0f + 3.0f);
  EXPECT_EQ(y.grad().item(), 2.0f + 4.0f);
}

// The elementary functions state their derivatives; compared with the derivatives of libm's in
// double.
TEST(AdjointRule, OfAFunctionIsItsDerivative) {
  struct Function {
    const char* name;
    Formula f;
    double (*derivative)(double);
    float lo, hi;
  };
  const Function functions[] = {
      {"sin", [](const Real& x, const Real&, const Real&) { return nova::sin(x); }, std::cos, -9.0f,
       9.0f},
      {"cos", [](const Real& x, const Real&, const Real&) { return nova::cos(x); },
       [](double x) { return -std::sin(x); }, -9.0f, 9.0f},
      {"tan", [](const Real& x, const Real&, const Real&) { return nova::tan(x); },
       [](double x) { return 1.0 / (std::cos(x) * std::cos(x)); }, -1.4f, 1.4f},
      {"exp", [](const Real& x, const Real&, const Real&) { return nova::exp(x); }, std::exp, -3.0f,
       3.0f},
      {"log", [](const Real& x, const Real&, const Real&) { return nova::log(x); },
       [](double x) { return 1.0 / x; }, 0.1f, 9.0f},
      {"tanh", [](const Real& x, const Real&, const Real&) { return nova::tanh(x); },
       [](double x) { return 1.0 - std::tanh(x) * std::tanh(x); }, -2.0f, 2.0f},
      {"asin", [](const Real& x, const Real&, const Real&) { return nova::asin(x); },
       [](double x) { return 1.0 / std::sqrt(1.0 - x * x); }, -0.95f, 0.95f},
      {"acos", [](const Real& x, const Real&, const Real&) { return nova::acos(x); },
       [](double x) { return -1.0 / std::sqrt(1.0 - x * x); }, -0.95f, 0.95f},
      {"rsqrt", [](const Real& x, const Real&, const Real&) { return nova::rsqrt(x); },
       [](double x) { return -0.5 / (x * std::sqrt(x)); }, 0.1f, 4.0f},
      {"pow in x", [](const Real& x, const Real&, const Real&) { return nova::pow(x, Real(2.5f)); },
       [](double x) { return 2.5 * std::pow(x, 1.5); }, 0.1f, 3.0f},
      {"pow in y", [](const Real& x, const Real&, const Real&) { return nova::pow(Real(1.7f), x); },
       [](double x) { return std::pow(1.7f, x) * std::log(1.7f); }, -2.0f, 2.0f},
      {"atan2 in y",
       [](const Real& x, const Real&, const Real&) { return nova::atan2(x, Real(-0.75f)); },
       [](double y) { return -0.75 / (y * y + 0.75 * 0.75); }, 0.1f, 2.0f},
      {"atan2 in x",
       [](const Real& x, const Real&, const Real&) { return nova::atan2(Real(0.5f), x); },
       [](double x) { return -0.5 / (x * x + 0.25); }, -2.0f, 2.0f},
  };
  Random random(4);
  for (const Function& function : functions) {
    for (int k = 0; k < 10; ++k) {
      const float x = random.uniform(function.lo, function.hi);
      const double expected = function.derivative(static_cast<double>(x));
      EXPECT_NEAR(gradients_at(function.f, x)[0], expected, 2e-6 * (1.0 + std::fabs(expected)))
          << function.name << ' ' << x;
    }
  }
}

TEST(AdjointKink, MinAndMaxPassATieToTheSecondOperand) {
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return min(a, b); }, 2.0f, 2.0f),
      three(0.0f, 1.0f, 0.0f));
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return max(a, b); }, 2.0f, 2.0f),
      three(0.0f, 1.0f, 0.0f));
  EXPECT_EQ(gradients_at([](const Real& a, const Real& b, const Real&) { return min(a, b); }, -0.0f,
                         0.0f),
            three(0.0f, 1.0f, 0.0f));
  EXPECT_EQ(gradients_at([](const Real& a, const Real&, const Real&) { return max(a, a); }, 2.0f),
            three(1.0f, 0.0f, 0.0f));
  // vn = 0: the damping's min(vn, 0) takes the constant.
  EXPECT_EQ(gradients_at([](const Real& a, const Real&, const Real&) { return min(a, Real(0.0f)); },
                         0.0f)[0],
            0.0f);
}

TEST(AdjointKink, MinAndMaxPassANaNToTheOperandThatTheValueCameFrom) {
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return min(a, b); }, kNan, 2.0f),
      three(0.0f, 1.0f, 0.0f));
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return max(a, b); }, 2.0f, kNan),
      three(0.0f, 1.0f, 0.0f));
}

TEST(AdjointKink, AbsHasTheDerivativePlusOneAtBothZeros) {
  const Formula f = [](const Real& a, const Real&, const Real&) { return abs(a); };
  EXPECT_EQ(gradients_at(f, 0.0f)[0], 1.0f);
  EXPECT_EQ(gradients_at(f, -0.0f)[0], 1.0f);
  EXPECT_EQ(gradients_at(f, -1e-45f)[0], -1.0f);
}

TEST(AdjointKink, SqrtLengthAndUnitVectorPassNothingAtZero) {
  EXPECT_EQ(gradients_at([](const Real& a, const Real&, const Real&) { return sqrt(a); }, 0.0f)[0],
            0.0f);
  const Formula length = [](const Real& a, const Real& b, const Real& c) {
    return math::length(Vec3<Real>{a, b, c});
  };
  EXPECT_EQ(gradients_at(length, 0.0f, -0.0f, 0.0f), three(0.0f, 0.0f, 0.0f));
  EXPECT_EQ(gradients_at(length, 0.0f, 2.0f, 0.0f), three(0.0f, 1.0f, 0.0f));
  const Formula unit = [](const Real& a, const Real& b, const Real& c) {
    const Vec3<Real> u = math::normalize(Vec3<Real>{a, b, c});
    return u.x + u.y * Real(2.0f) + u.z * Real(3.0f);
  };
  EXPECT_EQ(gradients_at(unit, 0.0f, 0.0f, -0.0f), three(0.0f, 0.0f, 0.0f));
  const auto at = gradients_at(unit, 0.0f, 0.0f, 4.0f);
  EXPECT_FLOAT_EQ(at[0], 0.25f);
  EXPECT_FLOAT_EQ(at[1], 0.5f);
  EXPECT_EQ(at[2], 0.0f);
}

// One reciprocal serves all quotients by a length. The reciprocal keeps all its digits for the
// smallest and largest lengths too.
TEST(AdjointRule, OfAUnitVectorHoldsForTheSmallestAndLargestLengths) {
  const Formula unit = [](const Real& a, const Real& b, const Real& c) {
    return math::normalize(Vec3<Real>{a, b, c}).x;
  };
  for (const float length : {1e-18f, 1e-10f, 1.0f, 1e10f, 1.6e19f}) {
    const auto at = gradients_at(unit, 0.6f * length, 0.8f * length, 0.0f);
    const double scale = 1.0 / static_cast<double>(length);
    EXPECT_NEAR(at[0], 0.64 * scale, 2e-6 * scale) << length;
    EXPECT_NEAR(at[1], -0.48 * scale, 2e-6 * scale) << length;
    EXPECT_EQ(at[2], 0.0f) << length;
  }
}

TEST(AdjointKink, AnOptionalProductIsZeroWithItsCoefficientAndHasTheDerivativesOfAProduct) {
  const Formula f = [](const Real& a, const Real& b, const Real& c) {
    return math::optional_product(a, b * b) + c;
  };
  EXPECT_EQ(gradients_at(f, 2.0f, 3.0f), three(9.0f, 12.0f, 1.0f));
  EXPECT_EQ(gradients_at(f, 0.0f, 3.0f), three(9.0f, 0.0f, 1.0f));
  EXPECT_EQ(gradients_at(f, -0.0f, 3.0f), three(9.0f, 0.0f, 1.0f));
  for (const float bad : {kInf, kNan}) {
    EXPECT_EQ(pointwise(f)(1, {tensor({0.0f}), tensor({bad}), tensor({5.0f})})[0].item(), 5.0f);
    EXPECT_EQ(gradients_at(f, 0.0f, bad)[1], 0.0f);
  }
}

TEST(AdjointKink, BitPatternsAndIntegersPassNothing) {
  EXPECT_EQ(gradients_at([](const Real& a, const Real& b,
                            const Real&) { return bits_float(float_bits(a)) * b; },
                         3.0f, 2.0f),
            three(0.0f, 3.0f, 0.0f));
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return to_real(to_int(a)) * b; },
                   3.5f, 2.0f),
      three(0.0f, 3.0f, 0.0f));
}

TEST(AdjointKink, SignStepAndFloorPassNothing) {
  const Formula f = [](const Real& a, const Real& b, const Real& c) {
    return sign(a) + math::step(b) + floor(c);
  };
  for (const float x : {0.0f, -0.0f, 1.0f, -3.5f})
    EXPECT_EQ(gradients_at(f, x, x, x), three(0.0f, 0.0f, 0.0f)) << x;
}

TEST(AdjointKink, ZeroTimesInfinityIsZeroWhereThePartialIsInfinite) {
  EXPECT_EQ(gradients_at([](const Real& a, const Real& b, const Real&) { return a / b; }, 1.0f,
                         0.0f, 0.0f, 0.0f),
            three(0.0f, 0.0f, 0.0f));
  EXPECT_EQ(gradients_at([](const Real& a, const Real&, const Real&) { return nova::log(a); }, 0.0f,
                         0.0f, 0.0f, 0.0f)[0],
            0.0f);
  EXPECT_EQ(gradients_at([](const Real& a, const Real&, const Real&) { return sqrt(a); }, 1e-45f,
                         0.0f, 0.0f, 0.0f)[0],
            0.0f);
  EXPECT_EQ(gradients_at([](const Real& a, const Real& b, const Real&) { return nova::pow(a, b); },
                         0.0f, 0.5f, 0.0f, 0.0f),
            three(0.0f, 0.0f, 0.0f));
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real&, const Real&) { return nova::acos(a); }, 1.0f)[0],
      0.0f);
  EXPECT_EQ(
      gradients_at([](const Real& a, const Real& b, const Real&) { return nova::atan2(a, b); },
                   0.0f, 0.0f),
      three(0.0f, 0.0f, 0.0f));
}

TEST(AdjointKink, ASelectPassesNothingToTheSideThatIsNotTakenEvenIfItIsNaN) {
  const Formula divided = [](const Real& a, const Real& b, const Real& c) {
    return select(b > Real(0.0f), a / b + nova::log(b), c);
  };
  EXPECT_EQ(gradients_at(divided, 1.0f, 0.0f, 5.0f), three(0.0f, 0.0f, 1.0f));
  EXPECT_EQ(gradients_at(divided, 1.0f, 2.0f, 5.0f), three(0.5f, 0.25f, 0.0f));
  // Through products, whose rules have no zero of their own.
  const Formula product = [](const Real& a, const Real& b, const Real& c) {
    return select(a < Real(1.0f), c, (a * b) * (b * b));
  };
  EXPECT_EQ(gradients_at(product, 0.0f, kInf, 5.0f), three(0.0f, 0.0f, 1.0f));
  EXPECT_EQ(gradients_at(product, 0.0f, kNan, 5.0f), three(0.0f, 0.0f, 1.0f));
  // The value is used on both sides and outside: only its own uses count.
  const Formula shared = [](const Real& a, const Real& b, const Real& c) {
    const Real bad = a * b;
    return select(c > Real(0.0f), bad * bad, c) + a;
  };
  EXPECT_EQ(gradients_at(shared, 2.0f, kInf, -1.0f), three(1.0f, 0.0f, 1.0f));
  const Formula nested = [](const Real& a, const Real& b, const Real& c) {
    return select(c > Real(0.0f), select(b > Real(0.0f), sqrt(a / b), a * b),
                  select(b > Real(1.0f), nova::log(a) * b, a * c));
  };
  EXPECT_EQ(gradients_at(nested, -3.0f, 0.0f, -2.0f), three(-2.0f, 0.0f, -3.0f));
}

TEST(AdjointKink, AConditionThatNeedsTheValueTooDoesNotLetItsInfinityOut) {
  const Formula f = [](const Real& a, const Real& b, const Real& c) {
    const Real r = a * b;  // computed always, because of the condition
    return select(r < Real(1.0f), r * r, c);
  };
  EXPECT_EQ(gradients_at(f, 0.5f, 0.5f, 5.0f), three(0.25f, 0.25f, 0.0f));
  EXPECT_EQ(gradients_at(f, 2.0f, kInf, 5.0f), three(0.0f, 0.0f, 1.0f));
  EXPECT_EQ(gradients_at(f, 0.0f, kInf, 5.0f), three(0.0f, 0.0f, 1.0f));
}

TEST(AdjointKink, WhatIsComputedOutsideOfASumForOneSideInItStaysThere) {
  // a*b does not depend on the item, so the kernel computes it once, before the sum. q is needed
  // only for one side, after the sum.
  const Kernel kernel = make_reduce_kernel(
      "invariant",
      {{"a", DType::F32, 1, Access::Direct},
       {"b", DType::F32, 1, Access::Direct},
       {"r", DType::F32, 1, Access::Reduced}},
      {{"out", 1}},
      {.init = {},
       .body =
           [](TraceContext& c) {
             const Real p = c.f32(0) * c.f32(1);
             return std::vector{
                 select(c.f32(2) > Real(0.0f), fma(p, c.f32(1), p) * c.f32(2), c.f32(2))};
           },
       .epilogue =
           [](TraceContext& c, std::span<const Real> s) {
             const Real q = (c.f32(0) * c.f32(1)) * (c.f32(1) * c.f32(1));
             return std::vector{select(s[0] > Real(0.0f), s[0] * q, s[0])};
           }});
  Random random(5);
  expect_gradients({kernel, 4, {random.leaf({4}), random.leaf({4}), random.leaf({3})}, {}, 3},
                   random, 1e-4);
  const Tensor a = tensor({2.0f}, true), b = tensor({kInf}, true), r = tensor({-1.0f, -2.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(kernel(1, {a, b, r}, {.extent = 2})[0]);
  EXPECT_EQ(a.grad().item(), 0.0f);
  EXPECT_EQ(b.grad().item(), 0.0f);
  EXPECT_EQ(r.grad().to_host(), (std::vector<float>{1.0f, 1.0f}));
}

TEST(AdjointKink, APowerOfASelectedBaseStaysFinite) {
  // The branch that is not taken holds the only use of an operand that is infinite.
  const Kernel kernel = make_kernel(
      "guarded", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 2}}, [](TraceContext& c) {
        const Real x = c.f32(0);
        const Bool positive = x > Real(0.0f);
        const Real r = Real(1.0f) / x;
        return std::vector{select(positive, r * r, x),
                           select(negate(positive), x * x, nova::sqrt(x) * r)};
      });
  const Tensor x = tensor({0.0f, 4.0f, -1.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(nova::sum(kernel(3, {x})[0]));
  const auto g = x.grad().to_host();
  EXPECT_EQ(g[0], 1.0f);
  EXPECT_FLOAT_EQ(g[1], -2.0f / 64.0f - 0.5f / 8.0f);
  EXPECT_EQ(g[2], 1.0f - 2.0f);
}

// ---- access kinds ----

TEST(AdjointAccess, DirectAndUniformSourcesWithSeveralColumns) {
  const Kernel kernel = make_kernel(
      "affine", {{"x", DType::F32, 3, Access::Direct}, {"m", DType::F32, 4, Access::Uniform}},
      {{"y", 2}, {"z", 1}}, [](TraceContext& c) {
        return std::vector{c.f32(0, 0) * c.f32(1, 2) + c.f32(1, 0), c.f32(0, 2) * c.f32(0, 0),
                           c.f32(1, 3) * c.f32(1, 2) * c.f32(0, 2)};
      });
  Random random(10);
  for (const int64_t n : {1, 7})
    expect_gradients({kernel, n, {random.leaf({n, 3}), random.leaf({1, 4})}}, random);
  const Tensor x =
      tensor(random.values(3 * 700), {700, 3});  // the row-sum over more than 256 rows is cut
  expect_gradients({kernel, 700, {x, random.leaf({1, 4})}}, random);
}

TEST(AdjointAccess, AUniformSourceOfSeveralRowsHasAGradientInItsFirstRowOnly) {
  const Kernel kernel = make_kernel(
      "scale", {{"x", DType::F32, 1, Access::Direct}, {"s", DType::F32, 1, Access::Uniform}},
      {{"y", 1}}, [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(1)}; });
  Random random(11);
  expect_gradients({kernel, 6, {random.leaf({6}), random.leaf({4})}}, random);
}

Kernel triangle_kernel() {  // one source at three columns of one table and at another table
  return make_kernel("triangle",
                     {{"corner", DType::I32, 3, Access::Direct},
                      {"other", DType::I32, 1, Access::Direct},
                      {"x", DType::F32, 2, Access::Indexed},
                      {"w", DType::F32, 1, Access::Direct}},
                     {{"area", 1}, {"edge", 2}}, [](TraceContext& c) {
                       const auto at = [&](int32_t k) {
                         return std::pair{c.f32(2, c.i32(0, k), 0), c.f32(2, c.i32(0, k), 1)};
                       };
                       const auto [ax, ay] = at(0);
                       const auto [bx, by] = at(1);
                       const auto [cx, cy] = at(2);
                       const Real other = c.f32(2, c.i32(1), 1);
                       return std::vector{(bx - ax) * (cy - ay) - (cx - ax) * (by - ay),
                                          other * c.f32(3), ax * other};
                     });
}

TEST(AdjointAccess, OneSourceAtSeveralColumnsOfATableAndAtAnotherTable) {
  Random random(12);
  std::vector<int32_t> corners, other;
  for (int k = 0; k < 20; ++k) {
    for (int c = 0; c < 3; ++c) corners.push_back(random.below(9));
    other.push_back(random.below(9));
  }
  const Call call{triangle_kernel(),
                  20,
                  {table(corners, 3), table(other), random.leaf({9, 2}), random.leaf({20})}};
  expect_gradients(call, random);
}

TEST(AdjointAccess, ATableEntryOfMinusOneReadsZeroAndPassesNothing) {
  Random random(13);
  const std::vector<int32_t> corners = {0, -1, 2, -1, -1, -1, 3, 3, 0, 1, 2, -1},
                             other = {-1, 3, -1, 0};
  const Call call{triangle_kernel(),
                  4,
                  {table(corners, 3), table(other), random.leaf({4, 2}), random.leaf({4})}};
  expect_gradients(call, random);
  const auto out = call();
  EXPECT_EQ(out[0].to_host()[1], 0.0f);
}

TEST(AdjointAccess, ARowThatNoTableEntryNamesHasAZeroGradient) {
  Random random(14);
  const Tensor x = random.leaf({40, 2});
  expect_gradients(
      {triangle_kernel(), 2, {table({0, 1, 2, 0, 2, 30}, 3), table({1, 1}), x, random.leaf({2})}},
      random);
  const auto g = x.grad().to_host();
  for (size_t row = 3; row < 30; ++row) EXPECT_EQ(g[2 * row], 0.0f) << row;
}

TEST(AdjointAccess, ATableRowReadMoreThan256TimesSumsInChunks) {
  Random random(15);
  std::vector<int32_t> corners(3 * 900, 1), other(900, 0);
  for (size_t k = 0; k < corners.size(); k += 7) corners[k] = 2;
  const Tensor w = tensor(random.values(900));
  expect_gradients(
      {triangle_kernel(), 900, {table(corners, 3), table(other), random.leaf({3, 2}), w}}, random,
      1e-4);
}

TEST(AdjointAccess, AnIndexedSourceAtTheRowItselfAndAtATable) {
  // x[i] and x[next[i]]: a difference along a chain, with one source.
  const Kernel kernel =
      make_kernel("difference",
                  {{"next", DType::I32, 1, Access::Direct}, {"x", DType::F32, 2, Access::Indexed}},
                  {{"out", 1}}, [](TraceContext& c) {
                    const Int i = c.index();
                    const Real d = c.f32(1, c.i32(0), 0) - c.f32(1, i, 0);
                    return std::vector{d * d + c.f32(1, i, 1)};
                  });
  Random random(16);
  expect_gradients({kernel, 6, {table({1, 2, 3, 4, 5, -1}), random.leaf({6, 2})}}, random);
  SCOPED_TRACE("a source with more rows than the kernel");
  expect_gradients({kernel, 4, {table({5, 6, 0, 1}), random.leaf({9, 2})}}, random);
}

TEST(AdjointAccess, AnIndexedSourceAtRowZeroAndAtATable) {
  const Kernel kernel = make_kernel(
      "relative", {{"at", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}},
      [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0) * c.f32(1, Int(0), 0)}; });
  Random random(17);
  expect_gradients({kernel, 5, {table({0, 2, 2, 1, 3}), random.leaf({4})}}, random);
}

Kernel fixed_kernel() {  // everything that a fixed sum can read, and an epilogue that is not linear
                         // in the sums
  return make_reduce_kernel(
      "fixed",
      {{"x", DType::F32, 2, Access::Direct},
       {"u", DType::F32, 1, Access::Uniform},
       {"r", DType::F32, 3, Access::Reduced},
       {"at", DType::I32, 1, Access::Direct},
       {"g", DType::F32, 1, Access::Indexed}},
      {{"a", 1}, {"b", 2}},
      {.init =
           [](TraceContext& c) {
             return std::vector{c.f32(0, 1), c.f32(1) * c.f32(0, 0), Real(1.0f)};
           },
       .body =
           [](TraceContext& c) {
             const Real x = c.f32(0, 0), u = c.f32(1), gathered = c.f32(4, c.i32(3), 0);
             const Real term = c.f32(2, 0) * x + c.f32(2, 2) * u * gathered;
             // The last term is the same for all items.
             return std::vector{term * term, c.f32(2, 1) * to_real(c.reduce_index()), x * u};
           },
       .epilogue =
           [](TraceContext& c, std::span<const Real> s) {
             return std::vector{s[0] * s[1] * c.f32(0, 1), sqrt(s[2] * s[2] + s[0] * s[0]),
                                s[1] / (s[2] * s[2] + Real(1.0f))};
           }});
}
Call fixed_call(Random& random, int64_t n, int64_t rows, int32_t extent) {
  std::vector<int32_t> at;
  for (int64_t i = 0; i < n; ++i) at.push_back(random.below(6) - 1);
  return {fixed_kernel(),
          n,
          {random.leaf({n, 2}, -1.0f, 1.0f), random.leaf({1}), random.leaf({rows, 3}, -1.0f, 1.0f),
           table(at), random.leaf({5})},
          {},
          extent};
}

TEST(AdjointAccess, AFixedSumWithANonlinearEpilogue) {
  Random random(20);
  for (const int32_t extent : {1, 4})
    expect_gradients(fixed_call(random, 6, extent, extent), random);
  SCOPED_TRACE("rows beyond the extent");
  expect_gradients(fixed_call(random, 5, 7, 3), random);
  SCOPED_TRACE("no items");
  expect_gradients(fixed_call(random, 5, 2, 0), random);
}

TEST(AdjointAccess, GradientsThatAreThereAreAddedTo) {
  Random random(21);
  const Call call = fixed_call(random, 5, 7, 3);
  const Seeds seeds = random_seeds(call, random);
  const Gradients once = tape_gradients(call, seeds, Backward::Each);
  Tape tape;
  const TapeScope scope(tape);
  const auto out = call();
  for (int repeat = 0; repeat < 2; ++repeat)
    for (size_t o = 0; o < out.size(); ++o) tape.backward(out[o], tensor(seeds[o], out[o].shape()));
  for (const Tensor& t : call.inputs) {
    if (!t.requires_grad()) continue;
    const auto g = t.grad().to_host();
    const auto& expected = once.at(t.range().get());
    for (size_t k = 0; k < g.size(); ++k)
      EXPECT_NEAR(g[k], 3.0 * expected[k], 1e-5 * (1.0 + std::fabs(expected[k])));
  }
}

Kernel csr_kernel() {
  return make_reduce_kernel(
      "csr",
      {{"x", DType::F32, 1, Access::Direct},
       {"u", DType::F32, 2, Access::Uniform},
       {"e", DType::F32, 2, Access::CsrRow},
       {"other", DType::I32, 2, Access::CsrRow},
       {"g", DType::F32, 2, Access::Indexed}},
      {{"a", 1}, {"b", 1}},
      {.init =
           [](TraceContext& c) {
             return std::vector{c.f32(0) * c.f32(0), c.f32(1, 1)};
           },
       .body =
           [](TraceContext& c) {
             const Real near = c.f32(4, c.i32(3, 0), 0), far = c.f32(4, c.i32(3, 1), 1);
             const Real d = near - c.f32(0);
             return std::vector{d * c.f32(2, 0) * c.f32(1, 0),
                                select(far > near, far * c.f32(2, 1), near * near)};
           },
       .epilogue =
           [](TraceContext& c, std::span<const Real> s) {
             return std::vector{s[0] * s[1], sqrt(s[1] * s[1] + c.f32(0) * c.f32(0))};
           }});
}
// Slots of 6 rows: an empty row, a row with one slot, unused slots in between and at the end.
const std::vector<int32_t> kRowOfSlot = {4, 0, -1, 4, 2, 0, -1, 5, 4, 2, -1, -1};
constexpr int64_t kSlots = 12, kRows = 6;

Call csr_call(Random& random) {
  std::vector<int32_t> other;
  for (int64_t k = 0; k < 2 * kSlots; ++k) other.push_back(random.below(5) - 1);
  return {csr_kernel(),
          kRows,
          {random.leaf({kRows}), random.leaf({1, 2}), random.leaf({kSlots, 2}), table(other, 2),
           random.leaf({4, 2})},
          {},
          0,
          nova::make_incidence(table(kRowOfSlot).operand(), kRows)};
}

TEST(AdjointAccess, ACsrSumWithEmptyRowsAndUnusedSlotsAndIndexedThroughACsrTable) {
  for (uint32_t seed = 30; seed < 34; ++seed) {
    Random random(seed);
    const Call call = csr_call(random);
    expect_gradients(call, random);
    const auto g = call.inputs[2].grad().to_host();
    for (size_t slot = 0; slot < kRowOfSlot.size(); ++slot) {
      if (kRowOfSlot[slot] >= 0) continue;
      EXPECT_EQ(g[2 * slot], 0.0f) << slot;
      EXPECT_EQ(g[2 * slot + 1], 0.0f) << slot;
    }
  }
}

TEST(AdjointAccess, GarbageInUnusedSlotsDoesNotReachAnyGradient) {
  Random random(35);
  Call call = csr_call(random);
  const Gradients clean = tape_gradients(call, random_seeds(call, random), Backward::Together);
  random = Random(35);
  call = csr_call(random);
  std::vector<float> e = call.inputs[2].to_host();
  for (size_t slot = 0; slot < kRowOfSlot.size(); ++slot)
    if (kRowOfSlot[slot] < 0) e[2 * slot] = e[2 * slot + 1] = kNan;
  write(call.inputs[2], e);
  const Gradients dirty = tape_gradients(call, random_seeds(call, random), Backward::Together);
  auto a = clean.begin(), b = dirty.begin();
  std::vector<std::vector<double>> all_a, all_b;
  for (; a != clean.end(); ++a, ++b) {
    all_a.push_back(a->second);
    all_b.push_back(b->second);
  }
  std::sort(all_a.begin(), all_a.end());
  std::sort(all_b.begin(), all_b.end());
  EXPECT_EQ(all_a, all_b);
}

TEST(AdjointAccess, ACsrSourceMustHaveARowForEverySlot) {
  Random random(36);
  Call call = csr_call(random);
  call.inputs[2] = random.leaf({kSlots - 2, 2});  // the last two slots are unused
  EXPECT_ERROR(call(), ErrorKind::Value, "e: expected {12, 2}");
}

TEST(AdjointAccess, AnIndexedSourceAtTheSlotItself) {
  const Kernel kernel = make_reduce_kernel(
      "slots", {{"unused", DType::I32, 1, Access::CsrRow}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}},
      {.init = {},
       .body =
           [](TraceContext& c) {
             const Real x = c.f32(1, c.slot(), 0);
             return std::vector{x * x};
           },
       .epilogue = {}});
  Random random(37);
  const nova::Incidence rows = nova::make_incidence(table(kRowOfSlot).operand(), kRows);
  expect_gradients(
      {kernel, kRows, {table(std::vector<int32_t>(kSlots, 0)), random.leaf({20})}, {}, 0, rows},
      random);
}

TEST(AdjointAccess, SeveralOutputsWithOnlySomeSeeded) {
  Random random(40);
  for (const Call& call : {csr_call(random), fixed_call(random, 5, 4, 4)}) {
    for (const size_t unseeded : {size_t{0}, size_t{1}}) {
      Seeds seeds = random_seeds(call, random);
      seeds[unseeded].clear();
      for (const Backward how : {Backward::Each, Backward::Together})
        EXPECT_TRUE(close(tape_gradients(call, seeds, how), oracle_gradients(call, seeds), 1e-4))
            << unseeded;
    }
  }
}

TEST(AdjointAccess, AnOutputWithoutGradientDoesNotBringItsInfinities) {
  // The second sum has an infinite partial; only the first output has a gradient.
  const Kernel kernel = make_reduce_kernel(
      "two", {{"r", DType::F32, 1, Access::Reduced}, {"big", DType::F32, 1, Access::Reduced}},
      {{"a", 1}, {"b", 1}},
      {.init = {},
       .body =
           [](TraceContext& c) {
             return std::vector{c.f32(0) * Real(2.0f), c.f32(0) * c.f32(1)};
           },
       .epilogue = {}});
  const Tensor r = tensor({1.0f, 2.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const auto out = kernel(1, {r, tensor({1.0f, kInf})}, {.extent = 2});
  tape.backward(out[0]);
  EXPECT_EQ(r.grad().to_host(), (std::vector<float>{2.0f, 2.0f}));
}

TEST(AdjointAccess, OneTensorBoundToSeveralSources) {
  const Kernel kernel =
      make_kernel("many",
                  {{"a", DType::F32, 1, Access::Direct},
                   {"b", DType::F32, 1, Access::Uniform},
                   {"t", DType::I32, 1, Access::Direct},
                   {"c", DType::F32, 1, Access::Indexed}},
                  {{"out", 1}}, [](TraceContext& c) {
                    return std::vector{c.f32(0) * c.f32(1) + c.f32(3, c.i32(2), 0) * c.f32(0)};
                  });
  Random random(41);
  const Tensor x = random.leaf({5});
  expect_gradients({kernel, 5, {x, x, table({4, 4, 0, 1, -1}), x}}, random);
  SCOPED_TRACE("views of different shape");
  const Kernel wide = make_kernel(
      "wide", {{"a", DType::F32, 2, Access::Direct}, {"b", DType::F32, 1, Access::Uniform}},
      {{"out", 2}}, [](TraceContext& c) {
        return std::vector{c.f32(0, 0) * c.f32(1), c.f32(0, 1) * c.f32(0, 0)};
      });
  const Tensor y = random.leaf({3, 2});
  expect_gradients({wide, 3, {y, y.reshape({6})}}, random);
}

TEST(AdjointAccess, AValueInBothOutputsAndTwoColumns) {
  const Kernel kernel = make_kernel("repeated", {{"x", DType::F32, 1, Access::Direct}},
                                    {{"a", 3}, {"b", 1}}, [](TraceContext& c) {
                                      const Real s = c.f32(0) * c.f32(0);
                                      return std::vector{s, c.f32(0), s, s};
                                    });
  Random random(42);
  expect_gradients({kernel, 4, {random.leaf({4})}}, random);
}

TEST(AdjointAccess, ASourceThatIsNeverReadOrNotReachedHasAZeroGradient) {
  const Kernel kernel = make_kernel(
      "some",
      {{"x", DType::F32, 1, Access::Direct},
       {"y", DType::F32, 2, Access::Direct},
       {"z", DType::F32, 1, Access::Indexed}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{c.f32(0) + floor(c.f32(1, 1))}; });
  Random random(43);
  expect_gradients({kernel, 3, {random.leaf({3}), random.leaf({3, 2}), random.leaf({9})}}, random);
}

TEST(AdjointAccess, NoRowsGiveZeroGradients) {
  Random random(44);
  const Tensor u = random.leaf({1, 4});
  const Kernel kernel = make_kernel(
      "none", {{"x", DType::F32, 1, Access::Direct}, {"u", DType::F32, 4, Access::Uniform}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(1, 2)}; });
  Tape tape;
  const TapeScope scope(tape);
  const Tensor x(Shape{0});
  const Tensor out = kernel(0, {x, u})[0];
  tape.backward(out, Tensor(Shape{0}));
  EXPECT_EQ(u.grad().to_host(), std::vector<float>(4, 0.0f));
}

// ---- what is refused ----

void backward_of(const Kernel& kernel, int64_t n, const std::vector<Tensor>& in,
                 const nova::LaunchOptions& options = {}) {
  Tape tape;
  const TapeScope scope(tape);
  tape.backward(nova::sum(kernel(n, in, options)[0]));
}

TEST(AdjointRefuses, ARowComputedInTheKernelAndNamesTheSource) {
  const Kernel kernel =
      make_kernel("stencil", {{"x", DType::F32, 1, Access::Indexed}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0, c.index() / Int(2), 0)}; });
  EXPECT_EQ(kernel(4, {tensor({5.0f, 7.0f})})[0].to_host(),
            (std::vector<float>{5.0f, 5.0f, 7.0f, 7.0f}));
  EXPECT_ERROR(backward_of(kernel, 4, {tensor({5.0f, 7.0f}, true)}), ErrorKind::NotImplemented,
               "source 'x'");
}

TEST(AdjointRefuses, ATableInsideAFixedSum) {
  const Kernel kernel = make_reduce_kernel(
      "inner", {{"t", DType::I32, 1, Access::Reduced}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}},
      {.init = {},
       .body = [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; },
       .epilogue = {}});
  EXPECT_ERROR(backward_of(kernel, 1, {table({1, 0}), tensor({5.0f, 7.0f}, true)}, {.extent = 2}),
               ErrorKind::NotImplemented, "source 'x'");
}

TEST(AdjointRefuses, ThePositionInsideOfACsrRow) {
  const Kernel kernel = make_reduce_kernel(
      "position", {{"e", DType::F32, 1, Access::CsrRow}}, {{"out", 1}},
      {.init = {},
       .body = [](TraceContext& c) { return std::vector{c.f32(0) * to_real(c.reduce_index())}; },
       .epilogue = {}});
  const nova::Incidence rows = nova::make_incidence(table({0, 0}).operand(), 1);
  EXPECT_ERROR(backward_of(kernel, 1, {tensor({5.0f, 7.0f}, true)}, {.csr = &rows}),
               ErrorKind::NotImplemented, "position in a CSR row");
}

TEST(AdjointRefuses, ATableThatIsNotReadAsDeclared) {
  // The Incidence of a longer table would name rows that the kernel does not have.
  const Kernel kernel = make_kernel(
      "long", {{"t", DType::I32, 1, Access::Indexed}, {"x", DType::F32, 1, Access::Indexed}},
      {{"out", 1}},
      [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0, c.index(), 0), 0)}; });
  const Tensor x = tensor({5.0f, 7.0f, 9.0f}, true);
  EXPECT_EQ(kernel(2, {table({1, 0, 2, 2}), x})[0].to_host(), (std::vector<float>{7.0f, 5.0f}));
  EXPECT_ERROR(backward_of(kernel, 2, {table({1, 0, 2, 2}), x}), ErrorKind::NotImplemented,
               "source 'x'");
}

// ---- what an adjoint reads ----

std::vector<bool> values_read(const Kernel& kernel, const std::vector<bool>& wrt) {
  nova::AdjointMask mask{wrt, std::vector<bool>(wrt.size(), false),
                         std::vector<bool>(kernel.outputs().size(), true)};
  return kernel.adjoint(mask).loads_value;
}

TEST(AdjointReads, OnlyTheValuesThatTheRulesNeed) {
  const std::vector<nova::SourceSpec> ab = {{"a", DType::F32, 1, Access::Direct},
                                            {"b", DType::F32, 1, Access::Direct}};
  const auto of = [&](auto f) {
    return make_kernel("f", ab, {{"out", 1}},
                       [f](TraceContext& c) { return std::vector<Real>{f(c.f32(0), c.f32(1))}; });
  };
  using Bools = std::vector<bool>;
  EXPECT_EQ(values_read(of([](Real a, Real b) { return a + b * Real(3.0f); }), {true, true}),
            (Bools{false, false}));
  EXPECT_EQ(values_read(of([](Real a, Real b) { return a * b; }), {true, true}),
            (Bools{true, true}));
  EXPECT_EQ(values_read(of([](Real a, Real b) { return a * b; }), {true, false}),
            (Bools{false, true}));
  EXPECT_EQ(values_read(of([](Real a, Real b) { return select(a < b, a, b); }), {false, true}),
            (Bools{true, true}));
}

TEST(AdjointPlan, StoresOrAddsAsTheMaskSays) {
  Random random(50);
  const Call call = csr_call(random);
  const nova::AdjointMask store{
      {true, true, true, false, true}, std::vector<bool>(5, false), {true, true}};
  nova::AdjointMask add = store;
  add.accumulate.assign(5, true);
  EXPECT_NE(nova::ir::hash(call.kernel.adjoint(store).rows.at(0).program),
            nova::ir::hash(call.kernel.adjoint(add).rows.at(0).program));
  for (const nova::AdjointMask& mask : {store, add}) {
    const nova::AdjointPlan& plan = call.kernel.adjoint(mask);
    for (const auto* stages : {&plan.rows, &plan.items})
      for (const auto& stage : *stages) EXPECT_EQ(nova::ir::validate(stage.program), "");
  }
}

}  // namespace
}  // namespace novaphy::testing
