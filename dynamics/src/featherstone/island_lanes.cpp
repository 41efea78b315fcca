#include "island_lanes.h"

#include <algorithm>
#include <memory>

#include "novaphy/core/sim/for_chunks.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr size_t kFewest = 3;  // the fewest islands for which lanes are faster
constexpr int32_t kMostRows = 64, kMostTrees = 16;
// Converged islands leave their lanes after this many sweeps, and then after four times as many.
constexpr int64_t kFirstSweeps = 32;

GroupStep group_of(const ArticulationContactStepArguments& a, int32_t tree) {
  return {a, a.of.shapes.group_of_tree[tree]};
}

bool is_coupled(const IslandNode& node, int32_t tree) {
  return node.root == tree && node.taken == 0 && node.coupled != 0 && node.rows > 0 &&
         node.rows <= kMostRows;
}
bool may_share(const GroupStep& s, int32_t root) {
  bool may = true;
  for (int32_t i = root; i >= 0 && may; i = s.a.nodes[i].next) may = s.all.step.status[i] == 0;
  for_friction(s, root, [&](const art::PgsJointFriction<float>&, int32_t) { may = false; });
  return may;
}

}  // namespace

// Adds an island with its structure, unless the island has too many trees.
void IslandLanes::describe(const GroupStep& s, int32_t root) {
  const int32_t rows = s.a.nodes[root].rows;
  const auto first = static_cast<int64_t>(trees_.size());
  int32_t sides[2 * kMostRows];
  for (int32_t n = 0; n < rows; ++n) {
    art::ContactSide of[2];
    contact_sides(s.a.shapes, s.a.contacts[s.places(root)[n]], of);
    for (int side = 0; side < 2; ++side) {
      int32_t& place = sides[2 * n + side] = -1;
      if (of[side].tree < 0) continue;
      const auto at = std::find(trees_.begin() + first, trees_.end(), of[side].tree);
      place = static_cast<int32_t>(at - trees_.begin() - first);
      if (at == trees_.end()) trees_.push_back(of[side].tree);
    }
  }
  const auto count = static_cast<int64_t>(trees_.size()) - first;
  if (count > kMostTrees) return;
  Island island{root, static_cast<int64_t>(shapes_.size()), 0, first, {}};
  shapes_.push_back(static_cast<int32_t>(count));
  shapes_.push_back(rows);
  for (int64_t t = first; t < first + count; ++t)
    shapes_.push_back(art::padded_dofs(s.rows(trees_[static_cast<size_t>(t)]).dof_count));
  for (int64_t t = first; t < first + count; ++t)
    shapes_.push_back(s.rows(trees_[static_cast<size_t>(t)]).moves != 0 ? 1 : 0);
  shapes_.insert(shapes_.end(), sides, sides + 2 * rows);
  island.size = static_cast<int64_t>(shapes_.size()) - island.begin;
  islands_.push_back(island);
}

bool IslandLanes::same(const Island& a, const Island& b) const {
  const auto* const all = shapes_.data();
  return a.size == b.size && std::equal(all + a.begin, all + a.begin + a.size, all + b.begin);
}

void IslandLanes::find(const ArticulationContactStepArguments& a, int64_t trees) {
  islands_.clear();
  shapes_.clear();
  trees_.clear();
  for (int32_t i = 0; i < trees; ++i) {
    if (!is_coupled(a.of.nodes[i], i)) continue;
    const GroupStep s = group_of(a, i);
    if (may_share(s, i)) describe(s, i);
  }
  std::sort(islands_.begin(), islands_.end(), [&](const Island& x, const Island& y) {
    const auto* const all = shapes_.data();
    const auto order = std::lexicographical_compare_three_way(
        all + x.begin, all + x.begin + x.size, all + y.begin, all + y.begin + y.size);
    return order != 0 ? order < 0 : x.root < y.root;
  });
  keep_groups();
}

