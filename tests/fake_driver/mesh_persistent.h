// Meshes as persistent kernels: elements of two kinds compute items for their corners, and points
// sum the items and move.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <functional>
#include <random>

#include "cluster/blocks.h"
#include "novaphy/nova/kernel.h"
#include "persistent_kernels.h"
#include "persistent_on_host.h"

namespace novaphy::gpu {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::TraceContext;
using Form = PersistentShape::Form;

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

// A grid of points with springs along its edges and triangles in its cells. The forward pass runs
// kSubsteps substeps. The backward pass runs through the same substeps in reverse. Its elements
// then read states that no operation writes.
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
inline novaphy_kernel pull_kernel(int32_t corners) {
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
// A kernel of an adjoint: a slow function of the state, times the gradients of the corners.
inline novaphy_kernel back_kernel(int32_t corners) {
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
inline novaphy_kernel move_kernel() {
  return traced(nova::make_kernel(
      "move", {{"at", DType::F32, 3, Access::Direct}, {"force", DType::F32, 3, Access::Direct}},
      {{"to", 3}}, [](TraceContext& t) {
        std::vector<Real> to;
        for (int32_t c = 0; c < 3; ++c) to.push_back(t.f32(0, c) + Real(0.03125f) * t.f32(1, c));
        return to;
      }));
}

inline uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }

class MeshPersistent : public testing::Test {
 protected:
  MeshPersistent() {
    for (const int32_t corners : {2, 3}) {
      pulls_.push_back(pull_kernel(corners));
      backs_.push_back(back_kernel(corners));
    }
  }
  // Records elements that read a state, and either forces on points or their own rest values.
  static void record_elements(RecordedPersistent& to, uint32_t phase, Mesh& mesh,
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
  void record_sums(RecordedPersistent& to, uint32_t phase, Mesh& mesh) {
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
  // `more`: further operations of a phase, after those that move the points.
  RecordedPersistent forward(
      Mesh& mesh, const std::function<void(RecordedPersistent&, uint32_t substep)>& more = {}) {
    RecordedPersistent to;
    for (uint32_t s = 0; s < Mesh::kSubsteps; ++s) {
      const uint64_t at = word(mesh.states[s].data());
      record_elements(to, 2 * s, mesh, pulls_, at, nullptr);
      record_sums(to, 2 * s + 1, mesh);
      to.launch(to.add(2 * s + 1, 0, kPoints, kPoints), move_,
                {at, kPoints, word(mesh.forces.data()), kPoints, word(mesh.states[s + 1].data())});
      if (more) more(to, s);
    }
    return to;
  }
  RecordedPersistent backward(Mesh& mesh) {
    RecordedPersistent to;
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
  static std::optional<BlockPlan> plan(const RecordedPersistent& persistent) {
    return plan_blocks(persistent.ops, kBlocks, kMostWarps, read);
  }
  static std::optional<BlockPlan> plan_with_halo(const RecordedPersistent& persistent) {
    std::optional<BlockPlan> made = plan(persistent);
    if (made && !plan_halo(persistent.ops, kBlocks, read, *made)) made.reset();
    return made;
  }
  static void run_plain(const RecordedPersistent& persistent) {
    const PersistentShape shape{Form::Grid, 3, 64};
    PersistentTable table = persistent_table(persistent.ops);
    EXPECT_TRUE(HostPersistent(table, shape).run(1));
  }
  static PersistentTable planned(const RecordedPersistent& persistent, const BlockPlan& plan) {
    return persistent_table(persistent.ops,
                            {kBlocks * plan.threads / 32, 200, kBlocks, 1, &plan, 1 << 20});
  }
  static void run_planned(const RecordedPersistent& persistent, uint32_t seed, bool ahead,
                          bool halo) {
    const std::optional<BlockPlan> made = halo ? plan_with_halo(persistent) : plan(persistent);
    ASSERT_TRUE(made);
    PersistentTable table = planned(persistent, *made);
    ASSERT_TRUE(table.fits);
    EXPECT_NE(table.layouts, 0u);
    EXPECT_EQ(table.halo_rows != 0, halo);
    EXPECT_EQ(table.job_count != 0, ahead);
    EXPECT_TRUE(HostPersistent(table, {Form::Cluster, kBlocks, made->threads, 1}).run(seed));
  }
  static void expect_same(const std::vector<float>& a, const std::vector<float>& b) {
    EXPECT_EQ(0, std::memcmp(a.data(), b.data(), a.size() * sizeof(float)));
  }

  std::vector<novaphy_kernel> pulls_, backs_;
  novaphy_kernel move_ = move_kernel(), sum_ = row_sum_kernel(), collect_ = collect_kernel();
};

}  // namespace novaphy::gpu
