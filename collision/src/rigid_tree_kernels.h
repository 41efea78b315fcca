// The pairs of BroadPhase::Sap as kernels, found on the device of the shapes: the pairs of
// box_pairs.h, sorted, in time that grows with the shapes and the pairs.
//
// Shapes are sorted by world and, within it, along a curve that fills space. Levels of boxes stand
// over the sorted shapes, each box over kTreeWidth of the level below. A shape asks only those
// whose boxes meet its own. The order changes the time, not the pairs.
//
// A few shapes that nearly all others may meet, such as a ground, stand apart. All shapes ask them,
// and each of them asks all shapes in parts of kApartPart. A shape that asks counts its partners
// and, after a scan of the counts, writes them.
#pragma once

#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/shape_pair_rule.h"

namespace novaphy {

inline constexpr int32_t kTreeBits = 3, kTreeWidth = 1 << kTreeBits;  // of a level in the next one
inline constexpr int32_t kApartPart = 4;
inline constexpr int32_t kKept = 12;  // partners that the count remembers

inline geometry::Box3 no_box() {
  return {{3.0e38f, 3.0e38f, 3.0e38f}, {-3.0e38f, -3.0e38f, -3.0e38f}};
}
inline void grow(geometry::Box3& all, const geometry::Box3& one) {
  all.lo = {math::min(all.lo.x, one.lo.x), math::min(all.lo.y, one.lo.y),
            math::min(all.lo.z, one.lo.z)};
  all.hi = {math::max(all.hi.x, one.hi.x), math::max(all.hi.y, one.hi.y),
            math::max(all.hi.z, one.hi.z)};
}

// Where the middles of the shapes of the tree are: of every n-th one.
struct RigidTreeBoundsArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; Reads<int32_t> members; Number<int64_t> count;
                    Writes<geometry::Box3> bounds;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_bounds, RigidTreeBoundsArguments) {
  geometry::Box3 all = no_box();
  for (int64_t k = row; k < a.count; k += n) {
    const geometry::Box3& box = a.shapes[a.members[k]].box;
    const Vec3f middle = box.lo * 0.5f + box.hi * 0.5f;
    if (geometry::boxes_meet(box, box)) grow(all, {middle, middle});
  }
  a.bounds[row] = all;
}

struct RigidTreeKeyArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; Reads<int32_t> members, world;
                    Reads<geometry::Box3> bounds; Number<int64_t> bound_count;
                    Number<int64_t> bits;  // of the curve, for each axis
                    WritesRow<int32_t> keys;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_key, RigidTreeKeyArguments) {
  geometry::Box3 all = no_box();
  for (int64_t k = 0; k < a.bound_count; ++k) grow(all, a.bounds[k]);
  const int32_t shape = a.members[row];
  const geometry::Box3& box = a.shapes[shape].box;
  const Vec3f middle = box.lo * 0.5f + box.hi * 0.5f, size = all.hi - all.lo;
  const auto bits = static_cast<int32_t>(a.bits);
  const auto last = static_cast<float>((int32_t{1} << bits) - 1);
  const float scale = last / math::max(math::max(size.x, size.y), math::max(size.z, 1.0e-30f));
  const Vec3f at = (middle - all.lo) * scale;
  int32_t key = a.world[shape] < 0 ? 0 : a.world[shape] + 1;
  // A NaN is in the first cell.
  const auto cell = [last](float x) {
    return x > 0.0f ? static_cast<int32_t>(math::min(x, last)) : 0;
  };
  const int32_t x = cell(at.x), y = cell(at.y), z = cell(at.z);
  for (int32_t bit = bits - 1; bit >= 0; --bit)
    key = key << 3 | (x >> bit & 1) << 2 | (y >> bit & 1) << 1 | (z >> bit & 1);
  a.keys[row] = key;
}

// Child k of a node. Where a level of `count` boxes ends, the last one stands for those behind it:
// so nothing asks whether to load a box, and the loads of all children run at the same time.
inline int64_t child(int64_t node, int32_t k, int64_t count) {
  const int64_t at = node * kTreeWidth + k;
  return at < count ? at : count - 1;
}

