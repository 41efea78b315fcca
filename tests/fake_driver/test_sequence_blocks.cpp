// Sequences whose blocks compute all that their own sums need: which rows these are, and that the
// results are those of the same sequence without it.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <numeric>
#include <random>
#include <set>

#include "novaphy/nova/kernel.h"
#include "sequence_blocks.h"
#include "sequence_kernels.h"
#include "sequence_on_host.h"

namespace novaphy::gpu {
namespace {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::TraceContext;
using Form = SequenceShape::Form;

constexpr int32_t kSide = 12, kPoints = kSide * kSide;
constexpr uint32_t kBlocks = 4, kMostWarps = 12;

// Elements that pull at their corners, as rows of indices.
struct Kind {
  int32_t corners = 0;
  std::vector<int32_t> index, offsets, items;
  std::vector<float> rest, made;

  Kind(int32_t of_element, std::vector<int32_t> indices)
      : corners(of_element), index(std::move(indices)), offsets(kPoints + 1) {
    for (int32_t point = 0; point < kPoints; ++point) {
      for (size_t k = 0; k < index.size(); ++k)
        if (index[k] == point) items.push_back(static_cast<int32_t>(k));
      offsets[static_cast<size_t>(point) + 1] = static_cast<int32_t>(items.size());
    }
    for (int32_t e = 0; e < rows(); ++e) rest.push_back(0.5f + 0.01f * static_cast<float>(e % 7));
    made.resize(index.size() * 3);
  }
  int32_t rows() const { return static_cast<int32_t>(index.size()) / corners; }
};

// A grid of points with springs along its edges and triangles in its cells, over some substeps;
// then points pull the other way, and elements read states that nobody writes any more.
struct Mesh {
  static constexpr uint32_t kSubsteps = 5;
  std::vector<Kind> kinds;
  std::array<std::vector<float>, kSubsteps + 1> states;
  std::vector<float> forces, start;

