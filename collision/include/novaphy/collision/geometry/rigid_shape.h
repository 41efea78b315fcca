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

// The core points of a contact: on the surface, or on the centre or axis of what has a radius.
struct CorePoints {
  Vec3f a, b;
};
inline CorePoints core_points(const RigidShape& a, const RigidShape& b, const Vec3f& normal,
                              const geometry::ContactPoint& point) {
  const float half = 0.5f * point.distance;
  return {point.position - normal * (half + core_radius(a)),
          point.position + normal * (half + core_radius(b))};
}

// Where rows are written.
struct RigidContactRows {
  int64_t capacity;
  int32_t* shape0;  // the rest: a row per contact
  int32_t* shape1;
  Vec3f* point0;
  Vec3f* point1;
  Vec3f* offset0;
  Vec3f* offset1;
  Vec3f* normal;
  float* margin0;
  float* margin1;
  int32_t* point_id;
};
// Into the frames of the owners of a pair.
struct ToOwners {
  Transformf to0, to1;
};
inline ToOwners to_owners(const RigidShape& s0, const RigidShape& s1) {
  return {math::inverse(s0.owner), math::inverse(s1.owner)};
}
// Row `at`, if it has room; the normal is from pair.x to pair.y.
inline void write_contact(const RigidContactRows& rows, int64_t at, const Vec2i& pair,
                          const RigidShape* shapes, const ToOwners& owners, const Vec3f& normal,
                          const geometry::ContactPoint& point) {
  if (at >= rows.capacity) return;
  const RigidShape& s0 = shapes[pair.x];
  const RigidShape& s1 = shapes[pair.y];
  const Transformf &to0 = owners.to0, &to1 = owners.to1;
  const CorePoints core = core_points(s0, s1, normal, point);
  const float margin0 = core_radius(s0) + s0.margin, margin1 = core_radius(s1) + s1.margin;
  rows.shape0[at] = pair.x;
  rows.shape1[at] = pair.y;
  rows.point0[at] = math::transform_point(to0, core.a);
  rows.point1[at] = math::transform_point(to1, core.b);
  rows.offset0[at] = math::rotate(to0.q, normal * margin0);
  rows.offset1[at] = math::rotate(to1.q, normal * -margin1);
  rows.normal[at] = normal;
  rows.margin0[at] = margin0;
  rows.margin1[at] = margin1;
  rows.point_id[at] = point.feature;
}

}  // namespace novaphy
