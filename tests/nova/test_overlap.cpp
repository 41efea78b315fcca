// Phases that are joined because parts of elements overlap: when they are, what each part does
// then, and that it changes no bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <string>
#include <utility>

#include "novaphy/core/backend.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/op_list.h"
#include "overlap.h"
#include "support.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::Operand;
using nova::OpList;
using nova::detail::Chain;
using nova::detail::MovedWords;
using nova::detail::Overlap;
using nova::detail::RowLayout;

// Steps over nodes on a line: element i pulls at the two nodes that it names, the forces are
// summed, the nodes move. Nothing but the index tables is memory.
class Line {
 public:
  static constexpr int64_t kNodes = 160, kElements = 159;
  static constexpr uint64_t kForces = 0x100000, kSums = 0x200000, kStates = 0x300000,
                            kScale = 0x400000, kMore = 0x500000;

  // The other node of an element, and how many arrays of positions take turns.
  // `bytes`: of a row of what elements write.
  Line(int steps, int32_t (*other)(int32_t), uint64_t arrays, uint32_t parts, uint32_t bytes = 24) {
    elements_.outputs[0].row_bytes = bytes;
    const int64_t rows = kElements * 24 / bytes;
    std::vector<std::vector<int32_t>> of(kNodes);
    for (int32_t i = 0; i < kElements; ++i) {
      of[static_cast<size_t>(i)].push_back(2 * i);
      of[static_cast<size_t>(other(i))].push_back(2 * i + 1);
    }
    for (const auto& slots : of) {
      offsets.push_back(static_cast<int32_t>(items.size()));
      items.insert(items.end(), slots.begin(), slots.end());
    }
    offsets.push_back(static_cast<int32_t>(items.size()));
    const auto state = [&](int step) {
      return kStates + 0x1000 * (static_cast<uint64_t>(step) % arrays);
    };
    for (int t = 0; t < steps; ++t) {
      const auto phase = static_cast<uint32_t>(2 * t);
      launch(elements_, rows, {state(t), kNodes, kForces, kScale, static_cast<uint64_t>(rows)});
      launch(sums_, kNodes, {kForces, 2 * kElements, word(offsets), word(items), kSums});
      launch(move_, kNodes, {kSums, kNodes, state(t + 1)});
      const auto op = static_cast<uint32_t>(ops.size());
      chains.push_back({op - 3, op - 2, phase, rows, {parts}});
      chains.push_back({op - 2, op, phase + 1, kNodes, {parts}});
    }
  }
  Overlap plan() { return {ops, words, {}, chains, chains[0].shares.parts}; }
  // Something that wants it where it is looks at the memory after the third step.
  void look_at(uint64_t begin, int64_t bytes) {
    OpList::Op copy{OpList::Op::Kind::Copy};
    copy.source = reinterpret_cast<const void*>(begin);
    copy.target = reinterpret_cast<void*>(0x900000);
    copy.n = bytes;
    ops.insert(ops.begin() + 9, copy);
    for (size_t c = 6; c < chains.size(); ++c) {
      ++chains[c].first;
      ++chains[c].last;
    }
    chains.insert(chains.begin() + 6, {9, 10, 5, bytes / 4, {1}});
  }
  // Another operation writes what elements read at their own rows, before all else.
  void scale_first() {
    launch(scale_, kElements, {kScale});
    ops.insert(ops.begin(), ops.back());
    ops.pop_back();
    for (Chain& chain : chains) {
      ++chain.first;
      ++chain.last;
      ++chain.phase;
    }
    chains.insert(chains.begin(), {0, 1, 0, kElements, chains[0].shares});
  }
  // The sums gather from one more memory, that no elements write.
  void gather_more() {
    sums_.gathered.push_back({5, 2, 3, 12});
    for (OpList::Op& op : ops)
      if (op.layout == &sums_) {
        const std::vector<uint64_t> arguments(words.begin() + op.first_word,
                                              words.begin() + op.first_word + op.word_count);
        op.first_word = static_cast<uint32_t>(words.size());
        words.insert(words.end(), arguments.begin(), arguments.end());
        words.push_back(kMore);
        op.word_count += 1;
      }
  }
  uint32_t phases() const { return chains.back().phase + 1; }

  std::vector<OpList::Op> ops;
  std::vector<uint64_t> words;
  std::vector<Chain> chains;
  std::vector<int32_t> offsets, items;