  Mesh() {
    std::vector<int32_t> springs, triangles;
    const auto point = [](int32_t x, int32_t y) { return y * kSide + x; };
    for (int32_t y = 0; y < kSide; ++y)
      for (int32_t x = 0; x < kSide; ++x) {
        if (x + 1 < kSide) springs.insert(springs.end(), {point(x, y), point(x + 1, y)});
        if (y + 1 < kSide) springs.insert(springs.end(), {point(x, y), point(x, y + 1)});
        if (x + 1 < kSide && y + 1 < kSide)
          triangles.insert(triangles.end(), {point(x, y), point(x + 1, y), point(x, y + 1)});
      }
    // One point has more items than a batch.
    for (int32_t k = 0; k < 9; ++k)
      springs.insert(springs.end(), {point(5, 5), point(5 + k % 3, 6)});
    kinds.emplace_back(2, springs);
    kinds.emplace_back(3, triangles);
    std::mt19937 random(3);
    std::uniform_real_distribution<float> value(-1.0f, 1.0f);
    for (auto& state : states) state.resize(3 * kPoints);
    for (float& x : states[0]) x = value(random);
    forces.resize(3 * kPoints);
    start.resize(3 * kPoints, 0.125f);
  }
};

// rest * (sum of the other corners - own corner), of two or three corners.
novaphy_kernel pull_kernel(int32_t corners) {
  return traced(nova::make_kernel("pull" + std::to_string(corners),
                                  {{"index", DType::I32, corners, Access::Direct},
                                   {"at", DType::F32, 3, Access::Indexed},
                                   {"rest", DType::F32, 1, Access::Direct}},
                                  {{"item", 3 * corners}}, [corners](TraceContext& t) {
                                    std::vector<Real> item;
                                    for (int32_t k = 0; k < corners; ++k)
                                      for (int32_t c = 0; c < 3; ++c) {
                                        Real sum = t.f32(1, t.i32(0, (k + 1) % corners), c);
                                        for (int32_t j = 2; j < corners; ++j)
                                          sum = sum + t.f32(1, t.i32(0, (k + j) % corners), c);
                                        item.push_back(t.f32(2) * (sum - t.f32(1, t.i32(0, k), c)));
                                      }
                                    return item;
                                  }));
}
// What a state says, slowly, times what comes back to the corners.
novaphy_kernel back_kernel(int32_t corners) {
  return traced(nova::make_kernel("back" + std::to_string(corners),
                                  {{"index", DType::I32, corners, Access::Direct},
                                   {"at", DType::F32, 3, Access::Indexed},
                                   {"force", DType::F32, 3, Access::Indexed}},
                                  {{"item", 3 * corners}}, [corners](TraceContext& t) {
                                    Real far = t.f32(1, t.i32(0, 0), 0);
                                    for (int32_t k = 0; k < corners; ++k)
                                      for (int32_t c = 0; c < 3; ++c) {
                                        const Real x = t.f32(1, t.i32(0, k), c);
                                        far = far + x / (x * x + far * far + Real(1.0f));
                                      }
                                    std::vector<Real> item;
                                    for (int32_t k = 0; k < corners; ++k)
                                      for (int32_t c = 0; c < 3; ++c)
                                        item.push_back(far *
                                                       t.f32(2, t.i32(0, (k + 1) % corners), c));
                                    return item;
                                  }));
}
novaphy_kernel move_kernel() {
  return traced(nova::make_kernel(
      "move", {{"at", DType::F32, 3, Access::Direct}, {"force", DType::F32, 3, Access::Direct}},
      {{"to", 3}}, [](TraceContext& t) {
        std::vector<Real> to;
        for (int32_t c = 0; c < 3; ++c) to.push_back(t.f32(0, c) + Real(0.03125f) * t.f32(1, c));
        return to;
      }));
}

uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }

class SequenceBlocks : public testing::Test {
 protected:
  SequenceBlocks() {
    for (const int32_t corners : {2, 3}) {
      pulls_.push_back(pull_kernel(corners));
      backs_.push_back(back_kernel(corners));
    }
  }
  // Elements read a state, and forces on points or, without them, rest values of their own.
  static void record_elements(RecordedSequence& to, uint32_t phase, Mesh& mesh,
                              std::vector<novaphy_kernel>& kernels, uint64_t at,
                              const float* forces) {
    for (uint32_t k = 0; k < 2; ++k) {
      Kind& kind = mesh.kinds[k];
      const auto rows = static_cast<uint64_t>(kind.rows());
      to.launch(
          to.add(phase, k, kind.rows(), kind.rows()), kernels[k],
          {word(kind.index.data()), rows, at, kPoints, word(forces ? forces : kind.rest.data()),
           forces ? kPoints : rows, word(kind.made.data())});
    }
  }
  // Forces of one kind are added by the builtin, those of the other by a Program.
  void record_sums(RecordedSequence& to, uint32_t phase, Mesh& mesh) {
    Kind &springs = mesh.kinds[0], &triangles = mesh.kinds[1];
    to.launch(to.add(phase, 0, kPoints, kPoints), sum_,
              {word(springs.made.data()), word(springs.offsets.data()), word(springs.items.data()),
               word(mesh.start.data()), word(mesh.forces.data()), 3, 0});
    to.ops.back().source_bytes = springs.made.size() * sizeof(float);
    to.launch(
        to.add(phase, 0, kPoints, kPoints), collect_,
        {word(mesh.forces.data()), kPoints, word(triangles.made.data()), triangles.made.size() / 3,
         word(mesh.forces.data()), word(triangles.offsets.data()), word(triangles.items.data())});
  }
  RecordedSequence forward(Mesh& mesh) {
    RecordedSequence to;
    for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
      const uint64_t at = word(mesh.states[s].data());
      record_elements(to, 2 * s, mesh, pulls_, at, nullptr);
      record_sums(to, 2 * s + 1, mesh);
      to.launch(to.add(2 * s + 1, 0, kPoints, kPoints), move_,
                {at, kPoints, word(mesh.forces.data()), kPoints, word(mesh.states[s + 1].data())});
    }
    return to;
  }
  RecordedSequence backward(Mesh& mesh) {
    RecordedSequence to;
    for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
      record_elements(to, 2 * s, mesh, backs_, word(mesh.states[Mesh::kSubsteps - s].data()),
                      mesh.forces.data());
      record_sums(to, 2 * s + 1, mesh);
    }
    return to;
  }
  static std::vector<int32_t> read(uint64_t where, size_t count) {
    const auto* const words = reinterpret_cast<const int32_t*>(where);
    return {words, words + count};
  }
  static std::optional<BlockPlan> plan(const RecordedSequence& sequence) {
    return plan_blocks(sequence.ops, kBlocks, kMostWarps, read);
  }
  static std::optional<BlockPlan> plan_with_halo(const RecordedSequence& sequence) {
    std::optional<BlockPlan> made = plan(sequence);
    if (made && !plan_halo(sequence.ops, kBlocks, read, *made)) made.reset();
    return made;
  }
  static void run_plain(const RecordedSequence& sequence) {
    const SequenceShape shape{Form::Grid, 3, 64};
    SequenceTable table = sequence_table(sequence.ops);
    EXPECT_TRUE(HostSequence(table, shape).run(1));
  }
  static SequenceTable planned(const RecordedSequence& sequence, const BlockPlan& plan) {
    return sequence_table(sequence.ops,
                          {kBlocks * plan.threads / 32, 200, kBlocks, 1, &plan, 1 << 20});
  }
  static void run_planned(const RecordedSequence& sequence, uint32_t seed, bool ahead, bool halo) {
    const std::optional<BlockPlan> made = halo ? plan_with_halo(sequence) : plan(sequence);
    ASSERT_TRUE(made);
    SequenceTable table = planned(sequence, *made);
    ASSERT_TRUE(table.fits);
    EXPECT_NE(table.layouts, 0u);
    EXPECT_EQ(table.halo_rows != 0, halo);
    EXPECT_EQ(table.job_count != 0, ahead);
    EXPECT_TRUE(HostSequence(table, {Form::Cluster, kBlocks, made->threads, 1}).run(seed));
  }
  static void expect_same(const std::vector<float>& a, const std::vector<float>& b) {
    EXPECT_EQ(0, std::memcmp(a.data(), b.data(), a.size() * sizeof(float)));
  }

  std::vector<novaphy_kernel> pulls_, backs_;
  novaphy_kernel move_ = move_kernel(), sum_ = row_sum_kernel(), collect_ = collect_kernel();
};

