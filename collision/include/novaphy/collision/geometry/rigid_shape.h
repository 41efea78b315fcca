// A shape as the search for rigid contacts sees it, and the rows that two of them make.
#pragma once

#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/collision/geometry/manifold.h"

namespace novaphy {

// Where it is now.
struct RigidShape {
  GeoType type;
  float row_gap;                           // m, gap, or less where a step asks for less
  const geometry::GeometryView* geometry;  // of a hull or mesh, else null
  Vec3f scale;
  float margin, gap;   // m
  Transformf pose;     // in the world
  Transformf owner;    // of its body in the world, the identity for a world-owned shape
  geometry::Box3 box;  // in the world, grown by margin and row_gap
};

// The radius by which a shape exceeds its core, the points that rows store.
inline float core_radius(const RigidShape& shape) {
  return geometry::core_radius({shape.type, shape.scale});
}

// One that is no plane nor mesh.
inline geometry::Shape convex_shape(const RigidShape& shape) {
  geometry::Shape convex{shape.type, shape.scale};
  if (shape.geometry != nullptr) convex.hull = shape.geometry->hull;
  return convex;
}

// Between core surfaces (m), the distance up to which a pair may have rows.
inline float reach_of(const RigidShape& s0, const RigidShape& s1) {
  return ((s0.gap + s1.gap) + s0.margin) + s1.margin;
}

// Parts of the gaps of pairs: all, 1/2, 1/4, ..., what touches, nothing.
inline constexpr int32_t kLimitParts = 13;
// Whether the surfaces with their margins are within a part at a point of a pair.
inline bool is_within(const RigidShape& s0, const RigidShape& s1,
                      const geometry::ContactPoint& point, int32_t part) {
  if (part == 0 || part == kLimitParts - 1) return part == 0;
  const float of_gaps =
      part == kLimitParts - 2 ? 0.0f : 1.0f / static_cast<float>(int32_t{1} << part);
  return point.distance - (s0.margin + s1.margin) <= of_gaps * (s0.gap + s1.gap);
}
// Of more rows than there is room for: how many were found, the largest part that fits, and how
// many rows there is room for of those that are within the next larger one only, in their order.
struct RigidContactLimit {
  int32_t total, part, room;
};
// Whether a row stays; `before` of those that only the next larger part has came before it.
inline bool stays(const RigidContactLimit& limit, const RigidShape& s0, const RigidShape& s1,
                  const geometry::ContactPoint& point, int32_t& before) {
  if (is_within(s0, s1, point, limit.part)) return true;
  return is_within(s0, s1, point, limit.part - 1) && before++ < limit.room;
}

// The core points of a contact: on the surface, or on the center or axis of what has a radius.
struct CorePoints {
  Vec3f a, b;
};
inline CorePoints core_points(const RigidShape& a, const RigidShape& b, const Vec3f& normal,
                              const geometry::ContactPoint& point) {
  const float half = 0.5f * point.distance;
  return {point.position - normal * (half + core_radius(a)),
          point.position + normal * (half + core_radius(b))};
}

}  // namespace novaphy
