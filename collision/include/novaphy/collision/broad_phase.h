// How the pairs of shapes that may touch are found. Particle contacts always look at every
// (particle, shape) pair.
#pragma once

#include <string_view>

#include "novaphy/collision/export.h"

namespace novaphy {

enum class BroadPhase {
  Explicit,  // the pairs of Model::shape_contact_pairs
  NxN,       // every pair of shapes
  Sap,       // the pairs whose boxes meet: sweep and prune, or a tree of boxes
};

// "explicit", "nxn", "sap"; anything else throws ErrorKind::Value.
NOVAPHY_COLLISION_API BroadPhase parse_broad_phase(std::string_view name);
NOVAPHY_COLLISION_API const char* broad_phase_name(BroadPhase broad_phase);

}  // namespace novaphy