TEST_F(SequenceBlocks, HaveTheBitsOfOneExchangePerPhase) {
  Mesh plain;
  const RecordedSequence forth = forward(plain), back = backward(plain);
  run_plain(forth);
  const std::vector<float> moved = plain.forces;
  run_plain(back);
  for (uint32_t seed = 1; seed <= 4; ++seed) {
    const bool halo = seed > 2;
    Mesh mesh;
    run_planned(forward(mesh), seed, false, halo);
    for (uint32_t s = 0; s <= Mesh::kSubsteps; ++s) expect_same(mesh.states[s], plain.states[s]);
    expect_same(mesh.forces, moved);
    // The early halves of the way back are computed ahead.
    run_planned(backward(mesh), seed, true, halo);
    expect_same(mesh.forces, plain.forces);
    for (uint32_t k = 0; k < 2; ++k) expect_same(mesh.kinds[k].made, plain.kinds[k].made);
    EXPECT_TRUE(std::isfinite(std::accumulate(mesh.forces.begin(), mesh.forces.end(), 0.0f)));
  }
}

TEST_F(SequenceBlocks, ThreadsKeepWordsOfTheRowsThatTheyHaveInAPhase) {
  // Points, and their mirror images in turns, add what the same elements leave: who has which
  // element changes.
  const auto recorded = [&](Mesh& mesh, std::array<Kind, 2>& mirrored) {
    RecordedSequence to = forward(mesh);
    for (size_t k = 0; k < to.ops.size(); ++k) {
      if (to.ops[k].phase / 2 % 2 == 0) continue;
      std::vector<uint64_t>& words = *to.words[k];
      for (uint32_t kind = 0; kind < 2; ++kind)
        for (uint64_t& at : words) {
          if (at == word(mesh.kinds[kind].made.data())) at = word(mirrored[kind].made.data());
          if (at == word(mesh.kinds[kind].offsets.data())) at = word(mirrored[kind].offsets.data());
          if (at == word(mesh.kinds[kind].items.data())) at = word(mirrored[kind].items.data());
        }
    }
    return to;
  };
  const auto mirror = [](const Kind& kind) {
    std::vector<int32_t> index;
    for (const int32_t point : kind.index) index.push_back(kPoints - 1 - point);
    return Kind(kind.corners, index);
  };
  Mesh plain, mesh;
  std::array<Kind, 2> other = {mirror(plain.kinds[0]), mirror(plain.kinds[1])}, mine = other;
  run_plain(recorded(plain, other));
  run_planned(recorded(mesh, mine), 4, false, false);
  for (uint32_t s = 0; s <= Mesh::kSubsteps; ++s) expect_same(mesh.states[s], plain.states[s]);
}

