// Persistent kernels whose blocks compute all rows that their own sums need: the rows of each
// block. The results equal those of the same persistent kernel without this option.
#include <cmath>
#include <numeric>
#include <set>

#include "mesh_persistent.h"

namespace novaphy::gpu {
namespace {

using PersistentBlocks = MeshPersistent;

TEST_F(PersistentBlocks, HaveTheBitsOfOneExchangePerPhase) {
  Mesh plain;
  const RecordedPersistent forth = forward(plain), back = backward(plain);
  run_plain(forth);
  const std::vector<float> moved = plain.forces;
  run_plain(back);
  for (uint32_t seed = 1; seed <= 4; ++seed) {
    const bool halo = seed > 2;
    Mesh mesh;
    run_planned(forward(mesh), seed, false, halo);
    for (uint32_t s = 0; s <= Mesh::kSubsteps; ++s) expect_same(mesh.states[s], plain.states[s]);
    expect_same(mesh.forces, moved);
    // The early halves of the way back are computed early.
    run_planned(backward(mesh), seed, true, halo);
    expect_same(mesh.forces, plain.forces);
    for (uint32_t k = 0; k < 2; ++k) expect_same(mesh.kinds[k].made, plain.kinds[k].made);
    EXPECT_TRUE(std::isfinite(std::accumulate(mesh.forces.begin(), mesh.forces.end(), 0.0f)));
  }
}

TEST_F(PersistentBlocks, OtherOperationsMayComeBetweenSums) {
  // Points move by the forces of springs, and then by those of triangles.
  const auto recorded = [&](Mesh& mesh) {
    RecordedPersistent to;
    for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
      const uint64_t at = word(mesh.states[s].data()), moved = word(mesh.states[s + 1].data());
      record_elements(to, 2 * s, mesh, pulls_, at, nullptr);
      record_sums(to, 2 * s + 1, mesh);
      to.launch(to.add(2 * s + 1, 0, kPoints, kPoints), move_,
                {at, kPoints, word(mesh.forces.data()), kPoints, moved});
      std::swap(to.ops.back(), to.ops[to.ops.size() - 2]);
      (*to.words[to.words.size() - 2])[0] = (*to.words[to.words.size() - 2])[4] = moved;
    }
    return to;
  };
  Mesh plain;
  run_plain(recorded(plain));
  for (const bool halo : {false, true}) {
    Mesh mesh;
    run_planned(recorded(mesh), 1, false, halo);
    for (uint32_t s = 0; s <= Mesh::kSubsteps; ++s) expect_same(mesh.states[s], plain.states[s]);
  }
}

TEST_F(PersistentBlocks, ThreadsKeepWordsOfTheRowsThatTheyHaveInAPhase) {
  // Points and their mirror images take turns in adding the results of the same elements. The owner
  // of an element therefore changes.
  const auto recorded = [&](Mesh& mesh, std::array<Kind, 2>& mirrored) {
    RecordedPersistent to = forward(mesh);
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

TEST_F(PersistentBlocks, AFailingReadIsReportedWhereverNobodyStores) {
  // In a phase whose items are overwritten, a point is missing.
  Mesh mesh;
  RecordedPersistent failing = forward(mesh);
  constexpr size_t kInAPhasePair = 5, kRowsOfState = 3;
  (*failing.words[kInAPhasePair])[kRowsOfState] = kPoints - 1;
  ASSERT_EQ(failing.ops[kInAPhasePair].phase, 2u);
  EXPECT_FALSE(plan_with_halo(failing));
  const std::optional<BlockPlan> made = plan(failing);
  ASSERT_TRUE(made);
  PersistentTable table = planned(failing, *made);
  HostPersistent planned_persistent(table, {Form::Cluster, kBlocks, made->threads, 1});
  EXPECT_FALSE(planned_persistent.run(1));
  EXPECT_TRUE(planned_persistent.compiles());
}

TEST_F(PersistentBlocks, ABlockHasAllRowsThatItsSumsNeed) {
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

TEST_F(PersistentBlocks, ItemsThatOthersNeedStayInMemory) {
  Mesh mesh;
  ASSERT_TRUE(plan(forward(mesh)));
  // Another operation reads the elements' results at the end.
  RecordedPersistent read = forward(mesh);
  std::vector<float> copy(3 * kPoints);
  novaphy_persistent_op& o = read.add(2 * Mesh::kSubsteps, 0, kPoints, kPoints);
  o.op.target = copy.data();
  o.op.source = mesh.kinds[0].made.data();
  EXPECT_FALSE(plan(read));
  // Another operation writes the elements' results.
  RecordedPersistent written = forward(mesh);
  written.add(2 * Mesh::kSubsteps, 0, 1, 1).op.target = mesh.kinds[1].made.data();
  EXPECT_FALSE(plan(written));
  // An element reads results of elements in its own phase.
  RecordedPersistent own = forward(mesh);
  std::vector<uint64_t> words(own.ops[0].op.arguments, own.ops[0].op.arguments + 7);
  words[4] = words[6];
  own.ops[0].op.arguments = words.data();
  EXPECT_FALSE(plan(own));
}

TEST_F(PersistentBlocks, AChainLoadsOneListOfItemsForEachTable) {
  // Triangles twice, over the same table: their threads, and so their items, are others.
  Mesh mesh;
  std::vector<float> again(mesh.kinds[1].made.size());
  RecordedPersistent twice;
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

TEST_F(PersistentBlocks, NobodyComputesMostRowsTwice) {
  // Elements with distant corners: a block would need nearly all of them.
  Mesh mesh;
  std::vector<int32_t> index;
  std::mt19937 random(5);
  for (int32_t e = 0; e < 400; ++e)
    for (int32_t k = 0; k < 3; ++k) index.push_back(static_cast<int32_t>(random() % kPoints));
  mesh.kinds[0] = Kind(2, {0, 1});
  mesh.kinds[1] = Kind(3, index);
  EXPECT_FALSE(plan(forward(mesh)));
}

TEST_F(PersistentBlocks, WhatFitsNoMemoryIsNotComputedAhead) {
  Mesh mesh;
  const RecordedPersistent back = backward(mesh);
  const std::optional<BlockPlan> made = plan(back);
  ASSERT_TRUE(made);
  const PersistentTable ahead = planned(back, *made);
  EXPECT_NE(ahead.job_count, 0u);
  PersistentCapacity capacity{kBlocks * made->threads / 32, 200, kBlocks, 1, &*made,
                              ahead.early_bytes - 1};
  EXPECT_EQ(persistent_table(back.ops, capacity).job_count, 0u);
}

}  // namespace
}  // namespace novaphy::gpu
