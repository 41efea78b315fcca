// The geometry of a shape beyond its type and scale: the tables of a hull or mesh, scaled, and the
// box that holds it. Frame of the shape, m. Made on the host (collision/src/ shape_geometries.h).
#pragma once

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::geometry {

struct GeometryView {
  HullView hull;  // of a CONVEX_MESH
  MeshView mesh;  // of a MESH
  Box3 box;
};

}  // namespace novaphy::geometry
