// Phases: the fewest that the data flow allows, and no operation before its inputs.
#include <gtest/gtest.h>

#include <algorithm>

#include "fusion.h"
#include "oracle.h"
#include "phases.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::OpList;
using nova::detail::MemoryAccess;
using nova::detail::Phased;

// Launches that touch given memory, without kernels.
struct Recording {
  std::vector<OpList::Op> ops;
  std::vector<uint64_t> words;
  std::vector<MemoryAccess> accesses;

  void launch(int64_t n, const std::vector<MemoryAccess>& touched) {
    OpList::Op op{OpList::Op::Kind::Launch};
    op.n = n;
    op.word_count = 8;
    op.first_access = static_cast<uint32_t>(accesses.size());
    op.access_count = static_cast<uint32_t>(touched.size());
    accesses.insert(accesses.end(), touched.begin(), touched.end());
    ops.push_back(op);
  }
  std::vector<Phased> plan() const { return nova::detail::plan_phases(ops, words, accesses); }
};

// A row of `width` words of each of n rows, or any row.
MemoryAccess own(uint64_t at, int64_t n, uint32_t width, bool write) {
  return {at, static_cast<uint64_t>(n) * width * 4, width * 4, write};
}
MemoryAccess any(uint64_t at, int64_t n, uint32_t width, bool write) {
  return {at, static_cast<uint64_t>(n) * width * 4, 0, write};
}

uint32_t phases(const std::vector<Phased>& plan) { return plan.back().phase + 1; }

// A source may have fewer rows than the launch, as long as no lane needs more.
TEST(Phases, ASourceIsReadAsFarAsItGoes) {
  nova::detail::RowLayout layout;
  layout.inputs = {{0, 12}};
  layout.outputs = {{2, 4}};
  OpList::Op op{OpList::Op::Kind::Launch};
  op.layout = &layout;
  op.n = 100;
  op.word_count = 3;
  for (const uint64_t rows : {0, 7, 100, 200}) {
    const uint64_t words[] = {0x1000, rows, 0x9000};
    std::vector<MemoryAccess> touched;
    ASSERT_TRUE(nova::detail::touched_by(op, words, {}, touched));
    ASSERT_EQ(touched.size(), 2u);
    EXPECT_EQ(touched[0].bytes, 12 * std::min<uint64_t>(rows, 100)) << rows;
    EXPECT_EQ(touched[1].bytes, 400u);
  }
}

TEST(Phases, ASubstepOfASoftBodyIsTwo) {
  constexpr int64_t kParticles = 27, kTets = 40, kTriangles = 48;
  constexpr uint64_t q = 0x10000, tet = 0x40000, tri = 0x50000, f = 0x60000, sum = 0x70000;
  Recording r;
  for (uint64_t t = 0; t < 10; ++t) {
    const uint64_t now = q + 0x200 * t, next = now + 0x200;
    r.launch(kTriangles, {any(now, kParticles, 3, false), own(tri, kTriangles, 9, true)});
    r.launch(kParticles, {any(tri, 3 * kTriangles, 3, false), own(f, kParticles, 3, true)});
    r.launch(kTets, {any(now, kParticles, 3, false), own(tet, kTets, 12, true)});
    r.launch(kParticles, {any(tet, 4 * kTets, 3, false), own(f, kParticles, 3, false),
                          own(sum, kParticles, 3, true)});
    r.launch(kParticles, {own(sum, kParticles, 3, false), own(now, kParticles, 3, false),
                          own(next, kParticles, 3, true)});
  }
  const std::vector<Phased> plan = r.plan();
  EXPECT_EQ(phases(plan), 20u);
  // The elements of both kinds run side by side, then the operations of a particle one after the
  // other.
  EXPECT_EQ(plan[0].chain, 0u);
  EXPECT_EQ(plan[1].chain, 1u);
  for (size_t k = 2; k < 5; ++k) {
    EXPECT_EQ(plan[k].phase, 1u);
    EXPECT_EQ(plan[k].chain, 0u);
    EXPECT_EQ(plan[k].rows, kParticles);
  }
}