// In the order of the tree.
struct TreeEntry {
  geometry::Box3 box;  // one with a NaN meets nothing, not even a box without end
  int32_t shape;
  int32_t unused;
};

// The entries, and their boxes in eights: a row for each of these.
struct RigidTreeEntryArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; Reads<int32_t> members, order;
                    Number<int64_t> count;  // of the entries
                    Writes<TreeEntry> entries; Writes<geometry::Box3> nodes;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_entry, RigidTreeEntryArguments) {
  geometry::Box3 all = no_box();
  TreeEntry mine[kTreeWidth];
  for (int32_t k = 0; k < kTreeWidth; ++k) {
    const int32_t shape = a.members[a.order[child(row, k, a.count)]];
    mine[k] = {a.shapes[shape].box, shape, 0};
  }
  for (int32_t k = 0; k < kTreeWidth; ++k) {
    a.entries[child(row, k, a.count)] = mine[k];
    if (geometry::boxes_meet(mine[k].box, mine[k].box)) grow(all, mine[k].box);
  }
  a.nodes[row] = all;
}

// The next level.
struct RigidTreeLevelArguments {
  NOVAPHY_ARGUMENTS(Number<int64_t> below, count;  // the first of the nodes below, and how many
                    Number<int64_t> above;         // the first of those that are made
                    Updates<geometry::Box3> nodes;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_level, RigidTreeLevelArguments) {
  geometry::Box3 all = no_box();
  for (int32_t k = 0; k < kTreeWidth; ++k) grow(all, a.nodes[a.below + child(row, k, a.count)]);
  a.nodes[a.above + row] = all;
}

// What partners are asked by.
struct RigidTreeTables {
  NOVAPHY_ARGUMENTS(
      Reads<RigidShape> shapes; Reads<int32_t> body, flags, group, world,
                                filter_starts;  // of every shape: those that it never touches are
      Reads<int32_t> filtered;  // filtered[filter_starts[s]] .. [filter_starts[s + 1] - 1]
      Reads<int32_t> slots;     // of every shape: its first slot of counts
      Reads<int32_t> apart;     // the shapes that stand apart
      Reads<TreeEntry> entries; Reads<geometry::Box3> nodes;  // level by level
      Reads<int32_t> levels;  // the first node of each: levels[0] is that of the eights
      Reads<int32_t> starts;  // of the entries of all worlds, of each world, and the end
      Number<int64_t> shape_count, entry_count, apart_count, level_count, segments;)
};
inline PairedShape paired_shape(const RigidTreeTables& a, int32_t shape) {
  return {a.body[shape], a.flags[shape], a.group[shape], a.world[shape]};
}

// A row of those who ask: a shape of the tree, or a part of the shapes that one apart asks.
struct TreeAsker {
  int32_t shape, slot;
  int32_t part;  // -1: of the tree
};
inline TreeAsker tree_asker(const RigidTreeTables& a, int64_t row) {
  if (row < a.entry_count) {
    const int32_t shape = a.entries[row].shape;
    return {shape, a.slots[shape], -1};
  }
  const int64_t parts = (a.shape_count + kApartPart - 1) / kApartPart;
  const int32_t shape = a.apart[(row - a.entry_count) / parts];
  const auto part = static_cast<int32_t>((row - a.entry_count) % parts);
  return {shape, a.slots[shape] + part, part};
}

// What the partners of a shape are found by.
struct TreeShape {
  int32_t shape;
  GeoType type;
  geometry::Box3 box;
  PairedShape paired;
  int32_t filter_begin, filter_end;
};
inline TreeShape tree_shape(const RigidTreeTables& a, int32_t shape) {
  return {shape,
          a.shapes[shape].type,
          a.shapes[shape].box,
          paired_shape(a, shape),
          a.filter_starts[shape],
          a.filter_starts[shape + 1]};
}
// Whether `other`, whose box meets that of the shape, may touch it and stands second in the pair.
inline bool is_partner(const RigidTreeTables& a, const TreeShape& s, int32_t other) {
  const GeoType type = a.shapes[other].type;
  const PairedShape paired = paired_shape(a, other);
  if (other == s.shape || type < s.type || (type == s.type && other < s.shape)) return false;
  if (!may_touch_unfiltered(s.paired, paired)) return false;
  for (int32_t f = s.filter_begin; f < s.filter_end; ++f)
    if (a.filtered[f] == other) return false;
  return true;
}

// Calls visit(other) for the shapes [begin, end) that are partners of the shape, ascending.
template <class Visit>
void for_partners_among(const RigidTreeTables& a, const TreeShape& s, int64_t begin, int64_t end,
                        Visit& visit) {
  for (int64_t other = begin; other < end; ++other)
    if (geometry::boxes_meet(s.box, a.shapes[other].box) &&
        is_partner(a, s, static_cast<int32_t>(other)))
      visit(static_cast<int32_t>(other));
}
// The levels that for_partners_in goes down: a byte of its word each.
inline constexpr int32_t kTreeDepth = 8;
// Bit k: the box meets that of child k of a node of the level, and the child holds some of the
// entries [begin, end).
inline uint64_t meeting_children(const RigidTreeTables& a, const geometry::Box3& box, int32_t level,
                                 int64_t node, int64_t begin, int64_t end) {
  const int32_t below = kTreeBits * (level - 1);
  const int64_t first = begin >> below, last = (end - 1) >> below;
  uint64_t bits = 0;
  for (int32_t k = 0; k < kTreeWidth; ++k) {
    const int64_t at = child(node, k, last + 1);
    const geometry::Box3& one = level > 1 ? a.nodes[a.levels[level - 2] + at] : a.entries[at].box;
    const bool is_there = at == node * kTreeWidth + k && at >= first;
    if (is_there && geometry::boxes_meet(box, one)) bits |= uint64_t{1} << k;
  }
  return bits;
}
// For the partners among the entries [begin, end), in their order.
template <class Visit>
void for_partners_in(const RigidTreeTables& a, const TreeShape& s, int64_t begin, int64_t end,
                     Visit& visit) {
  if (begin >= end) return;
  const int32_t top = a.level_count < kTreeDepth ? static_cast<int32_t>(a.level_count) : kTreeDepth;
  const int32_t shift = kTreeBits * top;
  for (int64_t root = begin >> shift; root <= (end - 1) >> shift; ++root) {
    int64_t node = root;
    int32_t level = top;
    uint64_t open =
        0;  // a byte for each level: the children of its node that are still to be asked
    if (!geometry::boxes_meet(s.box, a.nodes[a.levels[top - 1] + root])) continue;
    open = meeting_children(a, s.box, level, node, begin, end) << 8 * (level - 1);
    while (level <= top) {
      const uint64_t left = open >> 8 * (level - 1) & 255;
      if (left == 0) {
        node >>= kTreeBits;
        ++level;
        continue;
      }
      int32_t k = 0;
      while ((left >> k & 1) == 0) ++k;
      open &= ~(uint64_t{1} << (8 * (level - 1) + k));
      const int64_t at = node * kTreeWidth + k;
      if (level > 1) {
        node = at;
        --level;
        open |= meeting_children(a, s.box, level, node, begin, end) << 8 * (level - 1);
      } else if (const int32_t other = a.entries[at].shape; is_partner(a, s, other)) {
        visit(other);
      }
    }
  }
}
template <class Visit>
void for_partners(const RigidTreeTables& a, const TreeAsker& asker, Visit visit) {
  const TreeShape s = tree_shape(a, asker.shape);
  if (!has_flag(s.paired.flags, ShapeFlags::COLLIDE_SHAPES)) return;
  if (!geometry::boxes_meet(s.box, s.box)) return;
  if (asker.part >= 0) {
    const int64_t begin = int64_t{asker.part} * kApartPart, end = begin + kApartPart;
    for_partners_among(a, s, begin, end < a.shape_count ? end : a.shape_count.value, visit);
    return;
  }
  for (int64_t k = 0; k < a.apart_count; ++k)
    for_partners_among(a, s, a.apart[k], a.apart[k] + 1, visit);
  const int32_t world = s.paired.world;
  if (world < 0) {
    for_partners_in(a, s, 0, a.starts[a.segments], visit);
  } else {
    for_partners_in(a, s, 0, a.starts[1], visit);
    for_partners_in(a, s, a.starts[world + 1], a.starts[world + 2], visit);
  }
}

// Pairs of a shape, ascending, the first `room` of them.
struct SortedPairs {
  Vec2i* pairs;
  int64_t room, count;
};
inline void add_pair(SortedPairs& to, const Vec2i& pair) {
  if (to.count == to.room && to.pairs[to.count - 1].y < pair.y) return;
  int64_t k = to.count < to.room ? to.count++ : to.count - 1;
  for (; k > 0 && to.pairs[k - 1].y > pair.y; --k) to.pairs[k] = to.pairs[k - 1];
  to.pairs[k] = pair;
}

struct RigidTreeCountArguments {
  NOVAPHY_ARGUMENTS(Part<RigidTreeTables> tree; Writes<int32_t> counts;  // of each slot
                    Writes<Vec2i> kept;                                  // kKept of each slot
  )
};
NOVAPHY_ROW_KERNEL(rigid_tree_count, RigidTreeCountArguments) {
  const TreeAsker asker = tree_asker(a.tree, row);
  SortedPairs kept = {a.kept + int64_t{asker.slot} * kKept, kKept, 0};
  int32_t count = 0;
  for_partners(a.tree, asker, [&](int32_t other) {
    if (++count <= kKept) add_pair(kept, {asker.shape, other});
  });
  a.counts[asker.slot] = count;
}

// Where a scan of the counts may wrap.
struct RigidTreeTotalArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> counts; Number<int64_t> slots;
                    WritesRow<int64_t> totals;  // of every n-th slot
  )
};
NOVAPHY_ROW_KERNEL(rigid_tree_total, RigidTreeTotalArguments) {
  int64_t total = 0;
  for (int64_t k = row; k < a.slots; k += n) total += a.counts[k];
  a.totals[row] = total;
}

