// The conversion of a persistent kernel to a table and a text: the forms of chains, and the values
// that stay in registers.
#include <gtest/gtest.h>

#include <utility>

#include "compiler.h"
#include "novaphy/nova/kernel.h"
#include "persistent_kernels.h"
#include "persistent_source.h"

namespace novaphy::gpu {
namespace {

using nova::Access;
using nova::DType;
using nova::TraceContext;
using Operation = ChainForm::Operation;
using Form = PersistentShape::Form;

class PersistentTest : public ::testing::Test {
 protected:
  PersistentTest() {
    add = traced(nova::make_kernel(
        "add", {{"a", DType::F32, 3, Access::Direct}, {"b", DType::F32, 3, Access::Direct}},
        {{"sum", 3}}, [](TraceContext& t) {
          return std::vector{t.f32(0, 0) + t.f32(1, 0), t.f32(0, 1) + t.f32(1, 1),
                             t.f32(0, 2) + t.f32(1, 2)};
        }));
    add.number = 7;
    sum = row_sum_kernel();
  }
  void push(novaphy_kernel& kernel, uint32_t phase, uint32_t chain, std::vector<uint64_t> words) {
    recorded.launch(recorded.add(phase, chain, kRows, kRows), kernel, std::move(words));
  }
  void push_add(uint32_t phase, uint32_t chain, uint64_t a, uint64_t b, uint64_t to) {
    push(add, phase, chain, {a, kRows, b, kRows, to});
  }
  void push_sum(uint32_t phase, uint64_t source, uint64_t init, uint64_t to) {
    push(sum, phase, 0, {source, 0x8000, 0x9000, init, to, 3, 0});
  }
  static void expect_compiles(const PersistentTable& table) {
    if (!compiler(0).available()) return;
    for (const Form form : {Form::Block, Form::Cluster, Form::Grid}) {
      if (form == Form::Grid && table.tasks != 0) continue;  // persistent.cpp: never together
      const PersistentShape shape{form, form == Form::Block ? 1u : 4u, 128};
      EXPECT_EQ(compile(persistent_source(table, shape), 90, Dialect::Program).problem, "");
    }
  }