TEST_F(SequenceBlocks, AFailingReadIsReportedWhereverNobodyStores) {
  // In a phase whose items are overwritten, a point is missing.
  Mesh mesh;
  RecordedSequence failing = forward(mesh);
  constexpr size_t kInAPhasePair = 5, kRowsOfState = 3;
  (*failing.words[kInAPhasePair])[kRowsOfState] = kPoints - 1;
  ASSERT_EQ(failing.ops[kInAPhasePair].phase, 2u);
  EXPECT_FALSE(plan_with_halo(failing));
  const std::optional<BlockPlan> made = plan(failing);
  ASSERT_TRUE(made);
  SequenceTable table = planned(failing, *made);
  HostSequence planned_sequence(table, {Form::Cluster, kBlocks, made->threads, 1});
  EXPECT_FALSE(planned_sequence.run(1));
  EXPECT_TRUE(planned_sequence.compiles());
}

TEST_F(SequenceBlocks, ABlockHasAllRowsThatItsSumsNeed) {
  Mesh mesh;
  const std::optional<BlockPlan> made = plan(forward(mesh));
  ASSERT_TRUE(made);
  const auto rows_of = [&](uint32_t phase, uint32_t chain, uint32_t block, bool owned) {
    std::set<int32_t> rows;
    const BlockPlan::Phase& p = made->phases[phase];
    const BlockPlan::Chain& c = p.chains[chain];
    for (uint32_t t = 32 * c.first_warp; t < 32 * (c.first_warp + c.warps); ++t) {
      const uint32_t w = made->layouts[p.layout][block * made->threads + t];
      if ((w & BlockPlan::kOn) == 0 || (owned && (w & BlockPlan::kOwns) == 0)) continue;
      EXPECT_TRUE(rows.insert(static_cast<int32_t>(w & (BlockPlan::kOn - 1))).second);
    }
    return rows;
  };
  std::vector<int> summed(kPoints, 0);
  size_t computed = 0, of_kinds = 0;
  for (uint32_t k = 0; k < 2; ++k) {
    const Kind& kind = mesh.kinds[k];
    std::vector<int> owned(static_cast<size_t>(kind.rows()), 0);
    of_kinds += owned.size();
    for (uint32_t block = 0; block < kBlocks; ++block) {
      const std::set<int32_t> rows = rows_of(0, k, block, false);
      computed += rows.size();
      for (const int32_t row : rows_of(0, k, block, true)) ++owned[static_cast<size_t>(row)];
      for (const int32_t point : rows_of(1, 0, block, true)) {
        if (k == 0) ++summed[static_cast<size_t>(point)];
        for (int32_t i = kind.offsets[point]; i < kind.offsets[point + 1]; ++i)
          EXPECT_TRUE(rows.contains(kind.items[i] / kind.corners)) << point;
      }
    }
    EXPECT_EQ(owned, std::vector<int>(owned.size(), 1));
  }
  EXPECT_EQ(summed, std::vector<int>(kPoints, 1));
  EXPECT_GT(computed, of_kinds);
  EXPECT_LT(computed, of_kinds * 3 / 2);  // compact parts: 36 points have 24 at their border
  EXPECT_FALSE(made->phases[0].sums_items);
  EXPECT_TRUE(made->phases[0].makes_items);
  EXPECT_TRUE(made->phases[1].sums_items);
  // All write to the same memory: only the last ones have to.
  EXPECT_FALSE(made->phases[0].chains[0].keeps);
  EXPECT_TRUE(made->phases[2 * Mesh::kSubsteps - 2].chains[0].keeps);
}

