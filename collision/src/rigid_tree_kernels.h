// Kernels for BroadPhase::Sap on a device. The kernels find the sorted pairs of box_pairs.h in a
// time that is proportional to the number of shapes and pairs.
//
// Shapes are sorted by world and, within a world, along a space-filling curve. A hierarchy of boxes
// covers the sorted shapes: each box covers kTreeWidth boxes of the level below. A search for the
// partners of a shape descends only into boxes that overlap the shape's box. The order of the
// shapes affects the time and not the pairs.
//
// A few shapes that may touch nearly all others, for example a ground, are kept outside of the tree
// (in the code: "apart"). All shapes test these shapes. Each of these shapes also tests all shapes,
// with one thread for kApartPart shapes. Each thread counts its partners and, after a scan of the
// counts, writes them.
#pragma once

#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/shape_pair_rule.h"

namespace novaphy {

inline constexpr int32_t kTreeBits = 3, kTreeWidth = 1 << kTreeBits;  // children per node
inline constexpr int32_t kApartPart = 4;
inline constexpr int32_t kStored = 12;  // partners that the count kernel stores for the writes

inline geometry::Box3 no_box() {
  return {{3.0e38f, 3.0e38f, 3.0e38f}, {-3.0e38f, -3.0e38f, -3.0e38f}};
}
inline void grow(geometry::Box3& all, const geometry::Box3& one) {
  all.lo = {math::min(all.lo.x, one.lo.x), math::min(all.lo.y, one.lo.y),
            math::min(all.lo.z, one.lo.z)};
  all.hi = {math::max(all.hi.x, one.hi.x), math::max(all.hi.y, one.hi.y),
            math::max(all.hi.z, one.hi.z)};
}

// Computes the bounds of the centers of every n-th shape in the tree.
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
                    Number<int64_t> bits;  // bits of the curve for each axis
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
  // NaN is sorted into the first cell.
  const auto cell = [last](float x) {
    return x > 0.0f ? static_cast<int32_t>(math::min(x, last)) : 0;
  };
  const int32_t x = cell(at.x), y = cell(at.y), z = cell(at.z);
  for (int32_t bit = bits - 1; bit >= 0; --bit)
    key = key << 3 | (x >> bit & 1) << 2 | (y >> bit & 1) << 1 | (z >> bit & 1);
  a.keys[row] = key;
}

// Returns child k of a node. If k is beyond the end of a level with `count` boxes, returns the last
// box. Loads then need no branch, so that the loads of all children run in parallel.
inline int64_t child(int64_t node, int32_t k, int64_t count) {
  const int64_t at = node * kTreeWidth + k;
  return at < count ? at : count - 1;
}

// A shape in the sorted order of the tree.
struct TreeEntry {
  geometry::Box3 box;  // a box with a NaN overlaps no box, not even an infinite one
  int32_t shape;
  int32_t unused;
};

// Writes the entries and the lowest level of boxes. A row of the launch is a group of eight
// entries.
struct RigidTreeEntryArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; Reads<int32_t> members, order;
                    Number<int64_t> count;  // number of entries
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

