// Random Programs with every operation, access and loop kind. The backend and the reference give
// the same bits, for few and many rows, and with 1, 2 and 7 threads.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "harness.h"
#include "novaphy/core/parallel.h"
#include "novaphy/program/cut.h"

namespace conformance {
namespace {

using ir::Op;
using ir::Type;
using ir::Value;

class Generator {
 public:
  explicit Generator(uint32_t seed) : random_(seed) {}

  int32_t below(int32_t n) { return static_cast<int32_t>(random_() % static_cast<uint32_t>(n)); }
  bool chance(int percent) { return below(100) < percent; }

  float number() {
    static const float edges[] = {0.0f,    -0.0f, 1.0f,     -1.0f,     0.5f, 1e-40f,
                                  -1e-40f, 3e38f, INFINITY, -INFINITY, NAN};
    if (chance(15)) return edges[below(11)];
    return std::uniform_real_distribution<float>(-4.0f, 4.0f)(random_);
  }

  ir::Program program(bool with_loops) {
    Builder b;
    b_ = &b;
    b.p.param_count = 4;  // 0, 1 float; 2 int; 3 the extent of fixed loops
    sources_ = {b.source(Type::F32, 3),
                b.source(Type::F32, 7),
                b.source(Type::I32, 2),
                b.source(Type::F32, 3, ir::Access::Indexed),
                b.source(Type::I32, 1, ir::Access::Uniform),
                b.source(Type::F32, 4, ir::Access::Uniform)};
    leaves();
    ops(30);
    if (with_loops) {
      loop(chance(50) ? ir::LoopKind::Fixed : ir::LoopKind::Csr);
      ops(10);
      loop(chance(50) ? ir::LoopKind::Fixed : ir::LoopKind::Csr);
      ops(10);
    }
    b.output({pick(Type::F32), pick(Type::F32), pick(Type::F32)});
    b.output({pick(Type::I32)});
    b.output({pick(Type::F32), pick(Type::F32), pick(Type::F32), pick(Type::F32), pick(Type::F32)});
    b.output({pick(Type::I32), pick(Type::I32)});
    return b.p;
  }

  Inputs inputs(const ir::Program& p, int64_t n) {
    Inputs in;
    const int64_t rows[] = {n, n, n, 37, 1, 5};
    for (size_t s = 0; s < p.sources.size(); ++s) {
      std::vector<uint32_t> words;
      for (int64_t k = 0; k < rows[s] * p.sources[s].width; ++k) {
        words.push_back(p.sources[s].type == Type::F32 ? bits(number()) : bits(below(39) - 2));
      }
      in.sources.push_back(std::move(words));
    }
    for (const ir::Loop& l : p.loops) {
      if (l.kind != ir::LoopKind::Csr) continue;
      std::vector<uint32_t> offsets = {0}, items;
      for (int64_t i = 0; i < n; ++i) {
        const int32_t length = chance(30) ? 0 : below(6);
        for (int32_t k = 0; k < length; ++k) items.push_back(bits(below(38) - 1));
        offsets.push_back(static_cast<uint32_t>(items.size()));
      }
      in.offsets.push_back(std::move(offsets));
      in.items.push_back(std::move(items));
    }
    in.parameters = {bits(number()), bits(number()), bits(below(100) - 50), bits(below(4))};
    return in;
  }

 private:
  Value keep(Value v) {
    values_[static_cast<size_t>(ir::result_type(b_->p.instrs[static_cast<size_t>(v)].op))]
        .push_back(v);
    return v;
  }
  // Recent values more often, so that chains and dead registers both appear.
  Value pick(Type t) {
    const auto& list = values_[static_cast<size_t>(t)];
    const auto size = static_cast<int32_t>(list.size());
    const int32_t k = chance(60) ? size - 1 - below(std::min(size, 6)) : below(size);
    return list[static_cast<size_t>(k)];
  }
  // A row that lies inside the 37 rows of the gathered source.
  Value row() {
    const Value limit = b_->i(37);
    const Value r = b_->op(Op::IMOD, pick(Type::I32), limit);
    return chance(50) ? r : b_->op(Op::IMAX, r, b_->i(0));
  }

