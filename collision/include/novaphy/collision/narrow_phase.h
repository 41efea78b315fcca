// The choice of the method that measures the overlap of two convex hulls.
#pragma once

#include <string_view>

#include "novaphy/collision/export.h"

namespace novaphy {

enum class NarrowPhase {
  Auto,  // collision/geometry/, for all pairs
  // Overlap, depth and normal of penetrating pairs of convex hulls from FCL's libccd solver, in
  // double precision, on the CPU; not within a capture. An answer whose normal is not of unit
  // length, whose depth is not that along its normal, or that differs from Auto's by more than 1e-4
  // of the size of the pair (libccd's MPR is wrong in about a sixth of all poses) counts as none:
  // the pair has Auto's rows then. Needs a build with NOVAPHY_WITH_FCL.
  Fcl,
};

// "auto", "fcl"; anything else throws ErrorKind::Value.
NOVAPHY_COLLISION_API NarrowPhase parse_narrow_phase(std::string_view name);
NOVAPHY_COLLISION_API const char* narrow_phase_name(NarrowPhase narrow_phase);

}  // namespace novaphy
