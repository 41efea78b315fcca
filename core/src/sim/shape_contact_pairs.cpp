#include <algorithm>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/sim/shape_pair_rule.h"
#include "novaphy/core/sim/shape_pair_rules.h"

namespace novaphy {

void check_rules(const char* function, const ShapePairRules& rules) {
  const size_t count = rules.body.size();
  require(rules.flags.size() == count && rules.collision_group.size() == count &&
              rules.world.size() == count,
          ErrorKind::Value, function, ": expected ", count, " rows of each, got ",
          rules.flags.size(), " flags, ", rules.collision_group.size(), " groups and ",
          rules.world.size(), " worlds");
}

bool may_touch(const ShapePairRules& rules, int32_t first, int32_t second) {
  const auto i = static_cast<size_t>(first), j = static_cast<size_t>(second);
  const auto of = [&](size_t s) {
    return PairedShape{rules.body[s], rules.flags[s], rules.collision_group[s], rules.world[s]};
  };
  if (!may_touch_unfiltered(of(i), of(j))) return false;
  return rules.filter_pairs == nullptr ||
         !rules.filter_pairs->contains({std::min(first, second), std::max(first, second)});
}

std::vector<Vec2i> make_shape_contact_pairs(
    std::span<const int32_t> body, std::span<const int32_t> flags,
    std::span<const int32_t> collision_group, std::span<const int32_t> world,
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs) {
  const ShapePairRules rules{body, flags, collision_group, world, &filter_pairs};
  check_rules("make_shape_contact_pairs", rules);
  std::vector<Vec2i> pairs;
  // Without a moving shape there is no pair; this spares large static scenes the search.
  if (std::all_of(body.begin(), body.end(), [](int32_t b) { return b < 0; })) return pairs;
  const auto count = static_cast<int32_t>(body.size());
  for (int32_t i = 0; i < count; ++i) {
    if (!has_flag(flags[static_cast<size_t>(i)], ShapeFlags::COLLIDE_SHAPES)) continue;
    for (int32_t j = i + 1; j < count; ++j)
      if (may_touch(rules, i, j)) pairs.push_back({i, j});
  }
  return pairs;
}

}  // namespace novaphy
