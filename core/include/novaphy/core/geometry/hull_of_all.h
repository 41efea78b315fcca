// The convex hull of points with all of its vertices, for masses.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

// As triangles, 3 indices into `points` each, counter-clockwise seen from outside. Faces are not
// merged. Errors as those of the points in convex_hull (convex_hull.h).
NOVAPHY_CORE_API std::vector<int32_t> hull_of_all(std::span<const Vec3f> points);

}  // namespace novaphy
