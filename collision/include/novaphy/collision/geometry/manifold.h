// The contact points of a pair of shapes: at most 8, with one normal.
//
// `normal` is a unit vector from A to B. A point lies midway between the two surfaces; `distance`
// (m) is signed along the normal, < 0 where the shapes overlap, and the surface points are
//   on A: position - normal (distance / 2),    on B: position + normal (distance / 2).
// `feature` names what of A meets what of B. It is unique within a manifold and stays the same
// while the same features touch, so contacts can be followed from step to step.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::geometry {

inline constexpr int32_t kManifoldCapacity = 8;

struct ContactPoint {
  Vec3f position{};      // m
  float distance{};      // m
  int32_t feature = -1;  // -1: none
};

template <int32_t Capacity>
struct ContactSet {
  Vec3f normal{};
  int32_t count = 0;
  ContactPoint points[Capacity];
};
using Manifold = ContactSet<kManifoldCapacity>;

// Adds a point where there is room; a full set stays as it is.
template <int32_t Capacity>
void add_contact(ContactSet<Capacity>& set, const Vec3f& position, float distance,
                 int32_t feature) {
  if (set.count < Capacity) set.points[set.count++] = {position, distance, feature};
}

}  // namespace novaphy::geometry