struct RigidTreeWriteArguments {
  NOVAPHY_ARGUMENTS(Part<RigidTreeTables> tree;
                    Reads<int32_t> counts, before;         // a scan of the counts
                    Reads<Vec2i> kept;                     // of what a slot counts up to kKept
                    Optional<Reads<int64_t>> totals;       // null: the scan cannot wrap
                    Number<int64_t> total_rows, capacity;  // of the pairs
                    Writes<Vec2i> pairs;                   // the first ones, in ascending order
                    Writes<int32_t> pairs_found;           // all of them; 2^31 - 1: as many or more
  )
};
NOVAPHY_ROW_KERNEL(rigid_tree_write, RigidTreeWriteArguments) {
  if (row == n - 1) {
    int64_t found = int64_t{a.before[n - 1]} + a.counts[n - 1];
    if (a.totals != nullptr) found = 0;
    for (int64_t k = 0; a.totals != nullptr && k < a.total_rows; ++k) found += a.totals[k];
    *a.pairs_found = found < 0x7FFFFFFF ? static_cast<int32_t>(found) : 0x7FFFFFFF;
  }
  const TreeAsker asker = tree_asker(a.tree, row);
  const int64_t first = a.before[asker.slot], count = a.counts[asker.slot];
  const int64_t left = a.capacity - first;
  const int64_t room = left < count ? left : count;
  if (first < 0 || room <= 0) return;
  SortedPairs mine = {a.pairs + first, room, 0};
  if (count <= kKept) {
    const Vec2i* const kept = a.kept + int64_t{asker.slot} * kKept;
    for (int64_t k = 0; k < room; ++k) mine.pairs[k] = kept[k];
    return;
  }
  const auto add = [&](int32_t other) { add_pair(mine, {asker.shape, other}); };
  // One with very many goes through all shapes, which come in the right order.
  if (asker.part < 0 && count * count > 4 * a.tree.shape_count)
    for_partners_among(a.tree, tree_shape(a.tree, asker.shape), 0, a.tree.shape_count, add);
  else
    for_partners(a.tree, asker, add);
}

}  // namespace novaphy
