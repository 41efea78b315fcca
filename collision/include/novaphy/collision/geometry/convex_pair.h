// The general pair of convex shapes: distance by GJK, penetration by EPA, manifold by clipping.
// collide.h uses closed forms where they exist. Frame of A, m.
#pragma once

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/collision/geometry/epa.h"

namespace novaphy::geometry {

// Returns the proximity of a pair. If the distance exceeds `limit` (m), the result is a lower bound
// of the distance that also exceeds `limit`.
NOVAPHY_OUT_OF_LINE Proximity convex_proximity(const ShapePair& pair, float limit) {
  const float ra = core_radius(*pair.a), rb = core_radius(*pair.b);
  GjkResult gjk_result = gjk(pair, (limit + ra) + rb);
  Proximity proximity{gjk_result.normal, gjk_result.distance, gjk_result.on_a, gjk_result.on_b};
  if (gjk_result.status == GjkStatus::TOUCHING) {
    const Penetration p = epa(pair, gjk_result.simplex);
    proximity = {p.normal, -p.depth, p.on_a, p.on_b};
  }
  proximity.distance = (proximity.distance - ra) - rb;
  proximity.on_a = proximity.on_a + proximity.normal * ra;
  proximity.on_b = proximity.on_b - proximity.normal * rb;
  return proximity;
}

inline Manifold collide_convex(const ShapePair& pair, float gap) {
  return clip_manifold(pair, convex_proximity(pair, gap), gap);
}

}  // namespace novaphy::geometry
