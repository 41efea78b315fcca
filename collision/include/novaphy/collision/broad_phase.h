// The choice of the broad phase for pairs of shapes. Contacts of particles always test every pair
// (particle, shape).
#pragma once

#include <string_view>

#include "novaphy/collision/export.h"

namespace novaphy {

enum class BroadPhase {
  Explicit,  // the pairs of Model::shape_contact_pairs
  NxN,       // every pair of shapes
  Sap,       // the pairs whose boxes overlap: sweep and prune, or a tree of boxes
};

// Reads "explicit", "nxn" or "sap". Throws ErrorKind::Value for any other text.
NOVAPHY_COLLISION_API BroadPhase parse_broad_phase(std::string_view name);
NOVAPHY_COLLISION_API const char* broad_phase_name(BroadPhase broad_phase);

}  // namespace novaphy