 private:
  static uint64_t word(const std::vector<int32_t>& values) {
    return reinterpret_cast<uint64_t>(values.data());
  }
  static RowLayout local() {
    RowLayout layout;
    layout.row_local = true;
    return layout;
  }
  void launch(const RowLayout& layout, int64_t n, const std::vector<uint64_t>& arguments) {
    OpList::Op op{OpList::Op::Kind::Launch};
    op.n = n;
    op.layout = &layout;
    op.first_word = static_cast<uint32_t>(words.size());
    op.word_count = static_cast<uint32_t>(arguments.size());
    words.insert(words.end(), arguments.begin(), arguments.end());
    ops.push_back(op);
  }

  RowLayout elements_ = [] {
    RowLayout layout = local();
    layout.shared = {{0, 12}};
    layout.inputs = {{3, 4}};
    layout.outputs = {{2, 24}};
    return layout;
  }();
  RowLayout sums_ = [] {
    RowLayout layout = local();
    layout.shared = {{0, 12}};
    layout.gathered = {{0, 2, 3, 12}};
    layout.outputs = {{4, 12}};
    return layout;
  }();
  const RowLayout scale_ = [] {
    RowLayout layout = local();
    layout.outputs = {{0, 4}};
    return layout;
  }();
  const RowLayout move_ = [] {
    RowLayout layout = local();
    layout.inputs = {{0, 12}};
    layout.outputs = {{2, 12}};
    return layout;
  }();
};

int32_t next(int32_t i) { return i + 1; }
// Where that word of that operation points for the part.
uint64_t pointer(const Line& line, const Overlap& plan, uint32_t op, uint32_t word, uint32_t part) {
  const MovedWords moved = plan.moved(op, part);
  for (const auto& m : moved.words)
    if (m.word == word) return moved.bases[m.memory];
  return line.words[line.ops[op].first_word + word];
}

// The items of the part's sums, in its own numbers, are those that were recorded.
void expect_items_name_recorded_rows(const Line& line, const Overlap& plan, uint32_t part) {
  const auto* const items = reinterpret_cast<const int32_t*>(pointer(line, plan, 4, 3, part));
  const auto recorded = plan.listed(3, part);
  const auto sums = plan.rows(4, line.chains[3], part);
  for (int32_t k = line.offsets[static_cast<size_t>(sums.begin)];
       k < line.offsets[static_cast<size_t>(sums.end)]; ++k)
    EXPECT_EQ(2 * recorded[static_cast<size_t>(items[k] / 2)] + items[k] % 2,
              line.items[static_cast<size_t>(k)])
        << k;
}

TEST(Overlap, ElementsAndTheirSumsBecomeOnePhase) {
  Line line(5, next, 10, 4);
  const Overlap plan = line.plan();
  EXPECT_EQ(line.phases(), 6u);  // the last forces stay for others to see, and their sums wait
  for (uint32_t p = 0; p < 6; ++p) EXPECT_EQ(plan.joint(p), p < 4) << p;
  // Nodes 40 to 79 need the elements 39 to 79; they stand together, in whole groups of sixteen.
  const std::array<std::array<int32_t, 2>, 4> named = {{{0, 39}, {39, 79}, {79, 119}, {119, 158}}};
  for (uint32_t part = 0; part < 4; ++part) {
    const auto elements = plan.rows(3, line.chains[2], part);
    EXPECT_EQ(elements.begin, 0);
    EXPECT_EQ(elements.end, 48);
    const auto recorded = plan.listed(3, part);
    ASSERT_EQ(recorded.size(), 48u);
    for (int32_t k = 0; k < 48; ++k)
      EXPECT_EQ(recorded[static_cast<size_t>(k)], std::min(named[part][0] + k, named[part][1]));
    const auto sums = plan.rows(4, line.chains[3], part);
    EXPECT_EQ(sums.begin, 40 * part);
    EXPECT_EQ(sums.end, 40 * part + 40);
    // What the part writes is what it sums, and no other part touches it.
    const uint64_t forces = pointer(line, plan, 3, 2, part);
    EXPECT_EQ(pointer(line, plan, 4, 0, part), forces);
    for (uint32_t other = 0; other < part; ++other)
      EXPECT_TRUE(forces >= pointer(line, plan, 3, 2, other) + 48 * 24) << part << " " << other;
    expect_items_name_recorded_rows(line, plan, part);
  }
  EXPECT_TRUE(plan.moved_for_all(3).words.empty());
  const auto last = plan.rows(12, line.chains[8], 1);
  EXPECT_EQ(last.begin, 32);
  EXPECT_EQ(last.end, 64);
  EXPECT_EQ(pointer(line, plan, 12, 2, 1), Line::kForces);
}

