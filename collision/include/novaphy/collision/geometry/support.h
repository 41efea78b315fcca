// Support functions: the point that is farthest in a direction, for a convex core (shape.h) and for
// the Minkowski difference A - B of a pair. The difference contains the origin if the cores
// overlap.
//
// Directions may have any length. If several points are equally far, the same direction always
// gives the same point. For a polytope with more than 32 vertices, the search moves from neighbor
// to neighbor: a vertex without a farther neighbor is the farthest. Source: C. Ericson, Real-Time
// Collision Detection (2005), 9.5.
#pragma once

#include "novaphy/collision/geometry/shape.h"

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

// Returns the horizontal part of d, scaled to `length`. The result is zero if d is along the axis.
inline Vec3f radial(const Vec3f& d, float length) {
  const float rho = math::sqrt(d.x * d.x + d.y * d.y);
  if (!(rho > 0.0f)) return {};
  return {d.x * (length / rho), d.y * (length / rho), 0.0f};
}

inline Vec3f cone_support(float radius, float half_height, const Vec3f& d) {
  const Vec3f rim = radial(d, radius) + Vec3f{0.0f, 0.0f, -half_height};
  const Vec3f apex = {0.0f, 0.0f, half_height};
  return math::dot(apex, d) > math::dot(rim, d) ? apex : rim;
}

inline Vec3f ellipsoid_support(const Vec3f& axes, const Vec3f& d) {
  const Vec3f s = {axes.x * d.x, axes.y * d.y, axes.z * d.z};
  const float l = math::length(s);
  if (!(l > 0.0f)) return {axes.x, 0.0f, 0.0f};
  return {axes.x * (s.x / l), axes.y * (s.y / l), axes.z * (s.z / l)};
}

// Returns the support point in the frame of the shape.
NOVAPHY_OUT_OF_LINE Vec3f core_support(const Shape& shape, const Vec3f& d) {
  const Vec3f s = shape.scale;
  switch (shape.type) {
    case GeoType::CAPSULE:
      return {0.0f, 0.0f, d.z < 0.0f ? -s.y : s.y};
    case GeoType::BOX:
      return {d.x < 0.0f ? -s.x : s.x, d.y < 0.0f ? -s.y : s.y, d.z < 0.0f ? -s.z : s.z};
    case GeoType::CYLINDER:
      return radial(d, s.x) + Vec3f{0.0f, 0.0f, d.z < 0.0f ? -s.y : s.y};
    case GeoType::CONE:
      return cone_support(s.x, s.y, d);
    case GeoType::ELLIPSOID:
      return ellipsoid_support(s, d);
    case GeoType::CONVEX_MESH:
      return shape.hull.vertices[hull_support_vertex(shape.hull, d)];
    default:
      return {};  // the center of a sphere
  }
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
