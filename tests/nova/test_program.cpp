// Programs as data: serialization, validation, the canonical hash, and the schedule with skippable
// regions.
#include <optional>

#include "novaphy/core/parallel.h"
#include "random_kernel.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;
using nova::make_reduce_kernel;
using nova::ir::Op;
using nova::ir::Program;
using nova::ir::Value;

// A small valid Program with every kind of part: sources, outputs, loops of both kinds, parameters.
Program sample() {
  Program p;
  p.name = "sample";
  p.sources = {{"x", ir::Type::F32, 2, ir::Access::Direct},
               {"t", ir::Type::I32, 1, ir::Access::Indexed}};
  p.param_count = 2;
  p.instrs = {{Op::INDEX},
              {Op::LOAD_F, 0, 0, 1},
              {Op::CONST_F, 0x3F800000},
              {Op::REDUCE_INDEX, 0},
              {Op::I_TO_F, 3},
              {Op::MUL, 1, 4},
              {Op::SUM, 0, 0},
              {Op::SLOT, 1},
              {Op::LOAD_I, 1, 7, 0},
              {Op::I_TO_F, 8},
              {Op::SUM, 1, 0},
              {Op::ADD, 6, 10},
              {Op::PARAM_F, 0},
              {Op::LT, 11, 12},
              {Op::CONST_B, 1},
              {Op::AND, 13, 14},
              {Op::SELECT_F, 15, 11, 2}};
  p.loops = {{ir::LoopKind::Fixed, 1, {{2, 5}}}, {ir::LoopKind::Csr, 0, {{6, 9}}}};
  p.outputs = {{"y", ir::Type::F32, {16, 11}, 0}, {"k", ir::Type::I32, {0}}};
  p.sources[1].varies = true;
  p.primal = 0x0123456789ABCDEFu;
  return p;
}

std::string refusal(const Program& p) {
  Program read;
  std::string reason;
  const bool ok = ir::deserialize(ir::serialize(p), read, reason);
  EXPECT_EQ(ok, ir::validate(p).empty());
  return ok ? "" : reason;
}
// The reason why the sample is refused after a change.
template <class Change>
std::string refused(Change change) {
  Program p = sample();
  change(p);
  return refusal(p);
}

bool equal(const Program& a, const Program& b) { return ir::serialize(a) == ir::serialize(b); }

TEST(ProgramForm, ComesBackFromItsWords) {
  std::vector<Program> programs = {sample()};
  for (const SumKind kind : {SumKind::None, SumKind::Fixed, SumKind::Csr})
    for (uint32_t seed = 100; seed < 110; ++seed) {
      const Kernel kernel = RandomKernel(seed).make(kind);
      programs.push_back(kernel.program());
      const size_t n = kernel.sources().size();
      nova::AdjointMask mask{
          std::vector<bool>(n, false), std::vector<bool>(n, seed % 2 == 0), {true, true}};
      for (size_t s = 0; s < n; ++s) mask.wrt[s] = kernel.sources()[s].dtype == DType::F32;
      const nova::AdjointPlan& plan = kernel.adjoint(mask);
      for (const auto* stages : {&plan.rows, &plan.items})
        for (const auto& stage : *stages) programs.push_back(stage.program);
    }
  for (const Program& p : programs) {
    EXPECT_EQ(ir::validate(p), "");
    Program read;
    std::string reason;
    ASSERT_TRUE(ir::deserialize(ir::serialize(p), read, reason)) << reason;
    EXPECT_TRUE(equal(p, read));
    EXPECT_EQ(ir::hash(p), ir::hash(read));
    EXPECT_EQ(ir::to_string(p), ir::to_string(read));
  }
  EXPECT_GT(programs.size(), 60u);
}

TEST(ProgramForm, NamesOfAnyLengthSurvive) {
  for (const std::string& name : {std::string(), std::string("a"), std::string("four"),
                                  std::string("f\xC3\xBCnf!"), std::string(1000, 'n')}) {
    Program p = sample();
    p.name = p.sources[0].name = p.outputs[1].name = name;
    Program read;
    std::string reason;
    ASSERT_TRUE(ir::deserialize(ir::serialize(p), read, reason)) << reason;
    EXPECT_EQ(read.name, name);
    EXPECT_EQ(read.sources[0].name, name);
    EXPECT_EQ(read.outputs[1].name, name);
  }
}

