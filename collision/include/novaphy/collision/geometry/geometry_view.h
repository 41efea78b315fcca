// The geometry of a shape beyond its type and scale: the scaled tables of a hull or mesh, and the
// bounding box. Frame of the shape, m. The host builds the tables
// (collision/src/shape_geometries.h).
#pragma once

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::geometry {

struct GeometryView {
  HullView hull;  // for CONVEX_MESH
  MeshView mesh;  // for MESH
  Box3 box;
};

}  // namespace novaphy::geometry
