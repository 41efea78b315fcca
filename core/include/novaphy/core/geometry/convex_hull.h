// The convex hull of points as a polytope of few vertices, with the tables that collision needs.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

inline constexpr int32_t kMaxHullVertices = 64;

// Faces are convex polygons, counter-clockwise seen from outside, each beginning with its smallest
// vertex; faces are sorted by their vertices, vertices by the input. Neighbors of a vertex are
// those it shares an edge with, before faces were merged, ascending.
struct ConvexHull {
  std::vector<Vec3f> vertices;       // m, of the input, unchanged
  std::vector<int32_t> input_index;  // of the vertices
  std::vector<Vec3f> face_normals;   // unit, outward
  std::vector<int32_t> face_starts;  // faces + 1, into face_vertices
  std::vector<int32_t> face_vertices;
  std::vector<int32_t> neighbor_starts;  // vertices + 1, into neighbors
  std::vector<int32_t> neighbors;
};

// Quickhull in double precision; the same points in the same order give the same hull. Points
// within 1e-6 of the extent inside of the hull, or of a face, are left out, so duplicates do not
// matter. Faces within 0.1 degrees of a larger neighbor become one with it, unless that loses a
// vertex by which the hull is 1 % thicker. From max_vertices on (4 .. kMaxHullVertices) points are
// left out: the hull of those that lay farthest out, within the hull of all (hull_of_all.h).
// Source: Barber, Dobkin, Huhdanpaa, The Quickhull Algorithm for Convex Hulls (1996).
//
// ErrorKind::Value: fewer than 4 points; one that is not finite (its index is named); points in one
// plane, on one line or in one place, to 1e-6 of their extent; max_vertices out of range.
NOVAPHY_CORE_API ConvexHull convex_hull(std::span<const Vec3f> points,
                                        int32_t max_vertices = kMaxHullVertices);

// The faces as triangles, 3 indices into vertices each: fans about the first corner.
NOVAPHY_CORE_API std::vector<int32_t> hull_triangles(const ConvexHull& hull);

}  // namespace novaphy
