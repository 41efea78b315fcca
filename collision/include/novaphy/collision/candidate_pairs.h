// The particles and shapes that may meet: the candidates of every search for soft contacts.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Pairs of a particle and a shape with ShapeFlags.COLLIDE_PARTICLES, of one world or with one of
// both in all worlds (-1). Shape-major: all particles that may meet the first colliding shape, in
// ascending order, then those of the second, ...
struct CandidatePairs {
  std::vector<int32_t> particle, shape;
};

// Reads the model's arrays on the host; takes time linear in the particles, the shapes and the
// pairs. ErrorKind::Value: more pairs than int32 counts.
NOVAPHY_COLLISION_API CandidatePairs make_candidate_pairs(const Model& model);

}  // namespace novaphy