// Names are for people. The values that launches pass on are in fields, and therefore in the hash.
TEST(ProgramForm, NoNameHasAMeaning) {
  const auto hash_after = [](auto change) {
    Program p = sample();
    change(p);
    return ir::hash(p);
  };
  const uint64_t hash = ir::hash(sample());
  EXPECT_EQ(hash_after([](Program& p) {
              p.name = "x.adjoint";
              p.sources[0].name = p.outputs[1].name = "grad_x";
            }),
            hash);
  EXPECT_NE(hash_after([](Program& p) { p.outputs[0].carried = ir::kNone; }), hash);
  EXPECT_NE(hash_after([](Program& p) { p.sources[1].varies = false; }), hash);
  EXPECT_NE(hash_after([](Program& p) { p.primal ^= uint64_t{1} << 40; }), hash);
}

// The specification of a kernel's outputs enters its Program, and the adjoint of the Program.
TEST(ProgramForm, CarriedOutputsAndTheirGradients) {
  const auto make = [](const nova::OutputSpec& q) {
    return make_kernel("step",
                       {{"a", DType::F32, 1, ir::Access::Direct},
                        {"q", DType::F32, 1, ir::Access::Direct},
                        {"i", DType::I32, 1, ir::Access::Direct}},
                       {q}, [](nova::TraceContext& c) { return std::vector{c.f32(0) * c.f32(1)}; });
  };
  const Kernel kernel = make({"next", 1, "q"});
  EXPECT_EQ(kernel.program().outputs[0].carried, 1);
  EXPECT_EQ(make({"q", 1}).program().outputs[0].carried, ir::kNone);
  const auto adjoint = [&](std::vector<bool> wrt) {
    return kernel.adjoint({std::move(wrt), {false, false, false}, {true}}).rows.at(0);
  };
  // The launch before reads the gradient of q as that of its output.
  const nova::AdjointStage state = adjoint({false, true, false});
  ASSERT_EQ(state.program.outputs.size(), 1u);
  const int32_t seed = state.program.outputs[0].carried;
  ASSERT_GE(seed, 3);
  EXPECT_EQ(state.sources[static_cast<size_t>(seed)].kind,
            nova::AdjointBinding::Kind::OutputGradient);
  EXPECT_TRUE(state.program.sources[1].varies);
  EXPECT_FALSE(state.program.sources[0].varies);
  EXPECT_EQ(state.program.primal, kernel.hash());
  // The gradient of a is not carried.
  const nova::AdjointStage all = adjoint({true, true, false});
  EXPECT_EQ(all.program.outputs[0].carried, ir::kNone);
  EXPECT_EQ(all.program.primal, 0u);
  EXPECT_ERROR(make({"next", 1, "p"}), ErrorKind::Value, "carried_to is 'p'");
  EXPECT_ERROR(make({"next", 1, "i"}), ErrorKind::Value, "a float32 source of width 1");
}

TEST(ProgramForm, IsRefusedWhenCutAnywhereOrWithMoreBehindIt) {
  std::vector<uint32_t> words = ir::serialize(sample());
  Program read;
  std::string reason;
  for (size_t n = 0; n < words.size(); ++n) {
    std::vector<uint32_t> cut(words.begin(), words.begin() + static_cast<std::ptrdiff_t>(n));
    EXPECT_FALSE(ir::deserialize(cut, read, reason)) << n;
    if (n <= NOVAPHY_PROGRAM_HEADER_WORD_COUNT) continue;
    cut[NOVAPHY_PROGRAM_HEADER_WORD_COUNT] = static_cast<uint32_t>(n);
    EXPECT_FALSE(ir::deserialize(cut, read, reason)) << n;
    EXPECT_NE(reason.find("not a valid Program"), std::string::npos);
  }
  words.push_back(0);
  EXPECT_FALSE(ir::deserialize(words, read, reason));
  ++words[NOVAPHY_PROGRAM_HEADER_WORD_COUNT];
  EXPECT_FALSE(ir::deserialize(words, read, reason));
}

