// Rules for pairs of shapes that may touch, whatever their poses.
#pragma once

#include <cstdint>
#include <set>
#include <span>
#include <utility>

#include "novaphy/core/export.h"

namespace novaphy {

// A row per shape; `body` -1 is the world, `world` -1 all worlds. The arrays and the set of pairs
// (i < j) that never touch belong to the caller.
struct ShapePairRules {
  std::span<const int32_t> body, flags, collision_group, world;
  const std::set<std::pair<int32_t, int32_t>>* filter_pairs = nullptr;  // null: none
};

// ErrorKind::Value unless there are as many rows of each; `function` is who asks.
NOVAPHY_CORE_API void check_rules(const char* function, const ShapePairRules& rules);

// True if both collide with shapes, worlds and groups meet, they are not on one body nor both
// world-owned, and the pair is not filtered. i != j, both within the rows.
NOVAPHY_CORE_API bool may_touch(const ShapePairRules& rules, int32_t i, int32_t j);

}  // namespace novaphy
