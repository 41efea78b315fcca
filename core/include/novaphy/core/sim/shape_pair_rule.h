// The rule whether two shapes may touch, whatever their poses, shared by host and device.
// shape_pair_rules.h also checks the filtered pairs. The header includes no standard library.
#pragma once

#include "novaphy/core/sim/enums.h"

namespace novaphy {

struct PairedShape {
  int32_t body;  // -1: the world
  int32_t flags, collision_group;
  int32_t world;  // -1: all worlds
};

inline bool groups_meet(int32_t a, int32_t b) {
  if (a == 0 || b == 0) return false;
  return a > 0 && b > 0 ? a == b : a != b;
}

// Returns whether both shapes collide with shapes, their worlds and groups are compatible, and they
// belong to different bodies and not both to the world.
inline bool may_touch_unfiltered(const PairedShape& a, const PairedShape& b) {
  if (a.body == b.body || (a.body < 0 && b.body < 0)) return false;
  return has_flag(a.flags, ShapeFlags::COLLIDE_SHAPES) &&
         has_flag(b.flags, ShapeFlags::COLLIDE_SHAPES) &&
         (a.world == b.world || a.world < 0 || b.world < 0) &&
         groups_meet(a.collision_group, b.collision_group);
}

}  // namespace novaphy
