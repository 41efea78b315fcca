// Sums of a persistent kernel send rows to the blocks whose elements read them: which rows are
// sent, and which results stay in memory for other blocks. test_persistent_blocks.cpp compares the
// results.
#include <map>
#include <set>

#include "mesh_persistent.h"

namespace novaphy::gpu {
namespace {

using PersistentHalo = MeshPersistent;
constexpr uint32_t kAfter = 2 * Mesh::kSubsteps;  // the first phase after those of forward()

TEST_F(PersistentHalo, RowsGoToTheBlocksThatReadThem) {
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

TEST_F(PersistentHalo, WhatOthersReadFromMemoryIsThereBeforeTheyDo) {
  // A copy of a state, word by word. No plan gives these words to the blocks of the points.
  Mesh plain, mesh;
  std::vector<float> copy(3 * kPoints);
  constexpr uint32_t kState = 3;
  const auto recorded = [&](Mesh& of) {
    RecordedPersistent to = forward(of);
    novaphy_persistent_op& o = to.add(2 * Mesh::kSubsteps, 0, 3 * kPoints, 3 * kPoints);
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

TEST_F(PersistentHalo, AHaloNeedsToKnowWhoReadsWhat) {
  Mesh mesh;
  ASSERT_TRUE(plan_with_halo(forward(mesh)));
  // An index outside would have to be reported.
  mesh.kinds[0].index[7] = kPoints;
  EXPECT_FALSE(plan_with_halo(forward(mesh)));
  mesh.kinds[0].index[7] = -1;  // reads zeros
  EXPECT_TRUE(plan_with_halo(forward(mesh)));
  // Another operation writes indices.
  RecordedPersistent written = forward(mesh);
  written.add(2 * Mesh::kSubsteps - 1, 1, 1, 1).op.target = mesh.kinds[1].index.data();
  EXPECT_FALSE(plan_with_halo(written));
}

TEST_F(PersistentHalo, IndicesAreThoseThatTheSumsKnow) {
  // Another index than that of the element's corner, in the phase that is filled and in another
  // one.
  for (const size_t element_op : {0, 5}) {
    Mesh mesh;
    std::vector<int32_t> other = mesh.kinds[0].index;
    std::swap(other[0], other[7]);
    RecordedPersistent to = forward(mesh);
    (*to.words[element_op])[0] = word(other.data());
    EXPECT_TRUE(plan(to));
    EXPECT_FALSE(plan_with_halo(to)) << element_op;
  }
}

TEST_F(PersistentHalo, StoresOfOthersWaitForOneAnother) {
  Mesh mesh;
  std::vector<float> copy(3 * kPoints);
  float* const last = mesh.states[Mesh::kSubsteps].data();
  const auto fences = [&](const RecordedPersistent& of) {
    const std::optional<BlockPlan> made = plan_with_halo(of);
    return made && made->phases[kAfter - 1].sends && made->phases[kAfter - 1].fences;
  };
  EXPECT_FALSE(fences(forward(mesh)));
  // The owners of the words overwrite the words of the rows.
  RecordedPersistent over = forward(mesh);
  over.add(kAfter, 0, 3 * kPoints, 3 * kPoints).op.target = last;
  EXPECT_TRUE(fences(over));
  // A few words are overwritten, and then all are read.
  RecordedPersistent few = forward(mesh);
  few.add(kAfter, 0, 4, 4).op.target = last;
  novaphy_persistent_op& o = few.add(kAfter + 1, 0, 3 * kPoints, 3 * kPoints);
  o.op.target = copy.data();
  o.op.source = last;
  EXPECT_TRUE(fences(few));
  // Three rows of a word are read as one row of three, which has the number of the first.
  RecordedPersistent shape = forward(mesh, [&](RecordedPersistent& to, uint32_t s) {
    to.add(2 * s + 1, 1, 3, 3).op.target = copy.data();
  });
  shape.launch(shape.add(kAfter, 0, 1, 1), move_,
               {word(copy.data()), 1, word(mesh.start.data()), 1, word(copy.data() + 6)});
  EXPECT_TRUE(fences(shape));
}

TEST_F(PersistentHalo, ARowIsSentOnce) {
  // States in two places, from which elements read in turns.
  Mesh mesh;
  auto other = mesh.states;
  RecordedPersistent twice;
  for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
    const uint64_t at = word((s % 2 != 0 ? other : mesh.states)[s].data());
    record_elements(twice, 2 * s, mesh, pulls_, at, nullptr);
    record_sums(twice, 2 * s + 1, mesh);
    for (auto* states : {&mesh.states, &other})
      twice.launch(twice.add(2 * s + 1, 0, kPoints, kPoints), move_,
                   {at, kPoints, word(mesh.forces.data()), kPoints, word((*states)[s + 1].data())});
  }
  EXPECT_TRUE(plan(twice));
  EXPECT_FALSE(plan_with_halo(twice));
}

TEST_F(PersistentHalo, RowsThatAreStoredAtOnceAreNotSent) {
  // A chain whose last operation has too many words for registers.
  constexpr int32_t kWords = 27;
  novaphy_kernel wide = traced(nova::make_kernel("wide", {{"at", DType::F32, 3, Access::Direct}},
                                                 {{"to", kWords}}, [](TraceContext& t) {
                                                   std::vector<Real> to;
                                                   for (int32_t c = 0; c < kWords; ++c)
                                                     to.push_back(t.f32(0, c % 3) + Real(1.0f));
                                                   return to;
                                                 }));
  Mesh mesh;
  std::vector<float> words(kWords * kPoints);
  const RecordedPersistent to = forward(mesh, [&](RecordedPersistent& chain, uint32_t s) {
    chain.launch(chain.add(2 * s + 1, 0, kPoints, kPoints), wide,
                 {word(mesh.states[s + 1].data()), kPoints, word(words.data())});
  });
  const std::optional<BlockPlan> made = plan_with_halo(to);
  ASSERT_TRUE(made);
  EXPECT_FALSE(planned(to, *made).fits);
}

TEST_F(PersistentHalo, BlocksWithoutElementsGetNothing) {
  // Only the first points have elements.
  const auto few = [](Mesh& mesh) {
    std::vector<int32_t> springs, triangles;
    for (int32_t k = 0; k + 2 < kPoints / 4; ++k) {
      springs.insert(springs.end(), {k, k + 1});
      triangles.insert(triangles.end(), {k, k + 1, k + 2});
    }
    mesh.kinds = {Kind(2, springs), Kind(3, triangles)};
  };
  Mesh plain, mesh;
  few(plain);
  few(mesh);
  const std::optional<BlockPlan> made = plan_with_halo(forward(mesh));
  ASSERT_TRUE(made);
  EXPECT_GT(std::count(made->halo.bytes.begin(), made->halo.bytes.end(), 0u), 0);
  run_plain(forward(plain));
  run_planned(forward(mesh), 2, false, true);
  for (uint32_t s = 0; s <= Mesh::kSubsteps; ++s) expect_same(mesh.states[s], plain.states[s]);
}

}  // namespace
}  // namespace novaphy::gpu
