// The tables of a triangle mesh for collision (geometry/mesh_view.h), built on the host.
#pragma once

#include <span>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy {

struct MeshTree {
  std::vector<Vec3f> vertices;
  std::vector<Vec3i> triangles;  // corners at the same position have the first vertex's index
  std::vector<Vec3f> normals;
  std::vector<int32_t> ring_starts, ring;
  std::vector<geometry::MeshEdge> edges;
  std::vector<Vec3i> own_edges, across;
  std::vector<geometry::MeshNode> nodes;
  std::vector<int32_t> order;
  geometry::Box3 behind;
};
// Returns a view of the tables. The view is valid as long as the tree exists unchanged.
NOVAPHY_COLLISION_API geometry::MeshView mesh_view(const MeshTree& tree);

// Builds the tables of a mesh, which may be open. Vertices with exactly the same position count as
// one vertex. Triangles without area have no contacts. The tree splits at the median triangle along
// the longest axis of the centers. Ties are broken by index, so that the same mesh gives the same
// tables.
//
// Throws ErrorKind::Value, with the index, if the mesh has no triangle, the number of indices is
// not a multiple of 3, an index is out of range, or a vertex is not finite.
NOVAPHY_COLLISION_API MeshTree build_mesh_tree(std::span<const Vec3f> vertices,
                                               std::span<const int32_t> indices);

}  // namespace novaphy
