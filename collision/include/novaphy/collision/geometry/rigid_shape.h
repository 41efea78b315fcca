// A shape as the search for rigid contacts uses it, and the rule that decides which points become
// rows.
#pragma once

#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/collision/geometry/manifold.h"

namespace novaphy {

// A shape at its current pose.
struct RigidShape {
  GeoType type;
  float row_gap;                           // m, the gap, or less if the step dt needs less
  const geometry::GeometryView* geometry;  // of a hull or mesh, else null
  Vec3f scale;
  float margin, gap;   // m
  Transformf pose;     // in the world
  Transformf owner;    // pose of its body in the world; identity for a world-owned shape
  geometry::Box3 box;  // world frame, grown by margin and row_gap
};

// Returns the radius around the core (m). Rows store points of the core.
inline float core_radius(const RigidShape& shape) {
  return geometry::core_radius({shape.type, shape.scale});
}

// Returns a shape that is neither a plane nor a mesh as a convex shape.
inline geometry::Shape convex_shape(const RigidShape& shape) {
  geometry::Shape convex{shape.type, shape.scale};
  if (shape.geometry != nullptr) convex.hull = shape.geometry->hull;
  return convex;
}

// Returns the largest distance of the core surfaces (m) at which a pair may have rows.
inline float reach_of(const RigidShape& s0, const RigidShape& s1) {
  return ((s0.gap + s1.gap) + s0.margin) + s1.margin;
}

// Number of fractions of a pair's gap: all, 1/2, 1/4, ..., 1/1024, touching only, nothing.
inline constexpr int32_t kLimitParts = 13;
// Returns whether a point of a pair is within the fraction `part` of the gap. The distance is that
// of the surfaces with their margins.
inline bool is_within(const RigidShape& s0, const RigidShape& s1,
                      const geometry::ContactPoint& point, int32_t part) {
  if (part == 0 || part == kLimitParts - 1) return part == 0;
  const float of_gaps =
      part == kLimitParts - 2 ? 0.0f : 1.0f / static_cast<float>(int32_t{1} << part);
  return point.distance - (s0.margin + s1.margin) <= of_gaps * (s0.gap + s1.gap);
}
// The choice of rows if more rows exist than slots: the number of rows found (total), and the
// largest fraction of the gap whose rows all fit (part). `room` is the number of slots that remain
// for rows within the next larger fraction, in their order.
struct RigidContactLimit {
  int32_t total, part, room;
};
// Returns whether the limit keeps a row. The limit keeps all rows within the fraction `part`, and
// the first `room` rows that are only within the next larger fraction. `before` counts the rows of
// the second kind.
inline bool stays(const RigidContactLimit& limit, const RigidShape& s0, const RigidShape& s1,
                  const geometry::ContactPoint& point, int32_t& before) {
  if (is_within(s0, s1, point, limit.part)) return true;
  return is_within(s0, s1, point, limit.part - 1) && before++ < limit.room;
}

// The core points of a contact: on the surface of a shape, or on the center or axis of a shape with
// a radius.
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