  static constexpr uint64_t kRows = 40;
  novaphy_kernel add, sum;
  RecordedPersistent recorded;
  std::vector<novaphy_persistent_op>& ops = recorded.ops;
};

TEST_F(PersistentTest, ChainsOfOneStructureShareTheirForm) {
  for (uint32_t t = 0; t < 6; ++t) {
    push_add(t, 0, 0x1000 * t, 0x100, 0x1000 * (t + 1));
    push_add(t, 1, 0x1000 * t, 0x200, 0x10000 + 0x1000 * t);
  }
  const PersistentTable table = persistent_table(ops);
  ASSERT_TRUE(table.fits);
  EXPECT_EQ(table.forms.size(), 1u);
  EXPECT_EQ(table.programs.size(), 1u);
  EXPECT_EQ(most_warps(ops), 4u);  // 40 rows are two warps, of either chain
  // Records lie one behind another: header, chains, and of each chain where its threads keep words,
  // the kernel's number and the arguments.
  constexpr uint64_t kRecord = 2 + 2 * 2 + 2 * 7;
  EXPECT_EQ(table.first_words, kRecord);
  EXPECT_EQ(table.words.size(), 6 * kRecord + 1);
  EXPECT_EQ(table.words[0], kRecord << 32 | kRecord);
  EXPECT_EQ(table.words[1], uint64_t{4} << 32 | 32 << 16 | 2);
  EXPECT_EQ(table.words[2], kRows);                      // the first chain begins with warp 0
  EXPECT_EQ(table.words[4], uint64_t{2} << 32 | kRows);  // the second one with warp 2
  EXPECT_EQ(table.words[6], 0u);                         // nothing
  EXPECT_EQ(table.words[7], 7u);
  EXPECT_EQ(table.words[5 * kRecord], 0u);  // the last record
  expect_compiles(table);
}

TEST_F(PersistentTest, WhatAChainLeavesForItselfStaysInRegisters) {
  push_add(0, 0, 0x1000, 0x2000, 0x3000);
  push_add(0, 0, 0x3000, 0x2000, 0x3000);  // in place
  push_add(0, 0, 0x3000, 0x1000, 0x4000);
  const PersistentTable table = persistent_table(ops);
  ASSERT_EQ(table.forms.size(), 1u);
  const auto& chain = table.forms[0].operations;
  EXPECT_EQ(chain[0].sources[0].from, Operation::Source::Own);
  EXPECT_EQ(chain[1].sources[0].from, Operation::Source::Registers);
  EXPECT_EQ(chain[1].sources[0].op, 0);
  EXPECT_EQ(chain[2].sources[0].op, 1);
  EXPECT_EQ(chain[2].sources[1].from, Operation::Source::Own);
  EXPECT_EQ(chain[0].outputs[0].store, Operation::Output::Never);  // overwritten
  EXPECT_EQ(chain[1].outputs[0].store, Operation::Output::Later);
  EXPECT_EQ(chain[2].outputs[0].store, Operation::Output::Later);
  expect_compiles(table);
}

TEST_F(PersistentTest, SumsOverTheSameItemsRunTogether) {
  push_sum(0, 0x1000, 0, 0x2000);
  push_sum(0, 0x3000, 0, 0x4000);
  push_sum(0, 0x5000, 0x2000, 0x2000);
  push_sum(0, 0x6000, 0x2000, 0x7000);  // needs the result of the sum before
  const PersistentTable table = persistent_table(ops);
  const auto& chain = table.forms.at(0).operations;
  EXPECT_FALSE(chain[0].sum.joins);
  EXPECT_TRUE(chain[1].sum.joins);
  EXPECT_FALSE(chain[2].sum.joins);
  EXPECT_FALSE(chain[3].sum.joins);
  EXPECT_EQ(table.forms.at(0).tables, std::vector<int32_t>{2});  // loaded once, for all
  for (const Operation& op : chain) EXPECT_EQ(op.tables, std::vector<int32_t>{0});
  expect_compiles(table);
}

// Phase t adds fixed values to the result of the phase before. Another chain does the same
// elsewhere.
TEST_F(PersistentTest, WhatNothingWritesIsKeptByItsThreads) {
  constexpr uint32_t kPhases = 6;
  constexpr uint64_t kFixed = 0x100000, kState = 0x200000, kOther = 0x300000, kBytes = kRows * 12;
  const uint64_t almost = kState + kPhases * kBytes - 4;  // an array that overlaps the last states
  for (uint32_t t = 0; t < kPhases; ++t) {
    push_add(t, 0, kState + t * kBytes, kFixed, kState + (t + 1) * kBytes);
    push_add(t, 1, kOther + t * kBytes, almost, kOther + (t + 1) * kBytes);
  }
  const PersistentTable table = persistent_table(ops, {0, 100});
  ASSERT_EQ(table.forms.size(), 2u);
  int32_t fixed = 0;
  for (const ChainForm& form : table.forms) {
    EXPECT_FALSE(form.operations[0].sources[0].fixed);  // a state
    fixed += form.operations[0].sources[1].fixed ? 1 : 0;
  }
  EXPECT_EQ(fixed, 1);
  EXPECT_EQ(table.kept_words, 3u);
  for (uint32_t t = 0, at = 0; t < kPhases; ++t) {
    EXPECT_EQ(table.words[at + 6], t == 0 ? 3u : 2u) << t;  // the first phase fills the kept words
    EXPECT_EQ(table.words[at + 13], 0u) << t;
    at = static_cast<uint32_t>(table.words[at]);
  }
  expect_compiles(table);
  EXPECT_EQ(persistent_table(ops, {0, 2}).kept_words, 0u);  // no room
}

TEST_F(PersistentTest, WarpsThatWouldIdleShareTheRows) {
  push_add(0, 0, 0x1000, 0x100, 0x2000);
  push_add(0, 1, 0x1000, 0x200, 0x3000);
  EXPECT_EQ(persistent_table(ops, {9, 0}).words[1], uint64_t{6} << 32 | 16 << 16 | 2);
  const PersistentTable table = persistent_table(ops, {10, 0});
  EXPECT_EQ(table.words[1], uint64_t{10} << 32 | 8 << 16 | 2);
  EXPECT_EQ(table.words[4], uint64_t{5} << 32 | kRows);  // the second chain begins with warp 5
  expect_compiles(table);
}

// Words of a task: form << 48 | first word of the arguments << 32 | rows << 24 | first row.
struct Task {
  uint64_t form, at, rows, first;
};
Task task_at(const PersistentTable& table, uint64_t number) {
  const uint64_t word = table.words.at(table.tasks + number);
  return {word >> 48, word >> 32 & 0xffff, word >> 24 & 0xff, word & 0xffffff};
}

TEST_F(PersistentTest, EachWarpHasItsTask) {
  push_add(0, 0, 0x1000, 0x100, 0x2000);
  push_add(0, 1, 0x1000, 0x200, 0x3000);
  push_add(1, 0, 0x2000, 0x100, 0x4000);
  EXPECT_EQ(persistent_table(ops, {10, 0}).tasks, 0u);  // without a number of blocks
  const PersistentTable table = persistent_table(ops, {10, 0, 2});
  ASSERT_NE(table.tasks, 0u);
  EXPECT_EQ(table.counters, table.tasks + 2 * 10);
  for (uint64_t warp = 0; warp < 10; ++warp) {  // neighbors lie in different blocks
    const Task task = task_at(table, warp % 2 * 5 + warp / 2);
    EXPECT_EQ(task.rows, 8u);
    EXPECT_EQ(task.first, warp % 5 * 8) << warp;
    EXPECT_EQ(task.at, table.words[warp < 5 ? 3 : 5] & UINT32_MAX) << warp;
  }
  const uint64_t second = table.words[0] & UINT32_MAX;
  EXPECT_EQ(table.words[second + 1] >> 16 & 0xffff, 4u);  // rows of a warp
  for (uint64_t warp = 0; warp < 10; ++warp)
    EXPECT_EQ(task_at(table, 10 + warp % 2 * 5 + warp / 2).first, warp * 4);
  expect_compiles(table);
}

// While the warps of one phase work, the warps of the next phase do their early part.
TEST_F(PersistentTest, PhasesTakeTurnsAmongGroupsOfWarps) {
  for (uint32_t t = 0; t < 4; ++t) push_add(t, 0, 0x1000 * (t + 1), 0x100, 0x1000 * (t + 2));
  const PersistentTable table = persistent_table(ops, {4, 100, 2, 2});
  EXPECT_EQ(table.counters, table.tasks + 4 * 8);
  for (uint64_t t = 0; t < 4; ++t)
    for (uint64_t block = 0; block < 2; ++block)
      for (uint64_t warp = 0; warp < 4; ++warp) {  // two warps of each group
        const Task task = task_at(table, (t * 2 + block) * 4 + warp);
        const bool its_turn = warp / 2 == t % 2;
        EXPECT_EQ(task.rows != 0, its_turn && !(warp % 2 == 1 && block == 1)) << t << block << warp;
        if (task.rows == 0) continue;
        EXPECT_EQ(task.first, (warp % 2 * 2 + block) * 16);
      }
  expect_compiles(table);
}

TEST_F(PersistentTest, WhatThePhaseBeforeDoesNotWriteIsReadEarly) {
  // Phase t adds to the state of phase t - 1 that of phase t - 2.
  for (uint32_t t = 2; t < 6; ++t)
    push_add(t, 0, 0x10000 * (t - 1), 0x10000 * (t - 2) + 0x100, 0x10000 * t);
  const auto early = [&](const PersistentCapacity& capacity) {
    const PersistentTable table = persistent_table(ops, capacity);
    EXPECT_EQ(table.forms.size(), 1u);
    expect_compiles(table);
    const auto& sources = table.forms[0].operations[0].sources;
    return std::vector{sources[0].early, sources[1].early};
  };
  EXPECT_EQ(early({4, 0, 2}), (std::vector{false, true}));
  EXPECT_EQ(early({4, 0, 0}), (std::vector{false, false}));  // without tasks: nothing

  // One chain of the form decides for all chains: the second state of phase 5 overlaps a result of
  // phase 4.
  (*recorded.words.back())[2] = 0x40000 - kRows * 12 + 4;
  EXPECT_EQ(early({4, 0, 2}), (std::vector{false, false}));
}

TEST_F(PersistentTest, WhatNeedsOnlyEarlyRowsIsDoneBeforeTheWait) {
  novaphy_kernel kernel = traced(nova::make_kernel("late_and_early",
                                                   {{"state", DType::F32, 1, Access::Direct},
                                                    {"row", DType::I32, 1, Access::Direct},
                                                    {"fixed", DType::F32, 1, Access::Indexed}},
                                                   {{"sum", 1}}, [](TraceContext& t) {
                                                     const nova::Real x = t.f32(2, t.i32(1), 0);
                                                     return std::vector{t.f32(0, 0) + x * x};
                                                   }));
  for (uint32_t t = 0; t < 4; ++t)
    push(kernel, t, 0, {0x1000 * (t + 1), kRows, 0x100, kRows, 0x200, 4, 0x1000 * (t + 2)});
  const PersistentTable table = persistent_table(ops, {4, 100, 2});
  const std::string text = persistent_source(table, {Form::Cluster, 2, 64});
  const size_t wait = text.find("  phase_wait();\n", text.find("void chain0("));
  ASSERT_NE(wait, std::string::npos);
  EXPECT_LT(text.find("    early_row0("), wait);
  EXPECT_GT(text.find("    row0("), wait);
  EXPECT_NE(text.find("early_row0(w, no_source{}, source_registers{own0_1}, source_rows{"),
            std::string::npos);
  // The square is computed early, and the sum is not.
  const std::string early = text.substr(text.find("void early_row0("), 600);
  EXPECT_NE(early.find(" * "), std::string::npos);
  EXPECT_EQ(early.find(" + "), std::string::npos);
  expect_compiles(table);
}

// The Program has one row, or four rows, for each row of the chain. Four rows are computed late.
TEST_F(PersistentTest, OnlyOneRowOfAChainIsComputedEarly) {
  for (uint32_t t = 0; t < 2; ++t) {
    push_add(t, 0, 0x10000, 0x20000, 0x30000 + 0x1000 * t);
    push_add(t, 1, 0x10000, 0x20000, 0x40000 + 0x1000 * t);
    ops.back().rows = kRows / 4;
  }
  const PersistentTable table = persistent_table(ops, {8, 0, 2});
  ASSERT_EQ(table.forms.size(), 2u);
  const std::string text = persistent_source(table, {Form::Cluster, 2, 128});
  for (size_t form = 0; form < 2; ++form) {
    const Operation& op = table.forms[form].operations[0];
    EXPECT_TRUE(op.sources[0].early);
    const size_t begin = text.find("void chain" + std::to_string(form) + "(");
    const std::string chain = text.substr(begin, text.find("\n}\n", begin) - begin);
    EXPECT_EQ(chain.find("    early_row") != std::string::npos, op.each == 1) << chain;
    EXPECT_EQ(chain.find("early0_0") != std::string::npos, op.each == 1) << chain;
  }
  expect_compiles(table);
}

// Threads that have no row go along to the end, unless something is stored before.
TEST_F(PersistentTest, ThreadsWithoutARowStoreNothing) {
  const auto text_of = [&] {
    const PersistentTable table = persistent_table(ops, {8, 0, 2});
    expect_compiles(table);
    const std::string text = persistent_source(table, {Form::Cluster, 2, 128});
    return text.substr(text.find("void chain0("));
  };
  push_add(0, 0, 0x10000, 0x20000, 0x30000);
  std::string text = text_of();
  EXPECT_LT(text.find("    row0("), text.find("  if (!on) return;"));
  EXPECT_LT(text.find("  if (!on) return;"), text.find("  store_row<"));

  ops.clear();  // more words than stay in registers
  push_add(0, 0, 0x10000, 0x20000, 0x30000);
  push_add(0, 0, 0x30000, 0x20000, 0x30000);
  for (novaphy_persistent_op& o : ops) o.rows = kRows / 10;
  text = text_of();
  EXPECT_NE(text.find("output_rows{"), std::string::npos);
  EXPECT_LT(text.find("  phase_wait();"), text.find("  if (!on) return;"));
  EXPECT_LT(text.find("  if (!on) return;"), text.find("    row0("));
}

TEST_F(PersistentTest, ProgramsThatAddItemsAreSums) {
  novaphy_kernel collect = collect_kernel();
  const uint64_t many = 4 * kRows;
  push(collect, 0, 0, {0x1000, kRows, 0x2000, many, 0x3000, 0x8000, 0x9000});
  push(collect, 0, 0, {0x3000, kRows, 0x4000, many, 0x5000, 0xa000, 0xb000});
  push(collect, 0, 0, {0x6000, kRows - 1, 0x4000, many, 0x7000, 0xa000, 0xb000});
  const PersistentTable table = persistent_table(ops);
  const auto& chain = table.forms.at(0).operations;
  for (const int k : {0, 1}) {
    EXPECT_EQ(chain[k].kind, Operation::RowSum);
    EXPECT_FALSE(chain[k].sum.chunks);  // a loop has no rule for long rows
    EXPECT_EQ(chain[k].sum.source_word, 2);
    EXPECT_EQ(chain[k].sum.offsets_word, 5);
    EXPECT_EQ(chain[k].sum.init_word, 0);
    EXPECT_EQ(chain[k].sum.out_word, 4);
  }
  EXPECT_EQ(chain[1].sources[0].from, Operation::Source::Registers);
  EXPECT_EQ(chain[2].kind, Operation::Program);  // its own row may lack
  const std::string text = persistent_source(table, {Form::Block, 1, 128});
  const size_t first = text.find("    sum_row<true, false, 3, CSR_BATCH>(");
  ASSERT_NE(first, std::string::npos);
  for (const char* load :
       {"load_first_rows(&items0[0], memory_items{", "load_first_rows(&items1[0], memory_items{"})
    EXPECT_LT(text.find(load), first);  // rows of both are on their way before any is added
  expect_compiles(table);
}

TEST_F(PersistentTest, WarpsWithoutRowsHaveNothingToDo) {
  push_add(0, 0, 0x1000, 0x100, 0x2000);
  ops[0].n = ops[0].rows = 5;
  const PersistentTable table = persistent_table(ops, {8, 0, 4});
  for (uint64_t block = 0; block < 4; ++block)
    for (uint64_t warp = 0; warp < 2; ++warp) {
      const uint64_t number = warp * 4 + block;
      EXPECT_EQ(task_at(table, block * 2 + warp).rows, number < 5 ? 1u : 0u) << number;
    }
}

TEST_F(PersistentTest, InALargeClusterFullWarpsOfAChainShareABlock) {
  push_add(0, 0, 0x1000, 0x100, 0x2000);
  ops[0].n = ops[0].rows = 32 * 32;
  const PersistentTable table = persistent_table(ops, {32, 0, 16});
  for (uint64_t number = 0; number < 32; ++number)
    EXPECT_EQ(task_at(table, number).first, number * 32);
}

TEST_F(PersistentTest, ARowForAllIsLoadedWhenTheChainBegins) {
  novaphy_kernel fall = traced(nova::make_kernel(
      "fall", {{"v", DType::F32, 1, Access::Direct}, {"g", DType::F32, 1, Access::Uniform}},
      {{"sum", 1}}, [](TraceContext& t) { return std::vector{t.f32(0, 0) + t.f32(1, 0)}; }));
  for (uint32_t t = 0; t < 4; ++t)
    push(fall, t, 0, {0x1000 * (t + 1), kRows, 0x100, 1, 0x1000 * (t + 2)});
  const PersistentTable table = persistent_table(ops, {0, 100});
  const Operation& op = table.forms.at(0).operations.at(0);
  EXPECT_EQ(op.sources[1].from, Operation::Source::First);
  EXPECT_TRUE(op.sources[1].fixed);
  EXPECT_EQ(table.kept_words, 1u);
  expect_compiles(table);

  // An array that the persistent kernel writes is not fixed.
  push(fall, 4, 0, {0x9000, kRows, 0x100, 1, 0x100});
  const PersistentTable written = persistent_table(ops, {0, 100});
  for (const ChainForm& form : written.forms)
    EXPECT_EQ(form.operations[0].sources[1].from, Operation::Source::There);
  EXPECT_EQ(written.kept_words, 0u);
}

TEST_F(PersistentTest, ChainsOfDifferentThreadsShareWhereTheyKeepWords) {
  for (uint32_t t = 0; t < 4; ++t)
    for (uint32_t c = 0; c < 3; ++c)
      push_add(t, c, 0x10000 * (c + 1), 0x100000 * (c + 1), 0x1000000 * (4 * c + t + 1));
  const PersistentTable table = persistent_table(ops, {0, 100});
  EXPECT_EQ(table.kept_words, 6u);
  for (const uint64_t at : {8u, 15u, 22u}) EXPECT_EQ(table.words[at], 3u);
  expect_compiles(table);
}

TEST_F(PersistentTest, RowsOfWholeQuartersMoveFourWordsAtOnce) {
  for (const uint64_t at : {0x1000, 0x1004}) {
    ops.clear();
    push_add(0, 0, at, 0x2000, 0x3000);
    ops[0].rows = kRows / 4;  // four rows of three words for each of the chain
    const Operation op = persistent_table(ops).forms.at(0).operations.at(0);
    EXPECT_EQ(op.sources[0].from, Operation::Source::Own);
    EXPECT_EQ(op.sources[0].aligned, at == 0x1000);
    EXPECT_TRUE(op.sources[1].aligned);
    EXPECT_TRUE(op.outputs[0].aligned);
  }
  expect_compiles(persistent_table(ops));
}

TEST_F(PersistentTest, SourcesThatMayLackRowsAreChecked) {
  push(add, 0, 0, {0x1000, kRows - 1, 0x2000, kRows, 0x3000});
  const PersistentTable table = persistent_table(ops);
  EXPECT_EQ(table.forms[0].operations[0].sources[0].from, Operation::Source::Memory);
  EXPECT_EQ(table.forms[0].operations[0].sources[1].from, Operation::Source::Own);
  expect_compiles(table);
}

}  // namespace
}  // namespace novaphy::gpu
