// The tables of a triangle mesh that collision needs (geometry/mesh_view.h), built on the host.
#pragma once

#include <span>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy {

struct MeshTree {
  std::vector<Vec3f> vertices;
  std::vector<Vec3i> triangles;  // of corners in one place, the first
  std::vector<Vec3f> normals;
  std::vector<int32_t> ring_starts, ring;
  std::vector<geometry::MeshEdge> edges;
  std::vector<Vec3i> own_edges, across;
  std::vector<geometry::MeshNode> nodes;
  std::vector<int32_t> order;
  geometry::Box3 behind;
};
// Valid as long as the tree lives and stays as it is.
NOVAPHY_COLLISION_API geometry::MeshView mesh_view(const MeshTree& tree);

// The mesh may be open. Vertices in the same place, to the bit, count as one. Triangles without
// area never touch. Boxes are halved at the middle triangle along the longest axis of their
// centers, ties by index: the same mesh gives the same tables.
//
// ErrorKind::Value: no triangle; indices not a multiple of 3 or out of range; a vertex that is not
// finite. The index is named.
NOVAPHY_COLLISION_API MeshTree build_mesh_tree(std::span<const Vec3f> vertices,
                                               std::span<const int32_t> indices);

}  // namespace novaphy
