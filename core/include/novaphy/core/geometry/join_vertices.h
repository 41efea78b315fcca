// Vertices in one place.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

// For each vertex the first one in the same place, where numbers are equal (0 and -0 are).
NOVAPHY_CORE_API std::vector<int32_t> first_in_place(std::span<const Vec3f> vertices);

}  // namespace novaphy
