#include "rigid_tree.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "byte_array.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/index_rows.h"
#include "rigid_tree_kernels.h"

namespace novaphy::detail {
namespace {

// Never destroyed, because recordings refer to the kernels.
struct Kernels {
  Kernel<RigidTreeBoundsArguments> bounds{rigid_tree_bounds, rigid_tree_kernels_source};
  Kernel<RigidTreeKeyArguments> key{rigid_tree_key, rigid_tree_kernels_source};
  Kernel<RigidTreeEntryArguments> entry{rigid_tree_entry, rigid_tree_kernels_source};
  Kernel<RigidTreeLevelArguments> level{rigid_tree_level, rigid_tree_kernels_source};
  Kernel<RigidTreeCountArguments> count{rigid_tree_count, rigid_tree_kernels_source};
  Kernel<RigidTreeTotalArguments> total{rigid_tree_total, rigid_tree_kernels_source};
  Kernel<RigidTreeWriteArguments> write{rigid_tree_write, rigid_tree_kernels_source};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

constexpr int64_t kTotals = 256;
constexpr int64_t kMostUnwrapped = 65536;  // largest number of shapes whose pairs int32 can count

// Returns about the square root of `count`: the number of partial results if one row of the next
// launch reads all of them.
int64_t root_of(int64_t count) {
  return std::max<int64_t>(1, std::llround(std::sqrt(static_cast<double>(count))));
}

// Returns the shapes that are kept outside of the tree: at most kMostApart of the largest, if they
// are much larger than most shapes and may touch very many others. Each of them tests all shapes.
std::vector<int32_t> apart_of(const Model& m, std::span<const int32_t> world) {
  constexpr size_t kMostApart = 64, kVeryMany = 512;
  constexpr float kMuchLarger = 16.0f;
  const std::vector<float> radius = m.shape_collision_radius.to_host();
  std::vector<int32_t> large;
  if (radius.size() < kVeryMany) return large;
  std::vector<float> sorted = radius;
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  float much = kMuchLarger * sorted[sorted.size() / 2];
  std::vector<size_t> of_world(static_cast<size_t>(m.world_count()) + 1);
  for (const int32_t w : world) ++of_world[static_cast<size_t>(w + 1)];
  for (size_t s = 0; s < radius.size(); ++s) {
    const int32_t w = world[s];
    const size_t others =
        w < 0 ? radius.size() : of_world[0] + of_world[static_cast<size_t>(w + 1)];
    if (radius[s] > much && others >= kVeryMany) large.push_back(static_cast<int32_t>(s));
  }
  while (large.size() > kMostApart) {
    much *= 2.0f;
    std::erase_if(large, [&](int32_t s) { return radius[static_cast<size_t>(s)] <= much; });
  }
  return large;
}

}  // namespace

void RigidTree::update(const Model& m, std::span<const int32_t> given_world) {
  std::vector<int32_t> world(given_world.begin(), given_world.end());
  for (size_t s = 0; s < world.size(); ++s) {
    require(world[s] < m.world_count(), ErrorKind::Index, "CollisionPipeline: model.shape_world[",
            s, "]: expected at most ", m.world_count() - 1, ", got ", world[s]);
    world[s] = std::max(world[s], -1);
  }
  set_filters(m);
  assign_slots(m, world);
  set_levels(m.device());
  sorted_in_.reset();
  found_ = DeviceArray<int32_t>(1, m.device());
  totals_ = {};
  if (m.shape_count() > kMostUnwrapped) totals_ = DeviceArray<uint64_t>(kTotals, m.device());
}

void RigidTree::set_filters(const Model& m) {
  std::vector<int32_t> ends;  // both shapes of each pair, one after the other
  for (const auto& [i, j] : m.shape_collision_filter_pairs)
    if (i >= 0 && j >= 0 && std::max(i, j) < m.shape_count()) ends.insert(ends.end(), {i, j});
  IndexRows rows;
  rows.build(ends, m.shape_count());
  std::vector<int32_t> filtered;
  for (const int32_t end : rows.all()) filtered.push_back(ends[static_cast<size_t>(end ^ 1)]);
  filter_starts_ = DeviceArray<int32_t>::from_host(rows.begins(), m.device());
  filtered_ = DeviceArray<int32_t>::from_host(filtered, m.device());
}

// Decides which shapes are in the tree, and assigns the slots for counts to all shapes.
void RigidTree::assign_slots(const Model& m, std::span<const int32_t> world) {
  const size_t shapes = world.size();
  const std::vector<int32_t> apart = apart_of(m, world);
  const auto parts = static_cast<int32_t>((shapes + kApartPart - 1) / kApartPart);
  segments_ = int64_t{m.world_count()} + 1;
  std::vector<int32_t> slots, members, segment;  // world index of each member
  int32_t slot = 0;
  for (size_t s = 0, next = 0; s < shapes; ++s) {
    slots.push_back(slot);
    if (next < apart.size() && apart[next] == static_cast<int32_t>(s)) {
      ++next;
      slot += parts;
      continue;
    }
    ++slot;
    members.push_back(static_cast<int32_t>(s));
    segment.push_back(world[s] + 1);
  }
  IndexRows rows;
  rows.build(segment, static_cast<int32_t>(segments_));
  slot_count_ = slot;
  entry_count_ = static_cast<int64_t>(members.size());
  // The order before the first sort, in which each world is contiguous.
  using Table = std::pair<DeviceArray<int32_t>*, std::span<const int32_t>>;
  for (const auto& [table, values] :
       {Table{&slots_, slots}, Table{&apart_, apart}, Table{&members_, members},
        Table{&starts_, rows.begins()}, Table{&order_, rows.all()}})
    *table = DeviceArray<int32_t>::from_host(values, m.device());
  for (DeviceArray<int32_t>* table : {&keys_, &counts_, &before_})
    *table = DeviceArray<int32_t>(table == &keys_ ? members.size() : static_cast<size_t>(slot),
                                  m.device());
  kept_ = DeviceArray<Vec2i>(static_cast<size_t>(slot) * kStored, m.device());
}

// Makes levels until a level has few boxes.
void RigidTree::set_levels(Device device) {
  level_counts_.clear();
  levels_.clear();
  int64_t nodes = 0, count = entry_count_;
  const auto add_level = [&] {
    count = (count + kTreeWidth - 1) / kTreeWidth;
    levels_.push_back(static_cast<int32_t>(nodes));
    level_counts_.push_back(count);
    nodes += count;
  };
  for (add_level(); count > kTreeWidth;) add_level();
  level_starts_ = DeviceArray<int32_t>::from_host(levels_, device);
  bounds_ = byte_array<geometry::Box3>(static_cast<size_t>(root_of(entry_count_)), device);
  entries_ = byte_array<TreeEntry>(static_cast<size_t>(entry_count_), device);
  nodes_ = byte_array<geometry::Box3>(static_cast<size_t>(nodes), device);
}

RigidTreeTables RigidTree::tables(const Model& m, const Array& shapes) const {
  return {.shapes = Untyped(shapes),
          .body = m.shape_body,
          .flags = m.shape_flags,
          .group = m.shape_collision_group,
          .world = m.shape_world,
          .filter_starts = filter_starts_,
          .filtered = filtered_,
          .slots = slots_,
          .apart = apart_,
          .entries = Untyped(entries_),
          .nodes = Untyped(nodes_),
          .levels = level_starts_,
          .starts = starts_,
          .shape_count = m.shape_count(),
          .entry_count = entry_count_,
          .apart_count = static_cast<int64_t>(apart_.rows()),
          .level_count = static_cast<int64_t>(levels_.size()),
          .segments = segments_};
}

// Returns whether the tree can use the order of an earlier search in the same recording. Shapes
// that move little stay near each other in the tree, and the pairs do not depend on the order. On a
// tape every search sorts, because the tape runs searches again.
bool RigidTree::keeps_order() {
  constexpr int32_t kSearches = 8;  // searches per sort
  LaunchRecorder* const recorder = launch_recorder();
  std::shared_ptr<ExclusiveUse> sorted = sorted_in_.lock();
  const bool is_here = sorted != nullptr && (recorder == nullptr) == (sorted == sorted_at_once_);
  if (is_here && ++searches_ < kSearches && !(recorder != nullptr && recorder->has_tape()))
    return true;
  searches_ = 0;
  if (!is_here) {
    sorted = std::make_shared<ExclusiveUse>();
    sorted_in_ = sorted;
    sorted_at_once_ = recorder == nullptr ? sorted : nullptr;
    if (recorder != nullptr) recorder->uses(sorted);
  }
  return false;
}

// Sorts the shapes by world and, within a world, along a space-filling curve.
void RigidTree::sort(const Model& m, const Array& shapes) {
  const Kernels& k = kernels();
  const auto bits =
      std::clamp<int64_t>((30 - std::bit_width(static_cast<uint64_t>(segments_))) / 3, 0, 10);
  run(k.bounds, root_of(entry_count_),
      {.shapes = Untyped(shapes),
       .members = members_,
       .count = entry_count_,
       .bounds = Untyped(bounds_)});
  run(k.key, entry_count_,
      {.shapes = Untyped(shapes),
       .members = members_,
       .world = m.shape_world,
       .bounds = Untyped(bounds_),
       .bound_count = root_of(entry_count_),
       .bits = bits,
       .keys = keys_});
  run(sort_by_key(), entry_count_, {.keys = keys_, .order = order_});
}

void RigidTree::count(const Model& m, const Array& shapes) {
  const Kernels& k = kernels();
  if (!keeps_order()) sort(m, shapes);
  run(k.entry, level_counts_[0],
      {.shapes = Untyped(shapes),
       .members = members_,
       .order = order_,
       .count = entry_count_,
       .entries = Untyped(entries_),
       .nodes = Untyped(nodes_)});
  for (size_t level = 1; level < levels_.size(); ++level)
    run(k.level, level_counts_[level],
        {.below = levels_[level - 1],
         .count = level_counts_[level - 1],
         .above = levels_[level],
         .nodes = Untyped(nodes_)});
  run(k.count, slot_count_, {.tree = tables(m, shapes), .counts = counts_, .kept = kept_});
  run(exclusive_scan(), slot_count_, {.in = counts_, .out = before_});
  if (totals_.rows() > 0)
    run(k.total, kTotals, {.counts = counts_, .slots = slot_count_, .totals = totals_});
}

void RigidTree::write(const Model& m, const Array& shapes, const DeviceArray<Vec2i>& pairs) {
  run(kernels().write, slot_count_,
      {.tree = tables(m, shapes),
       .counts = counts_,
       .before = before_,
       .kept = kept_,
       .totals = totals_,
       .total_rows = kTotals,
       .capacity = pairs.rows(),
       .pairs = pairs,
       .pairs_found = found_});
}

}  // namespace novaphy::detail