TEST(Overlap, WhatAnotherPartStillReadsIsWrittenElsewhere) {
  Line line(6, next, 1, 4);  // nodes move in place, while other parts read where they were
  const Overlap plan = line.plan();
  EXPECT_EQ(line.phases(), 7u);
  for (uint32_t t = 0; t < 6; ++t) {
    const uint64_t written = pointer(line, plan, 3 * t + 2, 2, 1);
    if (t != 0) {
      EXPECT_NE(written, pointer(line, plan, 3 * t, 0, 1)) << t;
    }
    if (t < 5) {
      EXPECT_EQ(written, pointer(line, plan, 3 * t + 3, 0, 2)) << t;
    }
  }
  EXPECT_EQ(pointer(line, plan, 17, 2, 1), Line::kStates);
  for (uint32_t op = 0; op < line.ops.size(); ++op) {
    const MovedWords moved = plan.moved(op, 0), other = plan.moved(op, 3);
    const size_t shared = plan.moved_for_all(op).words.size();
    for (size_t w = 0; w < moved.words.size(); ++w) {
      const uint32_t memory = moved.words[w].memory;
      EXPECT_EQ(moved.bases[memory] == other.bases[memory], w < shared) << op;
    }
  }
}

TEST(Overlap, ElementsNeedNotStandNearTheirNodes) {
  Line line(
      5, [](int32_t i) { return (i * 67 + 80) % 160; }, 10, 8);
  const Overlap plan = line.plan();
  EXPECT_EQ(line.phases(), 6u);
  for (uint32_t part = 0; part < 8; ++part) {
    EXPECT_LE(plan.listed(3, part).size(), 48u);  // two for each of twenty nodes
    expect_items_name_recorded_rows(line, plan, part);
  }
}

TEST(Overlap, StaysAsRecordedWhereItGainsNothing) {
  {
    SCOPED_TRACE("an item of another array");
    Line line(5, next, 10, 4);
    line.items[7] = 2 * Line::kElements;
    line.plan();
    EXPECT_EQ(line.phases(), 10u);
  }
  {
    SCOPED_TRACE("items of something else as well");
    Line line(5, next, 10, 4);
    line.gather_more();
    line.plan();
    EXPECT_EQ(line.phases(), 10u);
  }
  {
    SCOPED_TRACE("items of several rows");
    Line line(5, next, 10, 4, 4);
    line.plan();
    EXPECT_EQ(line.phases(), 10u);
  }
  {
    SCOPED_TRACE("other parts than threads");
    Line line(5, next, 10, 4);
    for (Chain& chain : line.chains) chain.shares.parts = chain.rows == Line::kNodes ? 2 : 4;
    line.plan();
    EXPECT_EQ(line.phases(), 10u);
  }
}

TEST(Overlap, WhatElementsReadIsWrittenBeforeAnyPartCopiesIt) {
  Line line(5, next, 10, 4);
  line.scale_first();
  const Overlap plan = line.plan();
  EXPECT_EQ(line.phases(), 7u);
  EXPECT_FALSE(plan.joint(0));
  EXPECT_TRUE(plan.joint(1));
  EXPECT_NE(pointer(line, plan, 1, 3, 2), Line::kScale);
  EXPECT_EQ(pointer(line, plan, 1, 3, 2), pointer(line, plan, 4, 3, 2)) << "copied once";
}

TEST(Overlap, WhoElseLooksFindsWhatWasRecorded) {
  Line forces(5, next, 10, 4);
  forces.look_at(Line::kForces, 24 * Line::kElements);
  const Overlap plan = forces.plan();
  EXPECT_EQ(forces.phases(), 7u);
  EXPECT_NE(pointer(forces, plan, 3, 2, 1), Line::kForces);
  EXPECT_EQ(pointer(forces, plan, 6, 2, 1), Line::kForces);
  EXPECT_EQ(pointer(forces, plan, 7, 0, 1), Line::kForces);

  Line states(6, next, 1, 4);
  states.look_at(Line::kStates, 12 * Line::kNodes);
  const Overlap other = states.plan();
  EXPECT_NE(pointer(states, other, 5, 2, 1), Line::kStates);
  EXPECT_EQ(pointer(states, other, 8, 2, 1), Line::kStates);
  EXPECT_EQ(pointer(states, other, 10, 0, 1), Line::kStates);
}

