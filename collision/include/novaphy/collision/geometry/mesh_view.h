// The flat tables of a triangle mesh for collision, which build_mesh_tree (mesh_tree.h) builds
// once. The file also has the traversal of the triangles whose boxes overlap a box. Frame of the
// mesh, m.
#pragma once

#include "novaphy/collision/geometry/shape.h"

namespace novaphy::geometry {

struct Box3 {
  Vec3f lo{}, hi{};
};
inline bool boxes_meet(const Box3& a, const Box3& b) {  // touching boxes overlap; NaN does not
  return a.lo.x <= b.hi.x && b.lo.x <= a.hi.x && a.lo.y <= b.hi.y && b.lo.y <= a.hi.y &&
         a.lo.z <= b.hi.z && b.lo.z <= a.hi.z;
}

// A node of the box tree. Nodes are stored in depth-first order: the descendants of node i follow
// node i, and `skip` is the next node outside of its subtree. The traversal needs no stack.
struct MeshNode {
  Box3 box;
  int32_t skip;   // next node after this subtree
  int32_t first;  // for a leaf: its triangles are order[first .. first + count - 1]
  int32_t count;  // 0: not a leaf
};

// An edge that can touch other edges: a border edge, or an edge where the mesh is convex beyond
// rounding.
struct MeshEdge {
  int32_t a, b;
  int32_t left, right;  // third corners of its triangles; right is -1 on a border
  int32_t triangle;     // the triangle with the corner `left`
};

// Values for an edge without a third corner on the other side. Border: no triangle is on the other
// side. Unclear: several triangles, a triangle without area, or one with the opposite orientation.
inline constexpr int32_t kMeshBorder = -1, kMeshUnclear = -2;

struct MeshView {
  const Vec3f* vertices{};
  const Vec3i* triangles{};      // counter-clockwise seen from outside
  const Vec3f* normals{};        // unit normals of the triangles; zero without area
  const int32_t* ring_starts{};  // vertices + 1 indices into ring
  const int32_t* ring{};         // for each vertex, the vertices that share an edge with it
  const MeshEdge* edges{};
  const Vec3i* own_edges{};  // for each triangle, the edges with this triangle on the left, or -1
  const Vec3i*
      across{};  // for each triangle and edge: the third corner on the other side, kMeshBorder or
                 // kMeshUnclear
  const MeshNode* nodes{};
  const int32_t* order{};
  int32_t node_count = 0;
  int32_t vertex_count = 0;
  int32_t edge_count = 0;
  float longest_edge = 0.0f;  // m
  Box3 behind{};              // box of the points in or behind the mesh, see point_to_mesh
};

// Calls visit(triangle) for each triangle in the leaves that overlap the box.
template <class Visit>
void for_triangles_in(const MeshView& mesh, const Box3& box, Visit visit) {
  for (int32_t i = 0; i < mesh.node_count;) {
    const MeshNode& node = mesh.nodes[i];
    if (!boxes_meet(node.box, box)) {
      i = node.skip;
      continue;
    }
    for (int32_t k = node.first; k < node.first + node.count; ++k) visit(mesh.order[k]);
    ++i;
  }
}

}  // namespace novaphy::geometry
