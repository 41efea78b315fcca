// Finds vertices that share a position.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Returns for each vertex the index of the first vertex with the same position. Positions are the
// same if their numbers are equal (0 equals -0).
NOVAPHY_CORE_API std::vector<int32_t> first_at_position(std::span<const Vec3f> vertices);

}  // namespace novaphy
