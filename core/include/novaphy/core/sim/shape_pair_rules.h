// Rules that say which pairs of shapes may touch, whatever their poses.
#pragma once

#include <cstdint>
#include <set>
#include <span>
#include <utility>

#include "novaphy/core/export.h"

namespace novaphy {

// The input of the rules, with one row per shape. `body` -1 is the world, `world` -1 means all
// worlds. The caller owns the arrays and the set of filtered pairs (i < j).
struct ShapePairRules {
  std::span<const int32_t> body, flags, collision_group, world;
  const std::set<std::pair<int32_t, int32_t>>* filter_pairs = nullptr;  // null: none
};

// Throws ErrorKind::Value unless all columns have the same number of rows. `function` is the
// caller, for the message.
NOVAPHY_CORE_API void check_rules(const char* function, const ShapePairRules& rules);

// Returns whether two shapes i != j may collide. Both must collide with shapes, have compatible
// worlds and groups, and belong to different bodies. A pair of two world shapes and a filtered pair
// do not collide.
NOVAPHY_CORE_API bool may_touch(const ShapePairRules& rules, int32_t i, int32_t j);

}  // namespace novaphy
