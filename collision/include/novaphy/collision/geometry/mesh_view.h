// A triangle mesh as collision reads it: flat tables, made once by build_mesh_tree (mesh_tree.h),
// and the walk over the triangles whose boxes meet a box. Frame of the mesh, m.
#pragma once

#include "novaphy/collision/geometry/shape.h"

namespace novaphy::geometry {

struct Box3 {
  Vec3f lo{}, hi{};
};
inline bool boxes_meet(const Box3& a, const Box3& b) {  // touching counts; NaN does not meet
  return a.lo.x <= b.hi.x && b.lo.x <= a.hi.x && a.lo.y <= b.hi.y && b.lo.y <= a.hi.y &&
         a.lo.z <= b.hi.z && b.lo.z <= a.hi.z;
}

// Nodes stand in the order of a walk that goes down first: what is below node i follows it, and the
// walk goes on at `skip` where nothing of it is wanted. So no stack is needed.
struct MeshNode {
  Box3 box;
  int32_t skip;   // the node behind all that is below
  int32_t first;  // of a leaf: its triangles are first .. first + count - 1 of `order`
  int32_t count;  // 0: not a leaf
};

// An edge of the border, or where the mesh is convex by more than rounding.
struct MeshEdge {
  int32_t a, b;
  int32_t left, right;  // the third corners of its triangles; right is -1 on a border
  int32_t triangle;     // that of `left`
};

// Where there is no third corner across an edge of a triangle: nothing is there, or more than one
// triangle, one without area or one that is turned over.
inline constexpr int32_t kMeshBorder = -1, kMeshUnclear = -2;

struct MeshView {
  const Vec3f* vertices{};
  const Vec3i* triangles{};      // counter-clockwise seen from outside
  const Vec3f* normals{};        // of the triangles, unit; zero without area
  const int32_t* ring_starts{};  // vertices + 1 into ring
  const int32_t* ring{};         // of a vertex: those it shares an edge with
  const MeshEdge* edges{};
  const Vec3i* own_edges{};  // of a triangle: the edges that it is the left of, or -1
  const Vec3i*
      across{};  // of a triangle: beyond its edges, third corners, kMeshBorder or kMeshUnclear
  const MeshNode* nodes{};
  const int32_t* order{};
  int32_t node_count = 0;
  int32_t vertex_count = 0;
  int32_t edge_count = 0;
  float longest_edge = 0.0f;  // m
  Box3 behind{};              // what is in or behind the mesh: point_to_mesh
};

// Calls visit(triangle) for each triangle of the leaves that meet the box.
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