TEST(ProgramForm, ADamagedWordIsRefusedOrGivesAnotherValidProgram) {
  const std::vector<uint32_t> words = ir::serialize(sample());
  const uint32_t values[] = {0,   1,    2,          3,           5,           17,         255,
                             256, 4097, 0x7FFFFFFF, 0x80000000u, 0xFFFFFFFEu, 0xFFFFFFFFu};
  int refused_words = 0;
  for (size_t at = 0; at < words.size(); ++at)
    for (const uint32_t value : values) {
      std::vector<uint32_t> damaged = words;
      damaged[at] = value;
      Program read = sample();
      std::string reason;
      if (ir::deserialize(damaged, read, reason)) {
        EXPECT_EQ(ir::validate(read), "") << "word " << at << " = " << value;
        EXPECT_EQ(ir::serialize(read).size(), words.size());
        ir::schedule(read);
      } else {
        EXPECT_TRUE(equal(read, sample())) << "a refused Program was written";
        ++refused_words;
      }
    }
  EXPECT_GT(refused_words, 400);
}

TEST(ProgramForm, EveryRuleOfTheFormatIsChecked) {
  EXPECT_EQ(refused([](Program&) {}), "");
  const auto has = [](const std::string& reason, const char* text) {
    return reason.find(text) != std::string::npos;
  };
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[5].b = 5; }), "value 5: operand 5"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[5].b = 16; }), "value 5: operand 16"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[5].b = -1; }), "value 5: operand -1"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[5].b = 3; }), "wrong type"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[15].a = 2; }), "wrong type"));
  EXPECT_TRUE(
      has(refused([](Program& p) { p.instrs[5].op = static_cast<Op>(200); }), "unknown op"));
  EXPECT_TRUE(has(refused([](Program& p) {
                    p.instrs[5] = {Op::DETACH, 1};
                  }),
                  "DETACH outside of tracing"));
  EXPECT_TRUE(has(refused([](Program& p) {
                    p.instrs[5] = {Op::PARTIAL, 1, 1, 1};
                  }),
                  "PARTIAL outside of tracing"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[1].a = 2; }), "source 2 of 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[1].c = 2; }), "column 2 of 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[1] = {Op::LOAD_F, 1, 0, 0}; }), "value 1"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[12].a = 2; }), "parameter 2 of 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[12].a = -1; }), "parameter -1"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[6].b = 1; }), "sum 1 of 1"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[6].a = 2; }), "loop 2 of 2"));
  EXPECT_TRUE(
      has(refused([](Program& p) { p.instrs[7].a = 0; }), "SLOT of a loop that is not CSR"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[14].a = 2; }), "bool constant 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.sources[0].width = 0; }), "width 0"));
  EXPECT_TRUE(has(refused([](Program& p) { p.sources[0].type = ir::Type::Bool; }), "source 'x'"));
  EXPECT_TRUE(has(refused([](Program& p) {
                    p.sources.push_back({"z", static_cast<ir::Type>(3), 1, ir::Access::Direct});
                  }),
                  "source 'z'"));
  EXPECT_TRUE(
      has(refused([](Program& p) { p.sources[0].access = static_cast<ir::Access>(5); }), "access"));
  EXPECT_TRUE(has(refused([](Program& p) { p.param_count = -1; }), "parameter count"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].extent_param = 2; }), "extent parameter 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].kind = static_cast<ir::LoopKind>(2); }),
                  "loop kind"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].term = 17; }), "loop sum operand"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].init = 0; }), "loop sum operand"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs.clear(); }), "no outputs"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].values.clear(); }), "no columns"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].values[0] = 17; }), "value 17"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].type = ir::Type::I32; }), "output 'y'"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[1] = {"k", ir::Type::Bool, {13}}; }), "bool"));
  EXPECT_TRUE(
      has(refused([](Program& p) { p.outputs[0].carried = 2; }), "carried to source 2 of 2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].carried = -2; }), "carried to source -2"));
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].carried = 1; }), "carried to source 't'"));
  EXPECT_TRUE(
      has(refused([](Program& p) { p.sources[0].varies = true; }), "carried to source 'x'"));
  EXPECT_TRUE(has(refused([](Program& p) {
                    p.outputs[1] = {"again", ir::Type::F32, {11, 16}, 0};
                  }),
                  "output 'again': cannot be carried"));
  // The steps of a loop stay in the loop.
  EXPECT_TRUE(has(refused([](Program& p) { p.outputs[0].values[0] = 5; }), "inside a loop"));
  EXPECT_TRUE(has(refused([](Program& p) { p.instrs[11].a = 5; }), "leaves its loop"));
  EXPECT_TRUE(has(refused([](Program& p) {
                    p.instrs[16].b = 5;
                    p.instrs[16].c = 9;
                  }),
                  "leaves its loop"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].init = 4; }), "initial value"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].init = 10; }), "initial value"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].term = 9; }), "term"));
  EXPECT_TRUE(has(refused([](Program& p) { p.loops[0].sums[0].term = 10; }), "term"));
}

