// Every operation over the grid of edge values, with operands in registers and as constants, for
// few and many rows.
#include <gtest/gtest.h>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include <bit>
#include <cmath>
#include <limits>

#include "harness.h"

namespace conformance {
namespace {

using ir::Op;
using ir::Type;
using ir::Value;

const std::vector<uint32_t>& float_edges() {
  static const std::vector<uint32_t> values = [] {
    const float inf = std::numeric_limits<float>::infinity();
    std::vector<uint32_t> words;
    for (const float v : {0.0f,
                          1.0f,
                          1.5f,
                          0.5f,
                          2.5f,
                          0.99999994f,
                          1.0000001f,
                          3.0f,
                          1e-45f,
                          1e-40f,
                          1.17549435e-38f,
                          3.4028235e38f,
                          2147483520.0f,
                          2147483648.0f,
                          4194304.5f,
                          8388607.5f,
                          8388608.0f,
                          16777216.0f,
                          1e10f,
                          0.1f,
                          inf}) {
      words.push_back(bits(v));
      words.push_back(bits(-v));
    }
    words.push_back(0x7FC00000u);  // NaN
    return words;
  }();
  return values;
}

const std::vector<uint32_t>& int_edges() {
  static const std::vector<uint32_t> values = {
      0u,  1u,  2u,          0xFFFFFFFFu, 0xFFFFFFFEu, 7u,          31u,
      32u, 33u, 0x7FFFFFFFu, 0x80000000u, 0x80000001u, 0x12345678u, 100u};
  return values;
}

// All bools that a Program can make from a source of integers.
const std::vector<uint32_t>& edges(char letter) {
  static const std::vector<uint32_t> bools = {0u, 1u};
  return letter == 'f' ? float_edges() : letter == 'i' ? int_edges() : bools;
}

std::vector<Op> arithmetic_ops() {
  std::vector<Op> ops;
  for (int k = static_cast<int>(Op::ADD); k < static_cast<int>(Op::PARTIAL); ++k)
    ops.push_back(static_cast<Op>(k));
  return ops;
}

class EveryOp : public testing::TestWithParam<Op> {
 protected:
  // Rows of operands: the whole grid, thinned for three operands.
  std::vector<std::vector<uint32_t>> grid() const {
    const char* s = ir::kOpSignatures[static_cast<int>(GetParam())];
    std::vector<std::vector<uint32_t>> columns;
    size_t total = 1, count = 0;
    for (int k = 1; k < 4 && s[k] != '-'; ++k, ++count) total *= edges(s[k]).size();
    columns.resize(count);
    const size_t step = total > 20000 ? 7 : 1;  // coprime to the sizes: every pair still comes up
    for (size_t at = 0; at < total; at += step) {
      size_t rest = at;
      for (size_t k = 0; k < count; ++k) {
        const auto& values = edges(s[k + 1]);
        columns[k].push_back(values[rest % values.size()]);
        rest /= values.size();
      }
    }
    return columns;
  }

  // Loads an operand; a bool is an integer that is not zero.
  static Value operand(Builder& b, char letter, Value row) {
    const int32_t source = b.source(letter == 'f' ? Type::F32 : Type::I32, 1);
    const Value v = b.load(source, row);
    return letter == 'b' ? b.op(Op::INE, v, b.i(0)) : v;
  }