// Removes the islands of which too few have the same structure.
void IslandLanes::keep_groups() {
  size_t kept = 0;
  for (size_t k = 0; k < islands_.size();) {
    size_t end = k + 1;
    while (end < islands_.size() && same(islands_[k], islands_[end])) ++end;
    if (end - k >= kFewest)
      kept = static_cast<size_t>(std::copy(islands_.begin() + static_cast<int64_t>(k),
                                           islands_.begin() + static_cast<int64_t>(end),
                                           islands_.begin() + static_cast<int64_t>(kept)) -
                                 islands_.begin());
    k = end;
  }
  islands_.resize(kept);
}

void IslandLanes::sweep_pack(const ArticulationContactStepArguments& a, int32_t most_sweeps,
                             size_t begin, size_t end) {
  constexpr size_t kMostLanes = 16;
  static thread_local std::vector<unsigned char> memory;
  const Island& first = islands_[left_[begin]];
  const int32_t* const shape = shapes_.data() + first.begin;
  art::IslandContact* contacts[kMostLanes];
  float* rates[kMostLanes * kMostTrees];
  art::IslandResult* results[kMostLanes];
  art::LaneIslands to;
  to.count = static_cast<int32_t>(end - begin);
  to.trees = shape[0];
  to.rows = shape[1];
  to.widths = shape + 2;
  to.moves = shape + 2 + to.trees;
  for (size_t l = 0; l < end - begin; ++l) {
    Island& island = islands_[left_[begin + l]];
    const GroupStep s = group_of(a, island.root);
    contacts[l] = rows_of(s, island.root);
    results[l] = &island.result;
    for (int32_t t = 0; t < to.trees; ++t)
      rates[static_cast<int32_t>(l) * to.trees + t] =
          s.tree(trees_[static_cast<size_t>(island.trees + t)]).rates;
  }
  to.contacts = contacts;
  to.rates = rates;
  to.results = results;
  to.cone = a.of.cone.value != 0;
  to.most_sweeps = most_sweeps;
  to.tolerance = a.tolerance.value;
  const auto bytes = static_cast<size_t>(level_.islands_memory(to));
  if (memory.size() < bytes + 64) memory.resize(bytes + 64);
  to.memory = memory.data();
  size_t space = memory.size();
  std::align(64, bytes, to.memory, space);
  level_.sweep_islands(to);
}

// Sweeps the islands that are left, in packs of the same structure.
void IslandLanes::sweep(const ArticulationContactStepArguments& a, int32_t most_sweeps) {
  packs_.clear();
  for (size_t k = 0; k < left_.size(); ++k)
    if (packs_.empty() || k - packs_.back() == static_cast<size_t>(level_.lanes) ||
        !same(islands_[left_[k]], islands_[left_[packs_.back()]]))
      packs_.push_back(k);
  const auto count = static_cast<int64_t>(packs_.size());
  packs_.push_back(left_.size());
  for_chunks(count, 1, [&](int64_t begin, int64_t, int64_t) {
    const auto p = static_cast<size_t>(begin);
    sweep_pack(a, most_sweeps, packs_[p], packs_[p + 1]);
  });
  std::erase_if(left_, [&](size_t k) {
    const art::IslandResult& of = islands_[k].result;
    return of.sweeps < most_sweeps || of.residual < a.tolerance.value;
  });
}

void IslandLanes::solve(const ArticulationContactStepArguments& a, int64_t trees) {
  find(a, trees);
  const auto count = static_cast<int64_t>(islands_.size());
  constexpr int64_t kChunk = 4;
  const auto for_islands = [&](const auto& f) {
    for_chunks(count, kChunk, [&](int64_t begin, int64_t end, int64_t) {
      for (int64_t k = begin; k < end; ++k) f(islands_[static_cast<size_t>(k)]);
    });
  };
  for_islands([&](Island& i) {
    start_coupled(group_of(a, i.root), i.root, true);
    a.of.nodes[i.root].solved = 1;
  });
  left_.resize(islands_.size());
  for (size_t k = 0; k < left_.size(); ++k) left_[k] = k;
  const int64_t most = a.most_sweeps.value;
  for (int64_t sweeps = kFirstSweeps; !left_.empty(); sweeps *= 4) {
    sweep(a, static_cast<int32_t>(std::min(sweeps, most)));
    if (sweeps >= most) break;
  }
  for_islands([&](Island& i) { solve_island(Alone{}, group_of(a, i.root), i.root, &i.result); });
}

}  // namespace novaphy