TEST(ProgramForm, ABackendRefusesABrokenProgramWithItsReason) {
  Program p = sample();
  p.instrs[5].b = 16;
  const DeviceContext& context = device_context(Device::cpu());
  const std::vector<uint32_t> words = ir::serialize(p);
  novaphy_module* module = nullptr;
  novaphy_error error = make_error();
  EXPECT_NE(context.api->module_create(context.device, NOVAPHY_CODE_PROGRAM, words.data(),
                                       words.size() * 4, &module, &error),
            NOVAPHY_OK);
  EXPECT_NE(std::string(error.message).find("operand 16"), std::string::npos) << error.message;
}

// ---- the hash ----

TEST(ProgramHash, DoesNotDependOnTheOrderInWhichSubexpressionsAreTraced) {
  const std::vector<nova::SourceSpec> sources = {{"a", DType::F32, 2, Access::Direct},
                                                 {"b", DType::F32, 1, Access::Uniform}};
  const Kernel first = make_kernel("first", sources, {{"y", 2}}, [](TraceContext& c) {
    const Real left = sqrt(c.f32(0, 0)) * Real(2.0f);
    const Real right = c.f32(1) / (c.f32(0, 1) + Real(1.0f));
    return std::vector{left + right, right};
  });
  const Kernel second = make_kernel("second", sources, {{"y", 2}}, [](TraceContext& c) {
    const Real unused = c.f32(0, 1) * Real(77.0f);
    const Real one = 1.0f;
    const Real right = c.f32(1) / (c.f32(0, 1) + one);
    const Real two = 2.0f;
    const Real left = sqrt(c.f32(0, 0)) * two;
    (void)unused;
    return std::vector{left + right, right};
  });
  EXPECT_EQ(first.hash(), second.hash());
  EXPECT_EQ(first.program().instrs, second.program().instrs);
}

TEST(ProgramHash, DoesNotDependOnTheOrderOfTheFunctionsOfASum) {
  const std::vector<nova::SourceSpec> sources = {{"x", DType::F32, 1, Access::Direct},
                                                 {"r", DType::F32, 2, Access::Reduced}};
  const auto make = [&](bool swapped) {
    return make_reduce_kernel("sum", sources, {{"y", 2}},
                              {.init =
                                   [](TraceContext& c) {
                                     return std::vector{c.f32(0), Real(0.0f)};
                                   },
                               .body =
                                   [swapped](TraceContext& c) {
                                     Real a, b;
                                     if (swapped) {
                                       b = c.f32(1, 1) * c.f32(0);
                                       a = c.f32(1, 0) - c.f32(0);
                                     } else {
                                       a = c.f32(1, 0) - c.f32(0);
                                       b = c.f32(1, 1) * c.f32(0);
                                     }
                                     return std::vector{a, b};
                                   },
                               .epilogue =
                                   [](TraceContext&, std::span<const Real> s) {
                                     return std::vector{s[0] * s[1], s[1]};
                                   }});
  };
  EXPECT_EQ(make(false).hash(), make(true).hash());
}

