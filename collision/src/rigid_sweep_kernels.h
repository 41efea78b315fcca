// Sweep and prune as kernels: the pairs of BroadPhase::Sap, found on the device of the shapes.
//
// Shapes are sorted by world and, within it, by the lower end of their boxes along one axis. Over
// the sorted ones stand two levels of intervals, each of kSweepChunk of the level below, so that a
// shape asks those only whose boxes overlap its own along the axis. Every shape counts its partners
// and, behind a scan of the counts, writes them in ascending order: the pairs are those of
// box_pairs.h, sorted, whatever the axis.
#pragma once

#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/shape_pair_rule.h"

namespace novaphy {

inline constexpr int64_t kSweepChunk = 32;

// In the order of the sweep. Of what meets nothing, which comes last, `shape` is -1.
struct SweepEntry {
  geometry::Box3 box;
  int32_t shape;
  int32_t unused;
};
struct SweepInterval {
  float lo, hi;
};
inline SweepInterval no_interval() { return {3.0e38f, -3.0e38f}; }

struct RigidSweepKeyArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; Number<int64_t> axis;
                    WritesRow<int32_t> keys;  // ascending as the lower ends
  )
};
NOVAPHY_ROW_KERNEL(rigid_sweep_key, RigidSweepKeyArguments) {
  const geometry::Box3& box = a.shapes[row].box;
  const float lower = geometry::component(box.lo, static_cast<int32_t>(a.axis));
  const int32_t bits = math::float_bits(lower);
  const int32_t key = bits < 0 ? bits ^ 0x7FFFFFFF : bits;
  a.keys[row] = geometry::boxes_meet(box, box) ? key : 0x7FFFFFFF;
}

struct RigidSweepWorldArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes; ReadsRow<int32_t> order;  // of the keys
                    Reads<int32_t> world;
                    WritesRow<int32_t> segments;  // of the sorted shapes: 0 for all worlds, then
                                                  // the worlds; -1: meets nothing
  )
};
NOVAPHY_ROW_KERNEL(rigid_sweep_world, RigidSweepWorldArguments) {
  const int32_t shape = a.order[row];
  const geometry::Box3& box = a.shapes[shape].box;
  const int32_t world = a.world[shape];
  a.segments[row] = !geometry::boxes_meet(box, box) ? -1 : world < 0 ? 0 : world + 1;
}

struct RigidSweepSortArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidShape> shapes;
                    Reads<int32_t> order, starts;  // of the segments in `items`, and the end
                    Reads<int32_t> items;          // rows of `order`, segment by segment
                    Number<int64_t> segments; Writes<SweepEntry> entries;)
};
NOVAPHY_ROW_KERNEL(rigid_sweep_sort, RigidSweepSortArguments) {
  SweepEntry& entry = a.entries[row];
  entry.shape = -1;
  if (row >= a.starts[a.segments]) return;
  entry.shape = a.order[a.items[row]];
  entry.box = a.shapes[entry.shape].box;
}

struct RigidSweepChunkArguments {
  NOVAPHY_ARGUMENTS(Reads<SweepEntry> entries;
                    Optional<Reads<SweepInterval>> below;  // null: the entries themselves
                    Number<int64_t> count;                 // of those
                    Number<int64_t> axis; Writes<SweepInterval> chunks;)
};
NOVAPHY_ROW_KERNEL(rigid_sweep_chunk, RigidSweepChunkArguments) {
  SweepInterval all = no_interval();
  const int64_t end = (row + 1) * kSweepChunk < a.count ? (row + 1) * kSweepChunk : a.count.value;
  for (int64_t k = row * kSweepChunk; k < end; ++k) {
    SweepInterval one = no_interval();
    if (a.below != nullptr) {
      one = a.below[k];
    } else if (a.entries[k].shape >= 0) {
      one = {geometry::component(a.entries[k].box.lo, static_cast<int32_t>(a.axis)),
             geometry::component(a.entries[k].box.hi, static_cast<int32_t>(a.axis))};
    }
    all.lo = math::min(all.lo, one.lo);
    all.hi = math::max(all.hi, one.hi);
  }
  a.chunks[row] = all;
}

// What partners are asked by.
struct RigidSweepTables {
  NOVAPHY_ARGUMENTS(
      Reads<RigidShape> shapes; Reads<int32_t> body, flags, group, world,
                                filter_starts;  // of every shape: those that it never touches are
      Reads<int32_t> filtered;  // filtered[filter_starts[s]] .. [filter_starts[s + 1] - 1]
      Reads<SweepEntry> entries; Reads<SweepInterval> chunks;  // of entries
      Reads<SweepInterval> coarse;                             // of chunks
      Reads<int32_t> starts; Number<int64_t> segments, axis;)
};
inline PairedShape paired_shape(const RigidSweepTables& a, int32_t shape) {
  return {a.body[shape], a.flags[shape], a.group[shape], a.world[shape]};
}