  void leaves() {
    for (auto& list : values_) list.clear();
    const Value index = keep(b_->index());
    keep(b_->f(number()));
    keep(b_->i(below(1000) - 500));
    keep(b_->op(Op::CONST_B, below(2)));
    keep(b_->op(Op::PARAM_F, 0));
    keep(b_->op(Op::PARAM_F, 1));
    keep(b_->op(Op::PARAM_I, 2));
    for (int c = 0; c < 3; ++c) keep(b_->load(sources_[0], index, c));
    for (int c = 6; c >= 1; --c) keep(b_->load(sources_[1], index, c));
    for (int c = 0; c < 2; ++c) keep(b_->load(sources_[2], index, c));
    const Value zero = b_->i(0);
    keep(b_->load(sources_[4], zero));
    for (int c = 0; c < 4; ++c) keep(b_->load(sources_[5], zero, c));
    keep(b_->op(Op::LT, pick(Type::F32), pick(Type::F32)));
  }

  void ops(int count) {
    for (int k = 0; k < count; ++k) {
      if (chance(8)) {
        const Value r = row();
        for (int c = 0; c < 3; ++c) keep(b_->load(sources_[3], r, c));
        continue;
      }
      const auto op =
          static_cast<Op>(static_cast<int>(Op::ADD) +
                          below(static_cast<int>(Op::PARTIAL) - static_cast<int>(Op::ADD)));
      const char* s = ir::kOpSignatures[static_cast<int>(op)];
      int32_t operands[3] = {ir::kNone, ir::kNone, ir::kNone};
      for (int o = 0; o < 3; ++o) {
        if (s[o + 1] == 'f') operands[o] = pick(Type::F32);
        if (s[o + 1] == 'i') operands[o] = pick(Type::I32);
        if (s[o + 1] == 'b') operands[o] = pick(Type::Bool);
      }
      // The bits of a NaN are not part of the contract.
      if (op == Op::F_BITS) {
        const Value ordered = b_->op(Op::EQ, operands[0], operands[0]);
        operands[0] = b_->op(Op::SELECT_F, ordered, operands[0], b_->f(1.0f));
      }
      keep(b_->op(op, operands[0], operands[1], operands[2]));
    }
  }

  void loop(ir::LoopKind kind) {
    const auto l = static_cast<int32_t>(b_->p.loops.size());
    const auto outside = values_;
    b_->p.loops.push_back({kind, 3, {}});
    const Value inits[2] = {pick(Type::F32), pick(Type::F32)};
    keep(b_->op(Op::REDUCE_INDEX, l));
    const Value zero = b_->i(0);
    if (kind == ir::LoopKind::Csr) {
      const Value slot = keep(b_->op(Op::SLOT, l));
      const Value near = b_->op(Op::IMIN, slot, b_->i(36));
      for (int c = 0; c < 3; ++c) keep(b_->load(sources_[3], near, c));
    } else {
      const Value r = b_->op(Op::REDUCE_INDEX, l);
      for (int c = 0; c < 4; ++c) keep(b_->load(sources_[5], chance(50) ? r : zero, c));
    }
    ops(20);
    for (const Value init : inits) b_->p.loops.back().sums.push_back({init, pick(Type::F32)});
    values_ = outside;
    for (int32_t s = 0; s < 2; ++s) keep(b_->op(Op::SUM, l, s));
  }