TEST_F(SequenceBlocks, RowsGoToTheBlocksThatReadThem) {
  Mesh mesh;
  const std::optional<BlockPlan> made = plan_with_halo(forward(mesh));
  ASSERT_TRUE(made);
  const auto for_each = [&](uint32_t phase, uint32_t chain, const auto& f) {
    const BlockPlan::Phase& p = made->phases[phase];
    const BlockPlan::Chain& c = p.chains[chain];
    for (uint32_t block = 0; block < kBlocks; ++block)
      for (uint32_t t = 32 * c.first_warp; t < 32 * (c.first_warp + c.warps); ++t) {
        const uint32_t w = made->layouts[p.layout][block * made->threads + t];
        if ((w & BlockPlan::kOn) != 0) f(block, t, static_cast<int32_t>(w & (BlockPlan::kOn - 1)));
      }
  };
  // Blocks with elements at a point.
  std::set<std::pair<int32_t, uint32_t>> needed, sent;
  for (uint32_t k = 0; k < 2; ++k) {
    const Kind& kind = mesh.kinds[k];
    for_each(2, k, [&](uint32_t block, uint32_t, int32_t row) {
      for (int32_t c = 0; c < kind.corners; ++c)
        needed.insert({kind.index[static_cast<size_t>(row * kind.corners + c)], block});
    });
  }
  std::map<std::pair<uint32_t, uint32_t>, int32_t> row_of;  // block, thread
  for_each(1, 0, [&](uint32_t block, uint32_t t, int32_t row) { row_of[{block, t}] = row; });
  const BlockPlan::Halo& halo = made->halo;
  const uint32_t first = made->maker_warps * 32, threads = made->threads - first;
  ASSERT_EQ(halo.sends.size(), size_t{kBlocks} * halo.rounds * threads);
  std::vector<uint32_t> bytes(kBlocks, 0);
  for (uint32_t k = 0; k < halo.sends.size(); ++k) {
    if ((halo.sends[k] & BlockPlan::Halo::kSends) == 0) continue;
    const uint32_t block = k / threads / halo.rounds, lane = halo.sends[k] >> 24 & 31;
    const uint32_t to = halo.sends[k] >> 16 & 31, thread = first + k % threads / 32 * 32 + lane;
    const auto row = static_cast<int32_t>(halo.sends[k] & 0xffff);
    EXPECT_EQ((row_of.at({block, thread})), row);
    EXPECT_TRUE(sent.insert({row, to}).second);
    bytes[to] += 16;
  }
  EXPECT_EQ(sent, needed);
  EXPECT_EQ(halo.bytes, bytes);
  EXPECT_EQ(halo.rows, kPoints + 1u);
  EXPECT_EQ(halo.turns, Mesh::kSubsteps);
  // The first state comes from memory; no other is read there by another block.
  for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
    EXPECT_EQ(made->phases[2 * s].fills.size(), s == 0 ? 1u : 0u);
    EXPECT_EQ(made->phases[2 * s].turns, s);
    EXPECT_TRUE(made->phases[2 * s].joined);
    EXPECT_FALSE(made->phases[2 * s + 1].joined);
    EXPECT_TRUE(made->phases[2 * s + 1].sends);
    EXPECT_FALSE(made->phases[2 * s + 1].fences);
  }
}

TEST_F(SequenceBlocks, WhatOthersReadFromMemoryIsThereBeforeTheyDo) {
  // A copy of a state, word by word, which no plan gives to the blocks of the points.
  Mesh plain, mesh;
  std::vector<float> copy(3 * kPoints);
  constexpr uint32_t kState = 3;
  const auto recorded = [&](Mesh& of) {
    RecordedSequence to = forward(of);
    novaphy_sequence_op& o = to.add(2 * Mesh::kSubsteps, 0, 3 * kPoints, 3 * kPoints);
    o.op.target = copy.data();
    o.op.source = of.states[kState].data();
    return to;
  };
  const std::optional<BlockPlan> made = plan_with_halo(recorded(mesh));
  ASSERT_TRUE(made);
  for (uint32_t s = 0; s < Mesh::kSubsteps; ++s)
    EXPECT_EQ(made->phases[2 * s + 1].fences, s + 1 == kState) << s;
  run_plain(recorded(plain));
  run_planned(recorded(mesh), 5, false, true);
  expect_same(copy, plain.states[kState]);
}