// Whether `other`, with that box, may touch the shape, their boxes meet, and the shape stands first
// in the pair.
inline bool is_partner(const RigidSweepTables& a, int32_t shape, int32_t other,
                       const geometry::Box3& other_box) {
  const RigidShape& own = a.shapes[shape];
  if (other == shape || !geometry::boxes_meet(own.box, other_box)) return false;
  const GeoType type = a.shapes[other].type;
  if (type < own.type || (type == own.type && other < shape)) return false;
  if (!may_touch_unfiltered(paired_shape(a, shape), paired_shape(a, other))) return false;
  for (int32_t f = a.filter_starts[shape]; f < a.filter_starts[shape + 1]; ++f)
    if (a.filtered[f] == other) return false;
  return true;
}

// Calls visit(other) for each shape of the entries [begin, end) that may touch the shape, whose box
// meets its own, and before which it stands in a pair.
template <class Visit>
void for_partners_in(const RigidSweepTables& a, int32_t shape, int64_t begin, int64_t end,
                     Visit& visit) {
  const RigidShape& own = a.shapes[shape];
  const auto axis = static_cast<int32_t>(a.axis);
  const float lo = geometry::component(own.box.lo, axis),
              hi = geometry::component(own.box.hi, axis);
  const auto apart = [&](const SweepInterval& i) { return i.lo > hi || i.hi < lo; };
  for (int64_t k = begin; k < end;) {
    if (k % (kSweepChunk * kSweepChunk) == 0 && apart(a.coarse[k / (kSweepChunk * kSweepChunk)])) {
      k += kSweepChunk * kSweepChunk;
      continue;
    }
    if (k % kSweepChunk == 0 && apart(a.chunks[k / kSweepChunk])) {
      k += kSweepChunk;
      continue;
    }
    const SweepEntry& entry = a.entries[k++];
    if (entry.shape >= 0 && is_partner(a, shape, entry.shape, entry.box)) visit(entry.shape);
  }
}
template <class Visit>
void for_partners(const RigidSweepTables& a, int32_t shape, Visit visit) {
  const int32_t world = a.world[shape];
  if (!has_flag(a.flags[shape], ShapeFlags::COLLIDE_SHAPES)) return;
  if (world < 0) {
    for_partners_in(a, shape, 0, a.starts[a.segments], visit);
  } else {
    for_partners_in(a, shape, 0, a.starts[1], visit);
    for_partners_in(a, shape, a.starts[world + 1], a.starts[world + 2], visit);
  }
}

struct RigidSweepCountArguments {
  NOVAPHY_ARGUMENTS(Part<RigidSweepTables> sweep;
                    WritesRow<int32_t> counts;  // partners of each shape
  )
};
NOVAPHY_ROW_KERNEL(rigid_sweep_count, RigidSweepCountArguments) {
  int32_t count = 0;
  for_partners(a.sweep, static_cast<int32_t>(row), [&](int32_t) { ++count; });
  a.counts[row] = count;
}

// Where a scan of the counts may wrap.
struct RigidSweepTotalArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> counts; Number<int64_t> shapes;
                    WritesRow<int64_t> totals;  // of every n-th shape
  )
};
NOVAPHY_ROW_KERNEL(rigid_sweep_total, RigidSweepTotalArguments) {
  int64_t total = 0;
  for (int64_t k = row; k < a.shapes; k += n) total += a.counts[k];
  a.totals[row] = total;
}

struct RigidSweepWriteArguments {
  NOVAPHY_ARGUMENTS(Part<RigidSweepTables> sweep;
                    ReadsRow<int32_t> counts, before;      // a scan of the counts
                    Optional<Reads<int64_t>> totals;       // null: the scan cannot wrap
                    Number<int64_t> total_rows, capacity;  // of the pairs
                    Writes<Vec2i> pairs;                   // the first ones, in ascending order
                    Writes<int32_t> pairs_found;           // all of them; 2^31 - 1: as many or more
  )
};
NOVAPHY_ROW_KERNEL(rigid_sweep_write, RigidSweepWriteArguments) {
  const int64_t first = a.before[row];
  if (row == n - 1) {
    int64_t found = first + a.counts[row];
    if (a.totals != nullptr) found = 0;
    for (int64_t k = 0; a.totals != nullptr && k < a.total_rows; ++k) found += a.totals[k];
    *a.pairs_found = found < 0x7FFFFFFF ? static_cast<int32_t>(found) : 0x7FFFFFFF;
  }
  const int64_t left = a.capacity - first;
  const int64_t room = left < a.counts[row] ? left : a.counts[row];
  if (first < 0 || room <= 0) return;
  Vec2i* const mine = a.pairs + first;
  // One with very many, as a plane has, goes through all shapes: their order is the right one.
  constexpr int32_t kMany = 64;
  const bool many = a.counts[row] > kMany;
  const int64_t last = many ? n : 0;
  int64_t taken = 0;
  for (int64_t other = 0; other < last && taken < room; ++other)
    if (is_partner(a.sweep, static_cast<int32_t>(row), static_cast<int32_t>(other),
                   a.sweep.shapes[other].box))
      mine[taken++] = {static_cast<int32_t>(row), static_cast<int32_t>(other)};
  if (many) return;
  int64_t count = 0;
  for_partners(a.sweep, static_cast<int32_t>(row), [&](int32_t other) {
    if (count == room && mine[count - 1].y < other) return;
    int64_t k = count < room ? count++ : count - 1;
    for (; k > 0 && mine[k - 1].y > other; --k) mine[k] = mine[k - 1];
    mine[k] = {static_cast<int32_t>(row), other};
  });
}

}  // namespace novaphy