  static void finish(Builder& b, Op op, Value v) {
    switch (ir::result_type(op)) {
      case Type::Bool:
        b.output({b.op(Op::SELECT_I, v, b.i(1), b.i(0))});
        break;
      case Type::I32:
      case Type::F32:
        b.output({v});
        break;
    }
  }
};

bool loses_nan_bits(Op op) { return op == Op::F_BITS; }

TEST_P(EveryOp, GivesTheExactBitsOverTheGridOfEdgeValues) {
  const Op op = GetParam();
  const char* s = ir::kOpSignatures[static_cast<int>(op)];
  auto columns = grid();
  if (loses_nan_bits(op)) columns[0].pop_back();
  Builder b;
  const Value row = b.index();
  int32_t operands[3] = {ir::kNone, ir::kNone, ir::kNone};
  for (size_t k = 0; k < columns.size(); ++k) operands[k] = operand(b, s[k + 1], row);
  finish(b, op, b.op(op, operands[0], operands[1], operands[2]));
  Inputs in;
  in.sources = columns;
  EXPECT_EQ(check(b.p, static_cast<int64_t>(columns[0].size()), in), "");
  // One row at a time goes another way through a backend.
  for (size_t k = 0; k < columns[0].size(); k += 1 + columns[0].size() / 200) {
    Inputs one;
    for (const auto& column : columns) one.sources.push_back({column[k]});
    ASSERT_EQ(check(b.p, 1, one), "") << "row " << k;
  }
}

TEST_P(EveryOp, TakesConstantsAndParametersForAnyOperand) {
  const Op op = GetParam();
  const char* s = ir::kOpSignatures[static_cast<int>(op)];
  const auto columns = grid();
  // Bit k of the mask: operand k is a constant, or with the eighth bit a parameter.
  for (int mask = 1; mask < (1 << columns.size()); ++mask) {
    for (size_t pick = 0; pick < columns[0].size(); pick += 1 + columns[0].size() / 9) {
      Builder b;
      Inputs in;
      const Value row = b.index();
      int32_t operands[3] = {ir::kNone, ir::kNone, ir::kNone};
      for (size_t k = 0; k < columns.size(); ++k) {
        const char letter = s[k + 1];
        const auto word = static_cast<int32_t>(columns[k][pick]);
        if ((mask & (1 << k)) == 0) {
          operands[k] = operand(b, letter, row);
          in.sources.push_back(columns[k]);
        } else if (letter == 'b') {
          operands[k] = b.op(Op::CONST_B, word);
        } else if (pick % 2 == 0) {
          operands[k] = b.op(letter == 'f' ? Op::CONST_F : Op::CONST_I, word);
        } else {
          operands[k] = b.op(letter == 'f' ? Op::PARAM_F : Op::PARAM_I, b.p.param_count++);
          in.parameters.push_back(static_cast<uint32_t>(word));
        }
      }
      finish(b, op, b.op(op, operands[0], operands[1], operands[2]));
      if (loses_nan_bits(op)) continue;
      const int64_t n =
          mask == (1 << columns.size()) - 1 ? 20 : static_cast<int64_t>(columns[0].size());
      ASSERT_EQ(check(b.p, n, in), "") << "mask " << mask << ", pick " << pick;
      ASSERT_EQ(check(b.p, 1, in), "") << "mask " << mask << ", pick " << pick;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Conformance, EveryOp, testing::ValuesIn(arithmetic_ops()),
                         [](const auto& test) {
                           return std::string(ir::kOpNames[static_cast<int>(test.param)]);
                         });

// x * y + z in two instructions rounds twice, even if a backend could contract it.
TEST(Contraction, AProductAndASumRoundTwice) {
  Builder b;
  const Value row = b.index();
  Value v[3];
  for (Value& value : v) value = b.load(b.source(Type::F32, 1), row);
  const Value product = b.op(Op::MUL, v[0], v[1]);
  const Value second = b.op(Op::MUL, v[1], v[0]);
  const Value third = b.op(Op::MUL, v[0], v[0]);
  b.output({b.op(Op::ADD, product, v[2])});
  b.output({b.op(Op::SUB, second, v[2])});
  b.output({b.op(Op::SUB, v[2], third)});
  b.output({b.op(Op::FMA, v[0], v[1], v[2])});
  Inputs in;
  const float x = 1.0000001f;
  for (const float value : {x, x, -1.0000002f})
    in.sources.push_back(std::vector<uint32_t>(300, bits(value)));
  for (const int64_t n : {1, 300}) {
    ASSERT_EQ(check(b.p, n, in), "");
    const Result result = run(b.p, n, in);
    ASSERT_NE(result.outputs[0][0], result.outputs[3][0])
        << "the example does not tell the two apart";
  }
}

// Products whose low half decides the rounding of the sum; an emulation in double precision gets
// some wrong.
TEST(FusedMultiplyAdd, RoundsOnceInHardCases) {
  Builder b;
  const Value row = b.index();
  Value v[3];
  for (Value& value : v) value = b.load(b.source(Type::F32, 1), row);
  b.output({b.op(Op::FMA, v[0], v[1], v[2])});
  Inputs in;
  in.sources.resize(3);
  const auto add = [&](float x, float y, float z) {
    in.sources[0].push_back(bits(x));
    in.sources[1].push_back(bits(y));
    in.sources[2].push_back(bits(z));
  };
  uint32_t state = 1;
  const auto next = [&] { return state = state * 1664525u + 1013904223u; };
  for (int k = 0; k < 20000; ++k) {
    const auto number = [&](int low, int high) {
      const float mantissa = 1.0f + static_cast<float>(next() >> 9) * 0x1p-23f;
      const int exponent =
          low + static_cast<int>((next() >> 8) % static_cast<uint32_t>(high - low + 1));
      return std::ldexp((next() >> 31) != 0 ? -mantissa : mantissa, exponent);
    };
    const float x = number(-3, 3), y = number(-3, 3);
    switch (k % 4) {
      case 0:
        add(x, y, -x * y);
        break;  // the error of the product
      case 1:
        add(x, y, number(20, 50));
        break;  // a tie broken far below
      case 2:
        add(number(-80, -70), number(-70, -60), number(-149, -126));
        break;  // denormal results
      default:
        add(1.0f + 0x1p-12f, 1.0f - 0x1p-12f,
            std::ldexp(1.0f, static_cast<int>(next() % 60u) - 50));
        break;
    }
  }
  EXPECT_EQ(check(b.p, static_cast<int64_t>(in.sources[0].size()), in), "");
}

// Tests whether a root is above a limit, and needs the root only there. A backend may decide
// without computing the root.
TEST(Limit, OfARootIsExactForEveryLimit) {
  Builder b;
  const Value x = b.load(b.source(Type::F32, 1), b.index());
  const Value limit = b.op(Op::PARAM_F, b.p.param_count++);
  const Value root = b.op(Op::SQRT, x);
  const Value above = b.op(Op::LT, limit, root);
  Value scaled = b.op(Op::MUL, x, b.op(Op::DIV, limit, root));
  for (int k = 0; k < 8; ++k)  // enough to be worth skipping
    scaled = b.op(Op::DIV, b.op(Op::ADD, scaled, root), b.op(Op::MUL, limit, scaled));
  b.output({b.op(Op::SELECT_F, above, scaled, x)});
  b.output({b.op(Op::SELECT_I, above, b.i(1), b.i(0))});
  std::vector<float> limits = {1e-18f, 0.99e-18f, 1.2e-22f, 1e-23f, 1000.0f, 1.8446743e19f, 2e19f};
  for (const uint32_t word : float_edges()) limits.push_back(std::bit_cast<float>(word));
  for (const float c : limits) {
    // Far below, so that whole groups lie there; around the limit, word by word; anything.
    Inputs in;
    in.parameters = {bits(c)};
    std::vector<uint32_t>& words = in.sources.emplace_back();
    for (int k = 0; k < 64; ++k) words.push_back(bits(c * c * 0.25f));
    for (const float factor : {1.0f, 0.999f, 1.001f})
      for (int k = -40; k <= 40; ++k)
        words.push_back(bits(c * c * factor) + static_cast<uint32_t>(k));
    words.insert(words.end(), float_edges().begin(), float_edges().end());
    ASSERT_EQ(check(b.p, static_cast<int64_t>(words.size()), in), "") << "limit " << c;
    for (const uint32_t word : {words[64], words[104], words[105], words[120]}) {
      Inputs one = in;
      one.sources[0] = {word};
      ASSERT_EQ(check(b.p, 1, one), "") << "limit " << c;
    }
  }
}

#if defined(__x86_64__)
// A caller with flush-to-zero and another rounding gets the same bits, and its mode back.
TEST(FloatMode, TheCallersModeNeitherChangesResultsNorIsChanged) {
  Builder b;
  const Value x = b.load(b.source(Type::F32, 1), b.index());
  b.output({b.op(Op::MUL, x, b.f(0.5f)), b.op(Op::ADD, x, b.f(1.0f)), b.op(Op::DIV, x, b.f(3.0f))});
  const Module module(b.p);
  for (const int64_t n : {1, 3, 100, 9000}) {
    Inputs in;
    in.sources = {std::vector<uint32_t>(static_cast<size_t>(n), bits(1e-40f))};
    const auto expected = reference(b.p, n, in);
    const uint32_t before = _mm_getcsr();
    _mm_setcsr(before | 0x8040u | 0x6000u);  // flush to zero, denormals are zero, truncate
    const uint32_t odd = _mm_getcsr();
    const Result result = run(module, b.p, n, in);
    const uint32_t after = _mm_getcsr();
    _mm_setcsr(before);
    EXPECT_EQ(after & 0xFFC0u, odd & 0xFFC0u);
    EXPECT_EQ(difference(b.p, expected, result.outputs), "") << n;
  }
}
#endif

}  // namespace
}  // namespace conformance