TEST_F(SequenceBlocks, AHaloNeedsToKnowWhoReadsWhat) {
  Mesh mesh;
  ASSERT_TRUE(plan_with_halo(forward(mesh)));
  // An index outside would have to be reported.
  mesh.kinds[0].index[7] = kPoints;
  EXPECT_FALSE(plan_with_halo(forward(mesh)));
  mesh.kinds[0].index[7] = -1;  // reads zeros
  EXPECT_TRUE(plan_with_halo(forward(mesh)));
  // Somebody writes indices.
  RecordedSequence written = forward(mesh);
  written.add(2 * Mesh::kSubsteps - 1, 1, 1, 1).op.target = mesh.kinds[1].index.data();
  EXPECT_FALSE(plan_with_halo(written));
}

TEST_F(SequenceBlocks, ItemsThatOthersNeedStayInMemory) {
  Mesh mesh;
  ASSERT_TRUE(plan(forward(mesh)));
  // Somebody reads them at the end.
  RecordedSequence read = forward(mesh);
  std::vector<float> copy(3 * kPoints);
  novaphy_sequence_op& o = read.add(2 * Mesh::kSubsteps, 0, kPoints, kPoints);
  o.op.target = copy.data();
  o.op.source = mesh.kinds[0].made.data();
  EXPECT_FALSE(plan(read));
  // Somebody else writes them.
  RecordedSequence written = forward(mesh);
  written.add(2 * Mesh::kSubsteps, 0, 1, 1).op.target = mesh.kinds[1].made.data();
  EXPECT_FALSE(plan(written));
  // An element reads what elements of its phase write.
  RecordedSequence own = forward(mesh);
  std::vector<uint64_t> words(own.ops[0].op.arguments, own.ops[0].op.arguments + 7);
  words[4] = words[6];
  own.ops[0].op.arguments = words.data();
  EXPECT_FALSE(plan(own));
}

TEST_F(SequenceBlocks, AChainLoadsOneListOfItemsForEachTable) {
  // Triangles twice, over the same table: their threads, and so their items, are others.
  Mesh mesh;
  std::vector<float> again(mesh.kinds[1].made.size());
  RecordedSequence twice;
  Kind& kind = mesh.kinds[1];
  const auto rows = static_cast<uint64_t>(kind.rows());
  for (uint32_t k = 0; k < 2; ++k)
    twice.launch(twice.add(0, k, kind.rows(), kind.rows()), pulls_[1],
                 {word(kind.index.data()), rows, word(mesh.states[0].data()), kPoints,
                  word(kind.rest.data()), rows, word(k == 0 ? kind.made.data() : again.data())});
  for (uint32_t k = 0; k < 2; ++k) {
    twice.launch(twice.add(1, 0, kPoints, kPoints), sum_,
                 {word(k == 0 ? kind.made.data() : again.data()), word(kind.offsets.data()),
                  word(kind.items.data()), word(k == 0 ? mesh.start.data() : mesh.forces.data()),
                  word(mesh.forces.data()), 3, 0});
    twice.ops.back().source_bytes = again.size() * sizeof(float);
  }
  EXPECT_FALSE(plan(twice));
}

TEST_F(SequenceBlocks, NobodyComputesMostRowsTwice) {
  // Elements of far corners: a block would need nearly all of them.
  Mesh mesh;
  std::vector<int32_t> index;
  std::mt19937 random(5);
  for (int32_t e = 0; e < 400; ++e)
    for (int32_t k = 0; k < 3; ++k) index.push_back(static_cast<int32_t>(random() % kPoints));
  mesh.kinds[0] = Kind(2, {0, 1});
  mesh.kinds[1] = Kind(3, index);
  EXPECT_FALSE(plan(forward(mesh)));
}

TEST_F(SequenceBlocks, WhatFitsNoMemoryIsNotComputedAhead) {
  Mesh mesh;
  const RecordedSequence back = backward(mesh);
  const std::optional<BlockPlan> made = plan(back);
  ASSERT_TRUE(made);
  const SequenceTable ahead = planned(back, *made);
  EXPECT_NE(ahead.job_count, 0u);
  SequenceRoom room{kBlocks * made->threads / 32, 200, kBlocks, 1, &*made, ahead.ahead_bytes - 1};
  EXPECT_EQ(sequence_table(back.ops, room).job_count, 0u);
}

}  // namespace
}  // namespace novaphy::gpu
