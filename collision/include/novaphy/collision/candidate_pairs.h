// The pairs of a particle and a shape that a search for soft contacts has to test.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Pairs of a particle and a shape with ShapeFlags.COLLIDE_PARTICLES. Both have the same world, or
// one of them belongs to all worlds (-1). The pairs are sorted by shape, and then by particle.
struct CandidatePairs {
  std::vector<int32_t> particle, shape;
};

// Makes the pairs from the model's arrays on the host. The time is linear in the number of
// particles, shapes and pairs. ErrorKind::Value: more pairs than int32 can count.
NOVAPHY_COLLISION_API CandidatePairs make_candidate_pairs(const Model& model);

}  // namespace novaphy