TEST(ProgramHash, ChangesWithEverythingThatChangesTheResult) {
  const uint64_t before = ir::hash(sample());
  const auto changed = [&](auto change) {
    Program p = sample();
    change(p);
    return ir::hash(p) != before;
  };
  EXPECT_TRUE(changed([](Program& p) { p.instrs[2].a = 0x3F800001; }));
  EXPECT_TRUE(changed([](Program& p) { p.instrs[2].a = static_cast<int32_t>(0xBF800000); }));
  EXPECT_TRUE(changed([](Program& p) { p.instrs[11].op = Op::SUB; }));
  EXPECT_TRUE(changed([](Program& p) { std::swap(p.instrs[11].a, p.instrs[11].b); }));
  EXPECT_TRUE(changed([](Program& p) { p.sources[0].width = 3; }));
  EXPECT_TRUE(changed([](Program& p) { p.sources[0].access = ir::Access::Uniform; }));
  EXPECT_TRUE(changed([](Program& p) { p.outputs[0].values.pop_back(); }));
  EXPECT_TRUE(changed([](Program& p) { p.loops[0].extent_param = 0; }));
  EXPECT_TRUE(changed([](Program& p) { p.param_count = 3; }));
  EXPECT_TRUE(changed([](Program& p) { p.contract = true; }));
  EXPECT_FALSE(
      changed([](Program& p) { p.name = p.sources[0].name = p.outputs[0].name = "other"; }));
}

TEST(ProgramHash, IsOneForAnyNumberOfItems) {
  const auto make = [] {
    return make_reduce_kernel(
        "shapes", {{"x", DType::F32, 1, Access::Direct}, {"r", DType::F32, 1, Access::Reduced}},
        {{"y", 1}},
        {.init = [](TraceContext& c) { return std::vector{c.f32(0)}; },
         .body = [](TraceContext& c) { return std::vector{c.f32(1) * c.f32(0)}; },
         .epilogue = {}});
  };
  const Kernel kernel = make();
  EXPECT_EQ(kernel.hash(), make().hash());
  Random random(1);
  const Tensor x = random.leaf({3});
  for (const int32_t shapes : {0, 1, 2, 50}) {
    const Tensor r = random.leaf({shapes});
    const auto y = kernel(3, {x, r}, {.extent = shapes})[0].to_host();
    for (size_t i = 0; i < 3; ++i) {
      float expected = x.to_host()[i];
      for (const float s : r.to_host()) expected = expected + s * x.to_host()[i];
      EXPECT_EQ(y[i], expected) << shapes;
    }
  }
}

TEST(ProgramCanonical, IsAFixedPointWithoutTracingMarks) {
  for (uint32_t seed = 200; seed < 230; ++seed) {
    const Kernel kernel = RandomKernel(seed).make(static_cast<SumKind>(seed % 3));
    EXPECT_TRUE(equal(ir::canonicalise(kernel.program(), true), kernel.program()));
    EXPECT_TRUE(equal(ir::canonicalise(kernel.traced(), true), kernel.program()));
    EXPECT_EQ(ir::validate(kernel.traced(), true), "");
  }
}

// ---- the schedule ----

// Runs a Program for one lane, in plain order or by its schedule, with every step a folded
// constant. A step must not use a value that was skipped, except that a select may hold one on the
// side that it does not take.
class Lane {
 public:
  Lane(const Program& program, const Call& call, int64_t row)
      : p_(program), call_(call), row_(row), section_(ir::sections(program)) {
    values_.resize(p_.instrs.size());
    sums_.resize(p_.loops.size());
    for (const Tensor& t : call.inputs) {
      const Tensor bits(t.range(), {t.size()}, DType::I32);
      sources_.push_back(bits.to_host_i32());
    }
    if (call.csr) {
      offsets_ = words(call.csr->offsets);
      items_ = words(call.csr->items);
    }
  }

  std::vector<int32_t> run_plain() {
    for (int32_t s = 0; s <= 2 * static_cast<int32_t>(p_.loops.size()); ++s) {
      const auto all = [&] {
        for (size_t v = 0; v < values_.size(); ++v)
          if (section_[v] == s) compute(static_cast<Value>(v));
      };
      if (s % 2 == 0) {
        all();
      } else {
        loop(static_cast<size_t>(s / 2), all);
      }
    }
    return outputs();
  }

