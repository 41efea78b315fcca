// The convex hull of points with all of its vertices. Mass properties are computed from this hull.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Returns the hull as triangles, 3 indices into `points` each, counter-clockwise seen from outside.
// Faces are not merged. Throws the same errors about points as convex_hull (convex_hull.h).
NOVAPHY_CORE_API std::vector<int32_t> hull_of_all(std::span<const Vec3f> points);

}  // namespace novaphy