// The same on a device: nodes near one another in three arrays that take turns, and forces that are
// looked at once in the middle.
class Net {
 public:
  static constexpr int64_t kNodes = 1100, kElements = 1500;
  static constexpr int32_t kCorners = 3;
  static constexpr int64_t kFew = 64;
  static constexpr int kSteps = 20;

  Net() {
    Random random(5);
    for (Tensor& t : x_) t = tensor(random.values(kNodes * 3), {kNodes, 3});
    std::vector<int32_t> corners;
    for (int32_t i = 0; i < kElements; ++i)
      for (int32_t c = 0; c < kCorners; ++c)
        corners.push_back(static_cast<int32_t>(i * (kNodes - 12) / kElements) + random.below(12));
    corners_ = table(corners, kCorners);
    incidence_ = nova::make_incidence(corners_.operand(), kNodes);
    std::vector<int32_t> near;
    for (int32_t i = 0; i < kNodes; ++i) near.push_back((i + random.below(50)) % kNodes);
    near_ = table(near);
    scale_ = tensor(random.values(kElements));
    other_scale_ = tensor(random.values(kElements));
    neighbours_ = nova::make_incidence(near_.operand(), kNodes);
    std::vector<int32_t> few;
    for (int32_t i = 0; i < kElements * kCorners; ++i) few.push_back(i % 7);
    few_table_ = table(few, kCorners);
    few_ = nova::make_incidence(few_table_.operand(), kFew);
    for (Tensor& t : each_) t = tensor(random.values(kElements));
  }
  struct Variant {
    bool sum_twice = false;      // once more, over neighbours
    bool stiffen_again = false;  // in the middle
    bool sum_few = false;        // over other rows, of which most have no items
    bool scale_each = false;     // each step has a stiffness of its own
    bool lost_nodes = false;     // elements name nodes that there are none of
  };
  void run(const Variant& variant) const {
    const bool twice = variant.sum_twice;
    Operand gathered = forces_.operand();
    gathered.rows = kElements * kCorners;
    gathered.width = 3;
    launch(stiffen(), kElements, {scale_.operand()}, stiffness_.operand());
    for (int t = 0; t < kSteps; ++t) {
      const Tensor &now = x_[static_cast<size_t>(t % 3)],
                   &then = x_[static_cast<size_t>((t + 1) % 3)];
      Operand nodes = now.operand();
      if (variant.lost_nodes) nodes.rows -= 4;
      const Tensor& stiffness = variant.scale_each ? each_[static_cast<size_t>(t)] : stiffness_;
      launch(element(), kElements, {corners_.operand(), nodes, stiffness.operand()},
             forces_.operand());
      if (variant.sum_few) nova::row_sum(gathered, *few_, nullptr, few_sums_.operand());
      nova::row_sum(gathered, *incidence_, nullptr, sums_.operand());
      if (twice) nova::row_sum(sums_.operand(), *neighbours_, nullptr, again_.operand());
      launch(move(), kNodes, {now.operand(), (twice ? again_ : sums_).operand()}, then.operand());
      if (t == kSteps / 2) nova::submit_copy(seen_.range(), forces_.range());
      if (t == kSteps / 2 && variant.stiffen_again)
        launch(stiffen(), kElements, {other_scale_.operand()}, stiffness_.operand());
    }
  }
  // What elements read at their own rows is something else from now on.
  void change_scale() {
    Random random(6);
    write(scale_, random.values(kElements));
  }
  std::vector<std::vector<float>> values() const {
    return {x_[0].to_host(), x_[1].to_host(), x_[2].to_host(),    forces_.to_host(),
            sums_.to_host(), seen_.to_host(), few_sums_.to_host()};
  }