TEST(Phases, RowsOfAChainMayBeSeveralOfAnOperation) {
  constexpr int64_t kTets = 40;
  Recording r;
  r.launch(4 * kTets, {own(0x1000, 4 * kTets, 3, true)});
  r.launch(kTets, {own(0x1000, kTets, 12, false), own(0x9000, kTets, 12, true)});
  const std::vector<Phased> plan = r.plan();
  EXPECT_EQ(phases(plan), 1u);
  EXPECT_EQ(plan[0].rows, kTets);
  EXPECT_EQ(plan[1].rows, kTets);
  EXPECT_EQ(plan[1].chain, plan[0].chain);
}

TEST(Phases, AnotherViewOfTheSameBytesWaits) {
  Recording r;
  r.launch(10, {own(0x1000, 10, 3, true)});
  r.launch(5, {own(0x1000 + 60, 5, 3, false), own(0x9000, 5, 3, true)});
  EXPECT_EQ(phases(r.plan()), 2u);
}

// Returns whether b, recorded after a, may only run after a.
bool depends(const Recording& r, uint32_t a, uint32_t b) {
  std::vector<MemoryAccess> of_a, of_b;
  nova::detail::touched_by(r.ops[a], r.words, r.accesses, of_a);
  nova::detail::touched_by(r.ops[b], r.words, r.accesses, of_b);
  for (const MemoryAccess& x : of_a)
    for (const MemoryAccess& y : of_b)
      if ((x.write || y.write) && x.begin < y.begin + y.bytes && y.begin < x.begin + x.bytes)
        return true;
  return false;
}
// Returns whether row i of b only needs row i of a.
bool row_by_row(const Recording& r, uint32_t a, uint32_t b) {
  std::vector<MemoryAccess> of_a, of_b;
  nova::detail::touched_by(r.ops[a], r.words, r.accesses, of_a);
  nova::detail::touched_by(r.ops[b], r.words, r.accesses, of_b);
  for (const MemoryAccess& x : of_a)
    for (const MemoryAccess& y : of_b) {
      const bool apart = x.begin >= y.begin + y.bytes || y.begin >= x.begin + x.bytes;
      if (apart || (!x.write && !y.write)) continue;
      if (x.begin != y.begin || x.bytes != y.bytes || x.row_bytes == 0 || y.row_bytes == 0)
        return false;
    }
  return true;
}

TEST(Phases, RandomOperationsKeepTheirOrder) {
  for (uint32_t seed = 1; seed <= 60; ++seed) {
    Random random(seed);
    Recording r;
    for (int k = 0; k < 60; ++k) {
      const int64_t n = random.chance(70) ? 24 : random.chance(50) ? 72 : 8;
      std::vector<MemoryAccess> touched;
      for (int a = 0; a < 3; ++a) {
        const bool write = a == 2 || random.chance(15);
        const auto buffer = static_cast<uint64_t>(random.below(7));
        const auto width = static_cast<uint32_t>(72 * 3 / n);  // all of a buffer of 72 x 3 words
        MemoryAccess access = own(0x1000 * (buffer + 1), n, width, write);
        if (random.chance(20)) access.row_bytes = 0;
        if (random.chance(10)) {  // a part of it
          access.begin += 48;
          access.bytes -= 96;
          access.row_bytes = 0;
        }
        touched.push_back(access);
      }
      r.launch(n, touched);
    }
    const std::vector<Phased> plan = r.plan();
    ASSERT_EQ(plan.size(), r.ops.size());
    std::vector<size_t> place(plan.size());
    for (size_t k = 0; k < plan.size(); ++k) {
      place[plan[k].op] = k;
      ASSERT_EQ(r.ops[plan[k].op].n % plan[k].rows, 0);
      if (k > 0) {
        ASSERT_LE(std::pair(plan[k - 1].phase, plan[k - 1].chain),
                  std::pair(plan[k].phase, plan[k].chain));
      }
    }
    for (uint32_t b = 0; b < r.ops.size(); ++b)
      for (uint32_t a = 0; a < b; ++a) {
        if (!depends(r, a, b)) continue;
        const Phased &x = plan[place[a]], &y = plan[place[b]];
        ASSERT_LE(x.phase, y.phase) << "seed " << seed;
        if (x.phase != y.phase) continue;
        ASSERT_EQ(x.chain, y.chain) << "seed " << seed;
        ASSERT_LT(place[a], place[b]);
        ASSERT_TRUE(row_by_row(r, a, b)) << "seed " << seed << ": " << a << " and " << b;
      }
  }
}

}  // namespace
}  // namespace novaphy::testing
