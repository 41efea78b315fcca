// The choice of the narrow phase for two convex hulls.
#pragma once

#include <string_view>

#include "novaphy/collision/export.h"

namespace novaphy {

enum class NarrowPhase {
  Auto,  // collision/geometry/ for all pairs
  // Overlapping convex hulls get depth and normal from FCL's libccd solver in double precision, on
  // the CPU and outside of captures. Needs a build with NOVAPHY_WITH_FCL. A result is rejected if
  // the normal is not a unit vector or the depth is not the depth along the normal. A result is
  // also rejected if it differs from Auto by more than 1e-4 of the size of the pair. A pair with a
  // rejected result has the rows of Auto. (libccd's MPR is wrong in about a sixth of all poses.)
  Fcl,
};

// Reads "auto" or "fcl". Throws ErrorKind::Value for any other text.
NOVAPHY_COLLISION_API NarrowPhase parse_narrow_phase(std::string_view name);
NOVAPHY_COLLISION_API const char* narrow_phase_name(NarrowPhase narrow_phase);

}  // namespace novaphy