 private:
  static void launch(const Kernel& kernel, int64_t n, std::vector<Operand> in, Operand out) {
    kernel.launch(n, in, {&out, 1});
  }
  static const Kernel& element() {
    static const Kernel kernel = nova::make_kernel(
        "net_element",
        {{"corners", DType::I32, kCorners, Access::Direct},
         {"x", DType::F32, 3, Access::Indexed},
         {"stiffness", DType::F32, 1, Access::Direct}},
        {{"f", 3 * kCorners}}, [](TraceContext& c) {
          std::vector<Real> f;
          for (int32_t a = 0; a < kCorners; ++a)
            for (int32_t k = 0; k < 3; ++k) {
              Real d = c.f32(1, c.i32(0, (a + 1) % kCorners), k) - c.f32(1, c.i32(0, a), k);
              for (int n = 0; n < 12; ++n) d = d * Real(0.75f) + nova::sin(d) * Real(0.25f);
              f.push_back(d * c.f32(2, 0));
            }
          return f;
        });
    return kernel;
  }
  static const Kernel& stiffen() {
    static const Kernel kernel = nova::make_kernel(
        "net_stiffen", {{"scale", DType::F32, 1, Access::Direct}}, {{"stiffness", 1}},
        [](TraceContext& c) { return std::vector<Real>{c.f32(0, 0) * Real(2.0f)}; });
    return kernel;
  }
  static const Kernel& move() {
    static const Kernel kernel = nova::make_kernel(
        "net_move", {{"x", DType::F32, 3, Access::Direct}, {"f", DType::F32, 3, Access::Direct}},
        {{"y", 3}}, [](TraceContext& c) {
          std::vector<Real> y;
          for (int32_t k = 0; k < 3; ++k) y.push_back(c.f32(0, k) + c.f32(1, k) * Real(0.05f));
          return y;
        });
    return kernel;
  }

  std::array<Tensor, 3> x_;
  Tensor corners_, near_, scale_, other_scale_;
  nova::Incidence incidence_, neighbours_, few_;
  Tensor few_table_;
  std::array<Tensor, kSteps> each_;
  Tensor few_sums_ = tensor(std::vector<float>(kFew * 3), {kFew, 3});
  Tensor forces_ = tensor(std::vector<float>(kElements * 9), {kElements, 9});
  Tensor sums_ = tensor(std::vector<float>(kNodes * 3), {kNodes, 3});
  Tensor again_ = tensor(std::vector<float>(kNodes * 3), {kNodes, 3});
  Tensor stiffness_ = tensor(std::vector<float>(kElements));
  Tensor seen_ = tensor(std::vector<float>(kElements * 9), {kElements, 9});
};

TEST(Overlap, AReplayHasTheBitsOfRunningAsWritten) {
  struct Case {
    int threads;
    Net::Variant variant = {};
  };
  for (const auto& [threads, variant] :
       {Case{2}, Case{5}, Case{7}, Case{16}, Case{5, {.sum_twice = true}},
        Case{16, {.sum_twice = true}}, Case{5, {.stiffen_again = true}}, Case{5, {.sum_few = true}},
        Case{7, {.scale_each = true}}}) {
    const Threads scope(threads);
    Net direct, replayed;
    direct.run(variant);
    direct.change_scale();
    direct.run(variant);
    std::shared_ptr<OpList> graph;
    {
      const nova::ScopedCapture capture;
      replayed.run(variant);
      graph = capture.graph();
    }
    graph->prepare();
    graph->launch();
    replayed.change_scale();
    graph->launch();
    const auto expected = direct.values(), got = replayed.values();
    EXPECT_NE(expected[0], Net().values()[0]);
    for (size_t k = 0; k < expected.size(); ++k)
      EXPECT_TRUE(same_bits<float>(got[k], expected[k])) << threads << " threads, array " << k;
  }
}

TEST(Overlap, AnErrorNamesTheElementThatWasRecorded) {
  if (!device_context(tensor({0.0f}).range()->storage().device()).host_accessible)
    GTEST_SKIP() << "a device reports failures when the host waits for it next";
  const Threads scope(5);
  const Net direct, replayed;
  const Net::Variant lost{.lost_nodes = true};
  const auto message = [](const auto& call) {
    try {
      call();
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("nothing");
  };
  const std::string expected = message([&] { direct.run(lost); });
  EXPECT_NE(expected.find("row 1096"), std::string::npos) << expected;
  std::shared_ptr<OpList> graph;
  {
    const nova::ScopedCapture capture;
    replayed.run(lost);
    graph = capture.graph();
  }
  graph->prepare();
  EXPECT_EQ(message([&] { graph->launch(); }), expected);
}

}  // namespace
}  // namespace novaphy::testing
