// The broad phases: the pairs of shapes that may touch (core/sim/shape_pair_rules.h) and whose
// boxes meet. All three return the same pairs, (i < j), sorted by (i, j), each once; touching boxes
// meet, and a box with a NaN meets nothing.
//
// Two passes: the pairs are counted, then written, so nothing grows. More than `limit` pairs:
// ErrorKind::Value with their number. The rules need a box per row (ErrorKind::Value).
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

// Those of a list of candidates, each (i < j), sorted, that the rules have allowed before.
NOVAPHY_COLLISION_API std::vector<Vec2i> explicit_box_pairs(std::span<const geometry::Box3> boxes,
                                                            std::span<const Vec2i> candidates,
                                                            int64_t limit = kNoPairLimit);

// Every pair is asked.
NOVAPHY_COLLISION_API std::vector<Vec2i> nxn_box_pairs(std::span<const geometry::Box3> boxes,
                                                       const ShapePairRules& rules,
                                                       int64_t limit = kNoPairLimit);

// Sweep and prune: shapes are sorted by the lower end of their boxes along the axis on which the
// centers vary most, ties by index, and each is asked against those that begin before it ends,
// world by world. Shapes of all worlds (-1) are swept with each world. Time for n shapes:
// n log n, less the pairs that overlap on the axis.
//
// The object keeps the order of the last call, which is nearly that of the next one where shapes
// move little; it changes the time, not the result.
class NOVAPHY_COLLISION_API SweepAndPrune {
 public:
  std::vector<Vec2i> box_pairs(std::span<const geometry::Box3> boxes, const ShapePairRules& rules,
                               int64_t limit = kNoPairLimit);

 private:
  std::vector<int32_t> order_;  // of the last call
};

}  // namespace novaphy
