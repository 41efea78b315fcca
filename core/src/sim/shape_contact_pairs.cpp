#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

bool groups_meet(int32_t a, int32_t b) {
  if (a == 0 || b == 0) return false;
  return a > 0 && b > 0 ? a == b : a != b;
}

bool worlds_meet(int32_t a, int32_t b) { return a == b || a < 0 || b < 0; }

}  // namespace

std::vector<Vec2i> make_shape_contact_pairs(
    std::span<const int32_t> body, std::span<const int32_t> flags,
    std::span<const int32_t> collision_group, std::span<const int32_t> world,
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs) {
  const size_t count = body.size();
  require(flags.size() == count && collision_group.size() == count && world.size() == count,
          ErrorKind::Value, "make_shape_contact_pairs: expected ", count, " rows of each, got ",
          flags.size(), " flags, ", collision_group.size(), " groups and ", world.size(),
          " worlds");
  std::vector<Vec2i> pairs;
  // Without a moving shape there is no pair; this spares large static scenes the search.
  bool all_static = true;
  for (const int32_t b : body) all_static = all_static && b < 0;
  if (all_static) return pairs;

  for (size_t i = 0; i < count; ++i) {
    if (!has_flag(flags[i], ShapeFlags::COLLIDE_SHAPES)) continue;
    for (size_t j = i + 1; j < count; ++j) {
      // On one body, or both owned by the world (-1).
      if (body[i] == body[j] || (body[i] < 0 && body[j] < 0)) continue;
      if (!has_flag(flags[j], ShapeFlags::COLLIDE_SHAPES) || !worlds_meet(world[i], world[j]) ||
          !groups_meet(collision_group[i], collision_group[j])) {
        continue;
      }
      const std::pair<int32_t, int32_t> pair(static_cast<int32_t>(i), static_cast<int32_t>(j));
      if (!filter_pairs.contains(pair)) pairs.push_back({pair.first, pair.second});
    }
  }
  return pairs;
}

}  // namespace novaphy