  std::vector<int32_t> run_schedule(const std::vector<ir::Step>& steps) {
    run_steps(steps, 0, steps.size());
    return outputs();
  }
  int skipped() const { return skipped_; }

 private:
  static std::vector<int32_t> words(const std::shared_ptr<Range>& range) {
    return Tensor(range, {static_cast<int64_t>(range->bytes() / 4)}, DType::I32).to_host_i32();
  }

  void run_steps(const std::vector<ir::Step>& steps, size_t first, size_t last) {
    for (size_t k = first; k < last; ++k) {
      const ir::Step& step = steps[k];
      switch (step.kind) {
        case ir::Step::Kind::Compute:
          compute(step.value);
          break;
        case ir::Step::Kind::SkipIfNone:
          if ((need(step.value) != 0) != step.polarity) {
            ++skipped_;
            k = static_cast<size_t>(step.target) - 1;
          }
          break;
        case ir::Step::Kind::LoopBegin: {
          size_t end = k;
          while (steps[end].kind != ir::Step::Kind::LoopEnd) ++end;
          loop(static_cast<size_t>(step.value), [&] { run_steps(steps, k + 1, end); });
          k = end;
          break;
        }
        case ir::Step::Kind::LoopEnd:
          break;
      }
    }
  }

  template <class Body>
  void loop(size_t l, const Body& body) {
    const ir::Loop& of = p_.loops[l];
    for (const ir::Sum& s : of.sums) sums_[l].push_back(need(s.init));
    const auto row = static_cast<size_t>(row_);
    const bool csr = of.kind == ir::LoopKind::Csr;
    const int32_t begin = csr ? offsets_[row] : 0,
                  count = csr ? offsets_[row + 1] - begin : call_.extent;
    for (counter_ = 0; counter_ < count; ++counter_) {
      if (csr) slot_ = items_[static_cast<size_t>(begin + counter_)];
      for (size_t v = 0; v < values_.size(); ++v)
        if (section_[v] == static_cast<int32_t>(2 * l + 1)) values_[v].reset();
      body();
      for (size_t s = 0; s < of.sums.size(); ++s)
        sums_[l][s] = fold({Op::ADD}, {sums_[l][s], need(of.sums[s].term)});
    }
  }

  int32_t need(Value v) {
    const auto& value = values_[static_cast<size_t>(v)];
    EXPECT_TRUE(value.has_value()) << "value " << v << " is used but was skipped";
    return value.value_or(0);
  }

  int32_t fold(ir::Instr in, const std::vector<int32_t>& operands) {
    nova::Trace trace("lane");
    int32_t* slots[] = {&in.a, &in.b, &in.c};
    const char* s = ir::kOpSignatures[static_cast<int>(in.op)];
    for (size_t k = 0; k < operands.size(); ++k) {
      const Op constant = s[k + 1] == 'f'   ? Op::CONST_F
                          : s[k + 1] == 'i' ? Op::CONST_I
                                            : Op::CONST_B;
      *slots[k] = trace.emit({constant, operands[k]});
    }
    return trace.program().instrs[static_cast<size_t>(trace.emit(in))].a;
  }

  void compute(Value v) {
    const ir::Instr& in = p_.instrs[static_cast<size_t>(v)];
    values_[static_cast<size_t>(v)] = result(in);
  }
  int32_t result(const ir::Instr& in) {
    switch (in.op) {
      case Op::CONST_F:
      case Op::CONST_I:
      case Op::CONST_B:
        return in.a;
      case Op::INDEX:
        return static_cast<int32_t>(row_);
      case Op::REDUCE_INDEX:
        return counter_;
      case Op::SLOT:
        return slot_;
      case Op::SUM:
        return sums_[static_cast<size_t>(in.a)][static_cast<size_t>(in.b)];
      case Op::SELECT_F:
      case Op::SELECT_I:
      case Op::SELECT_B:
        return need(need(in.a) != 0 ? in.b : in.c);
      case Op::LOAD_F:
      case Op::LOAD_I: {
        const int32_t row = need(in.b), width = p_.sources[static_cast<size_t>(in.a)].width;
        return row < 0 ? 0
                       : sources_[static_cast<size_t>(in.a)].at(
                             static_cast<size_t>(row * width + in.c));
      }
      default:
        break;
    }
    std::vector<int32_t> operands;
    ir::for_each_operand(in, [&](Value o) { operands.push_back(need(o)); });
    return fold({in.op}, operands);
  }

