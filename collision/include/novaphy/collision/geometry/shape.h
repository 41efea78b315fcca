// A convex shape as a core and a radius, and the pose of one shape in the frame of another.
//
// The core of a sphere is its center, and the core of a capsule is its segment. Both shapes have a
// radius. Every other shape is its own core, with radius 0. The distance of two shapes is exactly
// the distance of the cores minus the radii, also for a penetration. `scale` (m) is
// Model::shape_scale (core/sim/enums.h): half extents, or radius and half height along z, or half
// axes. The vertices of a convex hull include the scale.
#pragma once

#include "novaphy/collision/geometry/manifold.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/math/matrix.h"

namespace novaphy::geometry {

// The tables of a convex polytope. Faces are polygons, counter-clockwise seen from outside. The
// neighbors of a vertex are the vertices that share an edge with it.
struct HullView {
  const Vec3f* vertices{};
  const Vec3f* face_normals{};   // unit, outward
  const int32_t* face_starts{};  // faces + 1 indices into face_vertices
  const int32_t* face_vertices{};
  const int32_t* neighbor_starts{};  // vertices + 1 indices into neighbors; null: unknown
  const int32_t* neighbors{};
  int32_t vertex_count = 0;
  int32_t face_count = 0;
};

struct Shape {
  GeoType type = GeoType::NONE;
  Vec3f scale{};
  HullView hull{};  // CONVEX_MESH only
};

inline float core_radius(const Shape& shape) {
  return has_trait<&ShapeTraits::is_rounded>(shape.type) ? shape.scale.x : 0.0f;
}

// Returns the pose of B in the frame of A. The positions are subtracted first, which keeps the
// precision of pairs far from the world's origin.
inline Transformf relative_pose(const Transformf& a, const Transformf& b) {
  return {math::rotate_inverse(a.q, b.p - a.p), math::multiply(math::conjugate(a.q), b.q)};
}

inline Mat33f rotation_matrix(const Quatf& q) {
  return math::from_columns(math::rotate(q, Vec3f{1.0f, 0.0f, 0.0f}),
                            math::rotate(q, Vec3f{0.0f, 1.0f, 0.0f}),
                            math::rotate(q, Vec3f{0.0f, 0.0f, 1.0f}));
}
inline Vec3f apply(const Mat33f& r, const Vec3f& v) {
  return {math::dot(math::row(r, 0), v), math::dot(math::row(r, 1), v),
          math::dot(math::row(r, 2), v)};
}
inline Vec3f apply_transposed(const Mat33f& r, const Vec3f& v) {
  return (math::row(r, 0) * v.x + math::row(r, 1) * v.y) + math::row(r, 2) * v.z;
}

// Two shapes in the frame of the first.
struct ShapePair {
  const Shape* a;
  const Shape* b;
  Mat33f rotation;  // of B in the frame of A
  Vec3f offset;     // of B in the frame of A (m)
};
inline ShapePair shape_pair(const Shape& a, const Shape& b, const Transformf& b_in_a) {
  return {&a, &b, rotation_matrix(b_in_a.q), b_in_a.p};
}
inline Vec3f from_b(const ShapePair& pair, const Vec3f& point) {
  return apply(pair.rotation, point) + pair.offset;
}

// A value beyond 1e30 counts as not finite, because its square overflows.
inline bool is_finite(float x) { return math::abs(x) < 1e30f; }
inline bool is_finite(const Vec3f& v) { return is_finite(v.x) && is_finite(v.y) && is_finite(v.z); }
inline bool is_finite(const ShapePair& pair) {
  return is_finite(pair.offset) && is_finite(math::column(pair.rotation, 0)) &&
         is_finite(math::column(pair.rotation, 1)) && is_finite(math::column(pair.rotation, 2)) &&
         is_finite(pair.a->scale) && is_finite(pair.b->scale);
}

// Return the i-th coordinate and the i-th unit vector.
inline float component(const Vec3f& v, int32_t i) { return i == 0 ? v.x : i == 1 ? v.y : v.z; }
inline Vec3f unit_axis(int32_t i, float length) {
  return {i == 0 ? length : 0.0f, i == 1 ? length : 0.0f, i == 2 ? length : 0.0f};
}
// Returns a unit vector perpendicular to v, which may have any length. The result is the cross
// product with the axis of v's smallest component.
inline Vec3f any_orthogonal(const Vec3f& v) {
  const float x = math::abs(v.x), y = math::abs(v.y), z = math::abs(v.z);
  const int32_t least = x <= y && x <= z ? 0 : y <= z ? 1 : 2;
  return math::normalize(math::cross(v, unit_axis(least, 1.0f)));
}

}  // namespace novaphy::geometry
