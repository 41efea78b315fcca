// The convex hull of points as a polytope with few vertices, with the tables that collision needs.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

inline constexpr int32_t kMaxHullVertices = 64;

// Faces are convex polygons, counter-clockwise seen from outside. Each face begins with its
// smallest vertex index, and faces are sorted by their vertices. Vertices keep the order of the
// input. Two vertices are neighbors if an edge connects them before coplanar faces are merged.
// Neighbors are sorted ascending.
struct ConvexHull {
  std::vector<Vec3f> vertices;       // m, unchanged points of the input
  std::vector<int32_t> input_index;  // index of each vertex in the input
  std::vector<Vec3f> face_normals;   // unit, outward
  std::vector<int32_t> face_starts;  // faces + 1 offsets into face_vertices
  std::vector<int32_t> face_vertices;
  std::vector<int32_t> neighbor_starts;  // vertices + 1 offsets into neighbors
  std::vector<int32_t> neighbors;
};

// Computes the hull by Quickhull in double precision. The same points in the same order give the
// same hull.
//
// A point inside of the hull is left out, and so is a point whose distance from a face is at most
// 1e-6 of the extent of all points. Duplicates therefore have no effect. A face within 0.1 degrees of a larger neighbor is merged
// with the neighbor. A merge that would reduce the thickness of the hull by more than 1 % is
// skipped.
//
// At most max_vertices (4 .. kMaxHullVertices) vertices are kept. Each step adds the point that is
// farthest from the hull, so a limited hull lies within the hull of all points (hull_of_all.h).
//
// Source: Barber, Dobkin, Huhdanpaa, The Quickhull Algorithm for Convex Hulls (1996).
//
// Throws ErrorKind::Value for fewer than 4 points, a point that is not finite (the message has its
// index), and max_vertices out of range. The same error reports points in a plane, on a line or at
// one position (to 1e-6 of their extent).
NOVAPHY_CORE_API ConvexHull convex_hull(std::span<const Vec3f> points,
                                        int32_t max_vertices = kMaxHullVertices);

// Returns the faces as triangles, 3 indices into `vertices` each: a fan about the first corner of
// each face.
NOVAPHY_CORE_API std::vector<int32_t> hull_triangles(const ConvexHull& hull);

}  // namespace novaphy