// Builds the next level of boxes.
struct RigidTreeLevelArguments {
  NOVAPHY_ARGUMENTS(Number<int64_t> below, count;  // level below: first node, count
                    Number<int64_t> above;         // first node of the level being built
                    Updates<geometry::Box3> nodes;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_level, RigidTreeLevelArguments) {
  geometry::Box3 all = no_box();
  for (int32_t k = 0; k < kTreeWidth; ++k) grow(all, a.nodes[a.below + child(row, k, a.count)]);
  a.nodes[a.above + row] = all;
}

// The tables of the search for partners, which are shapes whose boxes overlap.
struct RigidTreeTables {
  NOVAPHY_ARGUMENTS(
      Reads<RigidShape> shapes; Reads<int32_t> body, flags, group, world,
                                filter_starts;  // for each shape: start of its filtered shapes in
      Reads<int32_t> filtered;  // filtered[filter_starts[s]] .. [filter_starts[s + 1] - 1]
      Reads<int32_t> slots;     // for each shape: its first slot of counts
      Reads<int32_t> apart;     // the shapes outside of the tree
      Reads<TreeEntry> entries; Reads<geometry::Box3> nodes;  // level by level
      Reads<int32_t> levels;  // first node of each level; levels[0] is the lowest
      Reads<int32_t> starts;  // first entry of all worlds, of each world, and the end
      Number<int64_t> shape_count, entry_count, apart_count, level_count, segments;)
};
inline PairedShape paired_shape(const RigidTreeTables& a, int32_t shape) {
  return {a.body[shape], a.flags[shape], a.group[shape], a.world[shape]};
}

// The work of a thread in a search: a shape of the tree, or one part of the search of a shape
// outside of the tree.
struct TreeAsker {
  int32_t shape, slot;
  int32_t part;  // -1: a shape of the tree
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

// The data of the shape whose partners a thread searches.
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
// Returns whether `other` may touch the shape and is the second shape of the pair. The boxes of
// both shapes are known to overlap.
inline bool is_partner(const RigidTreeTables& a, const TreeShape& s, int32_t other) {
  const GeoType type = a.shapes[other].type;
  const PairedShape paired = paired_shape(a, other);
  if (other == s.shape || type < s.type || (type == s.type && other < s.shape)) return false;
  if (!may_touch_unfiltered(s.paired, paired)) return false;
  for (int32_t f = s.filter_begin; f < s.filter_end; ++f)
    if (a.filtered[f] == other) return false;
  return true;
}

// Calls visit(other) for the partners with an index in [begin, end), in ascending order.
template <class Visit>
void for_partners_among(const RigidTreeTables& a, const TreeShape& s, int64_t begin, int64_t end,
                        Visit& visit) {
  for (int64_t other = begin; other < end; ++other)
    if (geometry::boxes_meet(s.box, a.shapes[other].box) &&
        is_partner(a, s, static_cast<int32_t>(other)))
      visit(static_cast<int32_t>(other));
}
// Largest number of levels in for_partners_in, which packs one byte for each level into a word.
inline constexpr int32_t kTreeDepth = 8;
// Returns a bit mask over the children of a node. Bit k is set if the box of child k overlaps
// `box`, and the child contains some of the entries [begin, end).
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
// Calls visit(other) for the partners among the entries [begin, end), in their order in the tree.
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
        0;  // a byte per level: the children of its node that are still to be visited
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

// Collects the pairs of a shape in ascending order, and stores the first `room` of them.
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
  // for each slot
  NOVAPHY_ARGUMENTS(Part<RigidTreeTables> tree; Writes<int32_t> counts;
                    // kStored values for each slot
                    Writes<Vec2i> kept;)
};
NOVAPHY_ROW_KERNEL(rigid_tree_count, RigidTreeCountArguments) {
  const TreeAsker asker = tree_asker(a.tree, row);
  SortedPairs kept = {a.kept + int64_t{asker.slot} * kStored, kStored, 0};
  int32_t count = 0;
  for_partners(a.tree, asker, [&](int32_t other) {
    if (++count <= kStored) add_pair(kept, {asker.shape, other});
  });
  a.counts[asker.slot] = count;
}

// Sums the counts in 64 bits, for the case that a scan in 32 bits may overflow.
struct RigidTreeTotalArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> counts; Number<int64_t> slots;
                    WritesRow<int64_t> totals;  // partial sums over every n-th slot
  )
};
NOVAPHY_ROW_KERNEL(rigid_tree_total, RigidTreeTotalArguments) {
  int64_t total = 0;
  for (int64_t k = row; k < a.slots; k += n) total += a.counts[k];
  a.totals[row] = total;
}

struct RigidTreeWriteArguments {
  NOVAPHY_ARGUMENTS(Part<RigidTreeTables> tree;
                    Reads<int32_t> counts, before;  // counts, and their scan
                    // the partners that the count kernel stored, for slots with at most kStored
                    Reads<Vec2i> kept;
                    Optional<Reads<int64_t>> totals;       // null: the scan cannot overflow
                    Number<int64_t> total_rows, capacity;  // number of totals; room for pairs
                    Writes<Vec2i> pairs;                   // the first pairs, in ascending order
                    // number of all pairs; 2^31 - 1: at least this number
                    Writes<int32_t> pairs_found;)
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
  if (count <= kStored) {
    const Vec2i* const kept = a.kept + int64_t{asker.slot} * kStored;
    for (int64_t k = 0; k < room; ++k) mine.pairs[k] = kept[k];
    return;
  }
  const auto add = [&](int32_t other) { add_pair(mine, {asker.shape, other}); };
  // If a shape has very many partners, a loop over all shapes is faster, and already has the order.
  if (asker.part < 0 && count * count > 4 * a.tree.shape_count)
    for_partners_among(a.tree, tree_shape(a.tree, asker.shape), 0, a.tree.shape_count, add);
  else
    for_partners(a.tree, asker, add);
}

}  // namespace novaphy
