// Volume, center and inertia of a solid that a triangle mesh encloses, in double precision.
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
// Parts that are closed each add; a cavity is a part that is wound inwards. `is_hull`: triangles of
// hull_triangles, which are closed, though faces of a hull may meet where one has a vertex more.
//
// ErrorKind::Value, naming the edge or triangle: indices not a multiple of 3 or out of range; a
// vertex that is not finite; a mesh that is open or has triangles wound against each other (each
// edge must come once in each direction); one that is inside out (negative volume), or encloses
// less than 1e-12 of the cube of its extent.
NOVAPHY_CORE_API SolidProperties mesh_properties(std::span<const Vec3f> vertices,
                                                 std::span<const int32_t> indices,
                                                 bool is_hull = false);

// Of the wall of `thickness` (m) inside of the surface. The hollow has the same triangles, each
// vertex moved to where it lies `thickness` below the planes of all its triangles (least squares,
// weighted by the angles at the vertex, where they are more than three): exact for a box, to second
// order of the edges over the thickness for round surfaces.
//
// ErrorKind::Value: as above; a thickness that is not > 0, or so large that the hollow has no
// volume or a triangle that is turned over.
NOVAPHY_CORE_API SolidProperties shell_properties(std::span<const Vec3f> vertices,
                                                  std::span<const int32_t> indices, float thickness,
                                                  bool is_hull = false);

}  // namespace novaphy
