// The broad phases: they find pairs of shapes that may touch (core/sim/shape_pair_rules.h) and
// whose bounding boxes overlap. All three functions return the same pairs (i < j), sorted by (i,
// j), without duplicates. Boxes that only touch count as overlapping. A box with a NaN overlaps no
// box.
//
// Each function first counts the pairs and then writes them, so that the result is allocated once.
// ErrorKind::Value: more than `limit` pairs (the message has their number), or rules without one
// row for each box.
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

// Returns the candidates whose boxes overlap. The candidates (i < j) are sorted and accepted by the
// rules.
NOVAPHY_COLLISION_API std::vector<Vec2i> explicit_box_pairs(std::span<const geometry::Box3> boxes,
                                                            std::span<const Vec2i> candidates,
                                                            int64_t limit = kNoPairLimit);

// Tests every pair of shapes.
NOVAPHY_COLLISION_API std::vector<Vec2i> nxn_box_pairs(std::span<const geometry::Box3> boxes,
                                                       const ShapePairRules& rules,
                                                       int64_t limit = kNoPairLimit);

// Sweep and prune. The shapes are sorted by the lower end of their boxes along the axis on which
// the centers vary most. Ties are broken by index. Each shape is tested against the shapes that
// begin before it ends, world by world. Shapes of all worlds (-1) take part in every world. For n
// shapes the time is n log n, plus the number of pairs that overlap on the axis.
//
// The object stores the order of the last call as a start for the next sort, which is fast if
// shapes move little. The stored order does not affect the result.
class NOVAPHY_COLLISION_API SweepAndPrune {
 public:
  std::vector<Vec2i> box_pairs(std::span<const geometry::Box3> boxes, const ShapePairRules& rules,
                               int64_t limit = kNoPairLimit);

 private:
  std::vector<int32_t> order_;  // order of the last call
};

}  // namespace novaphy
