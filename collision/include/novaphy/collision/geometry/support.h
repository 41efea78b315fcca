// Support functions: the point that is farthest in a direction, for a convex core (shape.h) and for
// the Minkowski difference A - B of a pair. The difference contains the origin if the cores
// overlap.
//
// Directions may have any length. If several points are equally far, the same direction always
// gives the same point. For a polytope with more than 32 vertices, the search moves from neighbor
// to neighbor: a vertex without a farther neighbor is the farthest. Source: C. Ericson, Real-Time
// Collision Detection (2005), 9.5.
#pragma once

#include "novaphy/collision/geometry/shapes/list.h"

namespace novaphy::geometry {

inline constexpr int32_t kClimbAbove = 32;  // vertices

inline int32_t hull_support_vertex(const HullView& hull, const Vec3f& d) {
  int32_t best = 0;
  float height = math::dot(hull.vertices[0], d);
  if (hull.vertex_count > kClimbAbove && hull.neighbor_starts != nullptr) {
    for (int32_t from = -1; from != best;) {
      from = best;
      for (int32_t k = hull.neighbor_starts[from]; k < hull.neighbor_starts[from + 1]; ++k) {
        const float h = math::dot(hull.vertices[hull.neighbors[k]], d);
        if (h > height) {
          height = h;
          best = hull.neighbors[k];
        }
      }
    }
    return best;
  }
  for (int32_t i = 1; i < hull.vertex_count; ++i) {
    const float h = math::dot(hull.vertices[i], d);
    if (h > height) {
      height = h;
      best = i;
    }
  }
  return best;
}

// Returns the support point in the frame of the shape.
NOVAPHY_OUT_OF_LINE Vec3f core_support(const Shape& shape, const Vec3f& d) {
  if (shape.type == GeoType::CONVEX_MESH)
    return shape.hull.vertices[hull_support_vertex(shape.hull, d)];
  return with_solid(shape.type, shape.scale, [&](const auto& solid) { return solid.support(d); });
}

// A point of the Minkowski difference, and the points of A and B that give it, in the frame of A.
struct SupportPoint {
  Vec3f w, a, b;  // w = a - b
};
inline SupportPoint support_point(const ShapePair& pair, const Vec3f& d) {
  const Vec3f a = core_support(*pair.a, d);
  const Vec3f b = from_b(pair, core_support(*pair.b, apply_transposed(pair.rotation, -d)));
  return {a - b, a, b};
}

// Returns the separation of the shapes along the unit vector n from A to B (m). The separation is a
// lower bound of the signed distance. The largest separation over all n equals this distance.
inline float separation_along(const ShapePair& pair, const Vec3f& n) {
  return (-math::dot(support_point(pair, n).w, n) - core_radius(*pair.a)) - core_radius(*pair.b);
}

}  // namespace novaphy::geometry
