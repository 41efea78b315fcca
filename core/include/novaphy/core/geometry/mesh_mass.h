// Volume, center of mass and inertia of a solid inside of a triangle mesh, in double precision.
#pragma once

#include <cstdint>
#include <span>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct SolidProperties {
  double volume = 0.0;      // m^3
  Vec3<double> com{};       // m
  Mat33<double> inertia{};  // m^5: about com, for density 1
};

// Integrates over the tetrahedra between each triangle (3 indices, counter-clockwise seen from
// outside) and the middle of the bounding box. The middle as reference keeps the precision of
// meshes far from the origin. Every closed part adds its volume. A cavity is a part that is wound
// inwards. `is_hull`: the triangles come from hull_triangles. Such triangles are closed, but an
// edge may have a vertex on one side only.
//
// Throws ErrorKind::Value and names the edge or triangle:
//   the number of indices is not a multiple of 3, or an index is out of range
//   a vertex is not finite
//   an edge does not occur once in each direction (open or inconsistent mesh)
//   the mesh is inside out (negative volume)
//   the volume is below 1e-12 of the cube of the extent
NOVAPHY_CORE_API SolidProperties mesh_properties(std::span<const Vec3f> vertices,
                                                 std::span<const int32_t> indices,
                                                 bool is_hull = false);

// Mass properties of a wall of `thickness` (m) inside of the surface. The hollow has the same
// triangles as the mesh. Each vertex of the hollow lies `thickness` below the planes of its
// triangles. A vertex of more than three planes has this depth in the least squares sense, weighted
// by the angles at the vertex. The result is exact for a box. For round surfaces the error is
// second order in edge length over thickness.
//
// Throws ErrorKind::Value as mesh_properties does. Also throws for a thickness that is not > 0, and
// for one that leaves a hollow without a volume or with an inverted triangle.
NOVAPHY_CORE_API SolidProperties shell_properties(std::span<const Vec3f> vertices,
                                                  std::span<const int32_t> indices, float thickness,
                                                  bool is_hull = false);

}  // namespace novaphy
