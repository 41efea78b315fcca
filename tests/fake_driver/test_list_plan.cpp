// The conversion of a list of operations to one kernel: which operations repeat, and which values
// stay in registers.
#include <gtest/gtest.h>

#include <memory>

#include "compiler.h"
#include "list_plan.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::gpu {
namespace {

using From = ListPlan::Source::From;
using nova::Access;
using nova::DType;
using nova::TraceContext;

novaphy_kernel kernel_of(const nova::Kernel& traced, uint32_t number) {
  novaphy_kernel kernel;
  kernel.program = traced.program();
  kernel.argument_count = kernel.program.argument_count();
  kernel.name = traced.name();
  kernel.number = number;
  return kernel;
}

// x, v -> x + v*dt, v*c
class ListPlanTest : public ::testing::Test {
 protected:
  ListPlanTest()
      : move(kernel_of(
            nova::make_kernel(
                "move",
                {{"x", DType::F32, 1, Access::Direct},
                 {"v", DType::F32, 1, Access::Direct},
                 {"c", DType::F32, 1, Access::Direct}},
                {{"x", 1}, {"v", 1}},
                [](TraceContext& t) {
                  return std::vector{t.f32(0) + t.f32(1) * t.param(0), t.f32(1) * t.f32(2)};
                }),
            1)),
        add(kernel_of(
            nova::make_kernel(
                "add", {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
                {{"sum", 1}}, [](TraceContext& t) { return std::vector{t.f32(0) + t.f32(1)}; }),
            2)) {}

  void push(novaphy_kernel& kernel, std::vector<uint64_t> words) {
    EXPECT_EQ(words.size(), kernel.argument_count);
    kept.push_back(std::make_unique<std::vector<uint64_t>>(std::move(words)));
    novaphy_list_op op{};
    op.struct_size = sizeof(op);
    op.kernel = &kernel;
    op.arguments = kept.back()->data();
    op.argument_count = kernel.argument_count;
    ops.push_back(op);
  }
  // One step: from the states at `from` to those at `to`.
  void step(uint64_t from, uint64_t to) {
    push(move, {x + from, kRows, v + from, kRows, c, kRows, x + to, v + to, 0x3f000000});
  }
  static bool compiles(const ListSource& source) {
    if (!compiler(0).available()) return true;
    const CompiledCode code = compile(source.text, 90, Dialect::Program);
    EXPECT_EQ(code.problem, "");
    return code.problem.empty();
  }

  static constexpr uint64_t kRows = 5, x = 0x10000, v = 0x20000, c = 0x30000;
  novaphy_kernel move, add;
  std::vector<std::unique_ptr<std::vector<uint64_t>>> kept;
  std::vector<novaphy_list_op> ops;
};

TEST_F(ListPlanTest, AChainOfStatesStaysInRegisters) {
  for (uint64_t t = 0; t < 20; ++t) step(0x100 * t, 0x100 * (t + 1));
  const ListPlan plan = plan_list(ops);
  ASSERT_TRUE(plan.worth_it);
  EXPECT_EQ(plan.first, 0u);
  EXPECT_EQ(plan.period, 1u);
  EXPECT_EQ(plan.repeats, 20u);
  ASSERT_EQ(plan.body.size(), 1u);
  const auto& sources = plan.body[0].sources;
  EXPECT_EQ(sources[0].from, From::Registers);
  EXPECT_TRUE(sources[0].carried);
  EXPECT_EQ(sources[1].from, From::Registers);
  EXPECT_EQ(sources[1].output, 1u);
  EXPECT_EQ(sources[2].from, From::Constant);
  const ListSource source = list_source(plan, ops, kRows);
  EXPECT_TRUE(source.table.empty());  // the addresses grow evenly
  EXPECT_NE(source.text.find("source_registers{r0_1}"), std::string::npos);
  EXPECT_NE(source.text.find("source_registers{c0_2}"), std::string::npos);  // loaded once
  EXPECT_TRUE(compiles(source));
}

TEST_F(ListPlanTest, StatesThatTakeTurnsAreListedInATable) {
  for (uint64_t t = 0; t < 7; ++t) {
    step(0x100 * (t % 3), 0x100 * ((t + 1) % 3));
  }
  const ListPlan plan = plan_list(ops);
  EXPECT_EQ(plan.period, 1u);
  EXPECT_EQ(plan.body[0].sources[0].from, From::Registers);
  const ListSource source = list_source(plan, ops, kRows);
  EXPECT_EQ(source.table_width, 4u);
  EXPECT_EQ(source.table.size(), 7u * 4u);
  EXPECT_EQ(source.table[4], x + 0x100);
  EXPECT_TRUE(compiles(source));
}

TEST_F(ListPlanTest, WhatComesBeforeAndAfterTheBodyReadsMemory) {
  push(add, {0x40000, kRows, c, kRows, x});
  for (uint64_t t = 0; t < 6; ++t) {
    step(0x100 * t, 0x100 * (t + 1));
    push(add, {0x50000, kRows, x + 0x100 * (t + 1), kRows, 0x50000});  // a sum over time, in place
  }
  push(add, {0x50000, kRows, c, kRows, 0x60000});
  const ListPlan plan = plan_list(ops);
  EXPECT_EQ(plan.first, 1u);
  EXPECT_EQ(plan.period, 2u);
  EXPECT_EQ(plan.repeats, 6u);
  EXPECT_EQ(plan.before.size(), 1u);
  EXPECT_EQ(plan.after.size(), 1u);
  const auto& sum = plan.body[1];
  EXPECT_EQ(sum.sources[0].from, From::Registers);
  EXPECT_TRUE(sum.sources[0].carried);
  EXPECT_EQ(sum.sources[1].from, From::Registers);
  EXPECT_FALSE(sum.sources[1].carried);
  EXPECT_EQ(sum.sources[1].op, 0u);
  EXPECT_EQ(plan.after[0].sources[0].from, From::Memory);
  EXPECT_TRUE(compiles(list_source(plan, ops, kRows)));
}

TEST_F(ListPlanTest, AValueThatIsOverwrittenBeforeItIsReadIsLoaded) {
  // The second operation reads the first one's result of the iteration before.
  for (uint64_t t = 0; t < 5; ++t) {
    step(0x100 * t, 0x100 * (t + 1));
    push(add, {x + 0x100 * t, kRows, c, kRows, 0x50000 + 0x100 * t});
  }
  const ListPlan plan = plan_list(ops);
  EXPECT_EQ(plan.period, 2u);
  EXPECT_EQ(plan.body[1].sources[0].from, From::Memory);
  EXPECT_EQ(plan.body[1].sources[1].from, From::Constant);
  EXPECT_TRUE(compiles(list_source(plan, ops, kRows)));
}

TEST_F(ListPlanTest, CopiesAndFillsAreOperationsToo) {
  for (uint64_t t = 0; t < 5; ++t) {
    step(0x100 * t, 0x100 * (t + 1));
    novaphy_list_op copy{};
    copy.struct_size = sizeof(copy);
    copy.row_bytes = 4;
    copy.source = reinterpret_cast<const void*>(x + 0x100 * (t + 1));
    copy.target = reinterpret_cast<void*>(0x50000 + 0x100 * t);
    ops.push_back(copy);
    copy.source = nullptr;
    copy.pattern = 0x3f800000;
    copy.target = reinterpret_cast<void*>(uint64_t{0x60000});
    ops.push_back(copy);
  }
  const ListPlan plan = plan_list(ops);
  EXPECT_EQ(plan.period, 3u);
  EXPECT_EQ(plan.repeats, 5u);
  EXPECT_TRUE(compiles(list_source(plan, ops, kRows)));
}

TEST_F(ListPlanTest, WhatTheNextIterationReadsIsLoadedDuringThisOne) {
  for (uint64_t t = 0; t < 6; ++t)  // the sum so far, and a row of each state
    push(add, {0x50000, kRows, x + 0x100 * t, kRows, 0x50000});
  const ListPlan plan = plan_list(ops);
  EXPECT_EQ(plan.body[0].sources[1].from, From::Constant);
  const ListSource source = list_source(plan, ops, kRows);
  EXPECT_NE(source.text.find("source_registers{x0_1}"), std::string::npos);
  EXPECT_NE(source.text.find("load_row<1>((const char*)(a.word["), std::string::npos);
  EXPECT_TRUE(compiles(source));
}

TEST_F(ListPlanTest, WhatIsOverwrittenUnreadIsNotStored) {
  for (uint64_t t = 0; t < 9; ++t) step(0x100 * (t % 2), 0x100 * ((t + 1) % 2));
  const ListPlan plan = plan_list(ops);
  const ListSource source = list_source(plan, ops, kRows);
  // Two states take turns. The last two iterations write their final values.
  const size_t at = source.text.find("if (k >= (int32_t)a.word[");
  ASSERT_NE(at, std::string::npos);
  EXPECT_EQ(source.words[std::stoul(source.text.substr(at + 25))], 7u);
  EXPECT_TRUE(compiles(source));
}

TEST_F(ListPlanTest, ALongListWithoutStructureIsLeftAlone) {
  uint32_t random = 1;
  for (uint64_t t = 0; t < 200; ++t) {
    random = random * 1664525u + 1013904223u;
    if ((random >> 20 & 1) != 0) {
      step(0x100 * t, 0x100 * (t + 1));
    } else {
      push(add, {x + 0x100 * t, kRows, c, kRows, x + 0x100 * (t + 1)});
    }
  }
  EXPECT_FALSE(plan_list(ops).worth_it);
}

}  // namespace
}  // namespace novaphy::gpu
