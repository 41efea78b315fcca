#include <algorithm>
#include <map>
#include <numeric>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/sim/shape_pair_list.h"
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
  // Without a moving shape no pair exists. The early return saves the search in large static
  // scenes.
  if (std::all_of(body.begin(), body.end(), [](int32_t b) { return b < 0; })) return pairs;
  // A shape collides with shapes of its world and of all worlds. A shape of all worlds collides
  // with any shape.
  const auto count = static_cast<int32_t>(body.size());
  std::map<int32_t, std::vector<int32_t>> of_world;  // keyed by world, ascending; -1: all worlds
  for (int32_t s = 0; s < count; ++s)
    of_world[std::max(world[static_cast<size_t>(s)], -1)].push_back(s);
  const std::vector<int32_t>& shared = of_world[-1];
  std::vector<int32_t> others;
  for (int32_t i = 0; i < count; ++i) {
    if (!has_flag(flags[static_cast<size_t>(i)], ShapeFlags::COLLIDE_SHAPES)) continue;
    const int32_t w = world[static_cast<size_t>(i)];
    others.clear();
    const auto add_behind = [&](const std::vector<int32_t>& shapes) {
      others.insert(others.end(), std::upper_bound(shapes.begin(), shapes.end(), i), shapes.end());
    };
    if (w < 0) {
      others.resize(static_cast<size_t>(count - i - 1));
      std::iota(others.begin(), others.end(), i + 1);
    } else {
      add_behind(of_world[w]);
      const auto own = static_cast<std::ptrdiff_t>(others.size());
      add_behind(shared);
      std::inplace_merge(others.begin(), others.begin() + own, others.end());
    }
    for (const int32_t j : others)
      if (may_touch(rules, i, j)) pairs.push_back({i, j});
    require(pairs.size() <= ShapePairList::kMostPairs, ErrorKind::Value,
            "shape_contact_pairs: expected at most ", ShapePairList::kMostPairs,
            " pairs that may touch, got more of ", count,
            " shapes; the broad phase \"sap\" lists none");
  }
  return pairs;
}

void ShapePairList::set(DeviceArray<Vec2i> pairs) {
  pairs_ = std::move(pairs);
  made_.store(true, std::memory_order_release);
}

const DeviceArray<Vec2i>& ShapePairList::get(
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs, Device device) const {
  if (is_made()) return pairs_;
  const std::lock_guard lock(mutex_);
  if (is_made()) return pairs_;
  const UntrackedScope untracked;  // a capture must not record this
  std::vector<Vec2i> pairs;
  if (columns_ != nullptr)
    pairs = make_shape_contact_pairs(columns_->body, columns_->flags, columns_->collision_group,
                                     columns_->world, filter_pairs);
  pairs_ = DeviceArray<Vec2i>::from_host(pairs, device);
  made_.store(true, std::memory_order_release);
  return pairs_;
}

}  // namespace novaphy
