// Volume, centre and inertia of a solid that a triangle mesh encloses, in double precision.
#pragma once

#include <cstdint>
#include <span>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct SolidProperties {
  double volume = 0.0;      // m^3
  Vec3<double> com{};       // m
  Mat33<double> inertia{};  // m^5: about com, of density 1
};

// Integrals over the tetrahedra between each triangle (3 indices, counter-clockwise seen from
// outside) and the middle of the vertices' box, so that a place far from the origin loses nothing.
// Parts that are closed each add; a cavity is a part that is wound inwards.
//
// ErrorKind::Value, naming the edge or triangle: indices not a multiple of 3 or out of range; a
// vertex that is not finite; a mesh that is open or has triangles wound against each other (each
// edge must come once in each direction); one that is inside out (negative volume), or encloses
// less than 1e-12 of the cube of its extent.
NOVAPHY_CORE_API SolidProperties mesh_properties(std::span<const Vec3f> vertices,
                                                 std::span<const int32_t> indices);

}  // namespace novaphy