  std::mt19937 random_;
  Builder* b_ = nullptr;
  std::vector<int32_t> sources_;
  std::array<std::vector<Value>, 3> values_;
};

class RandomPrograms : public testing::TestWithParam<bool> {};

TEST_P(RandomPrograms, GiveTheBitsOfTheReferenceForFewAndManyRows) {
  for (uint32_t seed = 1; seed <= 150; ++seed) {
    Generator g(seed);
    const ir::Program p = g.program(GetParam());
    ASSERT_EQ(ir::validate(p), "") << "seed " << seed;
    for (const int64_t n :
         {int64_t{1}, int64_t{3}, int64_t{5}, int64_t{17}, int64_t{256}, int64_t{1000}}) {
      if (n == 1000 && seed % 10 != 0) continue;
      const Inputs in = g.inputs(p, n);
      ASSERT_EQ(check(p, n, in), "") << "seed " << seed << ", n " << n << "\n" << ir::to_string(p);
    }
  }
}

TEST_P(RandomPrograms, GiveTheSameBitsForEveryNumberOfThreads) {
  const int before = novaphy::num_threads();
  for (uint32_t seed = 1001; seed <= 1005; ++seed) {
    Generator g(seed);
    const ir::Program p = g.program(GetParam());
    const Inputs in = g.inputs(p, 20011);
    novaphy::set_num_threads(1);
    const Result expected = run(p, 20011, in);
    ASSERT_EQ(expected.status, NOVAPHY_OK) << expected.message;
    for (const int threads : {2, 7}) {
      novaphy::set_num_threads(threads);
      ASSERT_EQ(run(p, 20011, in).outputs, expected.outputs)
          << "seed " << seed << ", " << threads << " threads";
    }
  }
  novaphy::set_num_threads(before);
}

TEST_P(RandomPrograms, GiveTheSameBitsRowByRowAsTogether) {
  for (uint32_t seed = 2001; seed <= 2010; ++seed) {
    Generator g(seed);
    const ir::Program p = g.program(GetParam());
    const Inputs in = g.inputs(p, 4);
    const Result few = run(p, 4, in);  // short path
    // `many` begins with the four rows of `in`, and further rows repeat them.
    Inputs many = in;
    for (size_t s = 0; s < 3; ++s) {
      for (int k = 0; k < 99; ++k)
        many.sources[s].insert(many.sources[s].end(), in.sources[s].begin(), in.sources[s].end());
    }
    for (size_t l = 0; l < in.offsets.size(); ++l) {
      for (int k = 1; k < 100; ++k) {
        const uint32_t base = many.offsets[l].back();
        for (size_t r = 1; r < in.offsets[l].size(); ++r)
          many.offsets[l].push_back(base + in.offsets[l][r]);
        many.items[l].insert(many.items[l].end(), in.items[l].begin(), in.items[l].end());
      }
    }
    Result all = run(p, 400, many);
    for (size_t o = 0; o < all.outputs.size(); ++o) all.outputs[o].resize(few.outputs[o].size());
    // Rows whose value contains the row number differ only past the first four.
    ASSERT_EQ(difference(p, few.outputs, all.outputs), "") << "seed " << seed;
  }
}

// The first half computes the parts that need no late source, the second half the rest.
TEST_P(RandomPrograms, GiveTheSameBitsInTwoHalves) {
  constexpr int64_t kRows = 17;
  int halves = 0;
  for (uint32_t seed = 3001; seed <= 3040; ++seed) {
    Generator g(seed);
    const ir::Program p = g.program(GetParam());
    Inputs in = g.inputs(p, kRows);
    const auto expected = reference(p, kRows, in);
    std::vector<ir::Available> sources(p.sources.size());
    for (ir::Available& source : sources)
      source = g.chance(40)   ? ir::Available::Late
               : g.chance(50) ? ir::Available::Early
                              : ir::Available::Both;
    const ir::Cut cut = ir::cut(p, sources);
    ASSERT_EQ(ir::validate(cut.late), "") << "seed " << seed;
    for (const ir::Instr& instr : cut.early.instrs) {
      if (instr.op != Op::LOAD_F && instr.op != Op::LOAD_I) continue;
      EXPECT_NE(sources[static_cast<size_t>(instr.a)], ir::Available::Late) << "seed " << seed;
    }
    for (const ir::Output& output : cut.early.outputs)
      for (const ir::Value v : output.values) {
        const ir::Instr& instr = cut.early.instrs[static_cast<size_t>(v)];
        if (instr.op != Op::LOAD_F && instr.op != Op::LOAD_I) continue;
        if (cut.early.instrs[static_cast<size_t>(instr.b)].op != Op::INDEX) continue;
        EXPECT_NE(sources[static_cast<size_t>(instr.a)], ir::Available::Both) << "seed " << seed;
      }
    if (!cut.early.outputs.empty()) {
      ++halves;
      ASSERT_EQ(ir::validate(cut.early), "") << "seed " << seed;
      Inputs early = in;
      early.offsets.clear();
      early.items.clear();
      Result first = run(cut.early, kRows, early);
      ASSERT_EQ(first.status, NOVAPHY_OK) << first.message;
      for (std::vector<uint32_t>& words : first.outputs) in.sources.push_back(std::move(words));
    }
    const Result rest = run(cut.late, kRows, in);
    ASSERT_EQ(rest.status, NOVAPHY_OK) << rest.message;
    ASSERT_EQ(difference(p, expected, rest.outputs), "") << "seed " << seed << "\n"
                                                         << ir::to_string(p);
  }
  EXPECT_GT(halves, 30);
}

INSTANTIATE_TEST_SUITE_P(Conformance, RandomPrograms, testing::Bool(),
                         [](const auto& test) { return test.param ? "WithLoops" : "Straight"; });

}  // namespace
}  // namespace conformance