  std::vector<int32_t> outputs() {
    std::vector<int32_t> all;
    for (const ir::Output& o : p_.outputs)
      for (const Value v : o.values) all.push_back(need(v));
    return all;
  }

  const Program& p_;
  const Call& call_;
  int64_t row_;
  std::vector<int32_t> section_;
  std::vector<std::optional<int32_t>> values_;
  std::vector<std::vector<int32_t>> sums_;
  std::vector<std::vector<int32_t>> sources_;
  std::vector<int32_t> offsets_, items_;
  int32_t counter_ = 0, slot_ = 0;
  int skipped_ = 0;
};

bool same_float(int32_t a, int32_t b) {
  const float x = std::bit_cast<float>(a), y = std::bit_cast<float>(b);
  return a == b || (std::isnan(x) && std::isnan(y));
}

// Nested selects, with and without skipping, on one lane and on the device among few and among
// many.
TEST(ProgramSchedule, GivesTheBitsOfThePlainOrderWhateverIsSkipped) {
  int skipped = 0, compared = 0;
  for (uint32_t seed = 300; seed < 330; ++seed) {
    RandomKernel maker(seed);
    const Call call = maker.call(static_cast<SumKind>(seed % 3), seed % 2 == 0 ? 3 : 40);
    const Program& p = call.kernel.program();
    const std::vector<ir::Step> steps = ir::schedule(p);
    const auto out = call();
    std::vector<std::vector<float>> device;
    for (const Tensor& t : out) device.push_back(t.to_host());
    for (int64_t row = 0; row < std::min<int64_t>(call.dim, 6); ++row) {
      Lane plain(p, call, row), scheduled(p, call, row);
      const auto expected = plain.run_plain(), got = scheduled.run_schedule(steps);
      skipped += scheduled.skipped();
      size_t at = 0;
      for (size_t o = 0; o < out.size(); ++o) {
        const auto width = static_cast<size_t>(out[o].row_width());
        for (size_t c = 0; c < width; ++c, ++at, ++compared) {
          ASSERT_TRUE(same_float(got[at], expected[at])) << "seed " << seed << ", row " << row;
          const float value = device[o][static_cast<size_t>(row) * width + c];
          ASSERT_TRUE(same_float(std::bit_cast<int32_t>(value), expected[at]))
              << "seed " << seed << ", row " << row << ": device " << value;
        }
      }
      if (HasFailure()) return;
    }
  }
  EXPECT_GT(skipped, 100);
  EXPECT_GT(compared, 300);
}

TEST(ProgramSchedule, ComputesEveryNeededValueOnceAndClosesItsRegions) {
  for (uint32_t seed = 400; seed < 430; ++seed) {
    const Program p = RandomKernel(seed).make(static_cast<SumKind>(seed % 3)).program();
    const std::vector<ir::Step> steps = ir::schedule(p);
    std::vector<int> computed(p.instrs.size(), 0);
    int open_loops = 0;
    for (size_t k = 0; k < steps.size(); ++k) {
      if (steps[k].kind == ir::Step::Kind::Compute) ++computed[static_cast<size_t>(steps[k].value)];
      if (steps[k].kind == ir::Step::Kind::LoopBegin) ++open_loops;
      if (steps[k].kind == ir::Step::Kind::LoopEnd) --open_loops;
      if (steps[k].kind == ir::Step::Kind::SkipIfNone) {
        EXPECT_GT(steps[k].target, static_cast<int32_t>(k));
        EXPECT_LE(steps[k].target, static_cast<int32_t>(steps.size()));
      }
    }
    EXPECT_EQ(open_loops, 0);
    for (const int count : computed) EXPECT_EQ(count, 1);
  }
}

}  // namespace
}  // namespace novaphy::testing
