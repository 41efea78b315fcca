// The broad phases: pairs of shapes that may touch (core/sim/shape_pair_rules.h) and whose bounding
// boxes overlap. All three functions return the same pairs (i < j), sorted by (i, j), each once.
// Touching boxes overlap. A box with a NaN overlaps nothing.
//
// A function first counts the pairs and then writes them, so no list grows. ErrorKind::Value: more
// than `limit` pairs (the message has their number), or rules without one row per box.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/collision/geometry/mesh_view.h"
#include "novaphy/core/sim/shape_pair_rules.h"

namespace novaphy {

inline constexpr int64_t kNoPairLimit = std::numeric_limits<int32_t>::max();

// Filters a list of candidates, each (i < j), sorted, which the rules have already accepted.
NOVAPHY_COLLISION_API std::vector<Vec2i> explicit_box_pairs(std::span<const geometry::Box3> boxes,
                                                            std::span<const Vec2i> candidates,
                                                            int64_t limit = kNoPairLimit);

// Tests every pair of shapes.
NOVAPHY_COLLISION_API std::vector<Vec2i> nxn_box_pairs(std::span<const geometry::Box3> boxes,
                                                       const ShapePairRules& rules,
                                                       int64_t limit = kNoPairLimit);

// Sweep and prune. Shapes are sorted by the lower end of their boxes along the axis on which the
// centers vary most, with ties by index. Each shape is tested against the shapes that begin before
// it ends, world by world. Shapes of all worlds (-1) take part in every world. The time is n log n
// for n shapes, plus the number of pairs that overlap on the axis.
//
// The object keeps the order of the last call as a start for the next sort, which is fast if shapes
// move little. The kept order does not affect the result.
class NOVAPHY_COLLISION_API SweepAndPrune {
 public:
  std::vector<Vec2i> box_pairs(std::span<const geometry::Box3> boxes, const ShapePairRules& rules,
                               int64_t limit = kNoPairLimit);

 private:
  std::vector<int32_t> order_;  // order of the last call
};

}  // namespace novaphy
