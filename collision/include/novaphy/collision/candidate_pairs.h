// The pairs of a particle and a shape that may touch: the candidates of every search for soft
// contacts.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Pairs of a particle and a shape with ShapeFlags.COLLIDE_PARTICLES whose worlds are equal, or of
// which one belongs to all worlds (-1). The order is shape-major: the particles of the first
// colliding shape in ascending order, then those of the second, and so on.
struct CandidatePairs {
  std::vector<int32_t> particle, shape;
};

// Makes the pairs from the model's arrays on the host, in time linear in particles, shapes and
// pairs. ErrorKind::Value: more pairs than int32 can count.
NOVAPHY_COLLISION_API CandidatePairs make_candidate_pairs(const Model& model);

}  // namespace novaphy
