// The search for rigid contacts as kernels: shapes are moved to the world, every candidate pair is
// asked for its manifold, a scan of the counts gives the rows before each pair, and the pairs write
// their rows. What a contact is: collision_pipeline.h.
#pragma once

#include "novaphy/collision/geometry/collide.h"
#include "novaphy/collision/geometry/mesh_view.h"
#include "novaphy/collision/geometry/plane_pairs.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {

// A shape where it is now.
struct RigidShape {
  GeoType type;
  int32_t unused;
  Vec3f scale;
  float margin, gap;   // m
  Transformf pose;     // in the world
  Transformf owner;    // of its body in the world, the identity for a world-owned shape
  geometry::Box3 box;  // in the world, grown by margin and gap
};

// The radius by which a shape exceeds its core, the points that rows store.
inline float core_radius(const RigidShape& shape) {
  return geometry::core_radius({shape.type, shape.scale});
}

// How far the shape reaches from its origin along a unit vector of its own frame, at most.
inline float reach_along(const RigidShape& shape, const Vec3f& axis) {
  const Vec3f& s = shape.scale;
  const float x = math::abs(axis.x), y = math::abs(axis.y), z = math::abs(axis.z);
  if (shape.type == GeoType::SPHERE) return s.x;
  if (shape.type == GeoType::CAPSULE) return s.x + s.y * z;
  if (shape.type == GeoType::BOX || shape.type == GeoType::ELLIPSOID)
    return (s.x * x + s.y * y) + s.z * z;
  if (shape.type == GeoType::CYLINDER || shape.type == GeoType::CONE)
    return s.x * math::sqrt(x * x + y * y) + s.y * z;
  return 1.0e6f;  // a plane
}

struct RigidContactShapeArguments {
  const int32_t* body;
  const int32_t* type;
  const Vec3f* scale;
  const Transformf* xform;
  const float* margin;
  const float* gap;
  const Transformf* body_q;
  RigidShape* shapes;
};
NOVAPHY_ROW_KERNEL(rigid_contact_shape, 8, RigidContactShapeArguments) {
  RigidShape& shape = a.shapes[row];
  const int32_t body = a.body[row];
  shape.type = static_cast<GeoType>(a.type[row]);
  shape.scale = a.scale[row];
  shape.margin = a.margin[row];
  shape.gap = a.gap[row];
  shape.owner = body < 0 ? Transformf::identity() : a.body_q[body];
  shape.pose = body < 0 ? a.xform[row] : math::multiply(shape.owner, a.xform[row]);
  // Grown by rounding, so that the boxes part nothing that touches.
  const float beyond = (shape.margin + shape.gap) + 1.0e-4f;
  const Vec3f grow = {
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{1.0f, 0.0f, 0.0f})),
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{0.0f, 1.0f, 0.0f})),
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{0.0f, 0.0f, 1.0f}))};
  shape.box = {shape.pose.p - grow, shape.pose.p + grow};
}

// The manifold of a pair, a.type <= b.type, in the world. `reach` (m): farther points need not
// come.
inline geometry::Manifold rigid_manifold(const RigidShape& a, const RigidShape& b, float reach) {
  using namespace geometry;
  if (a.type != GeoType::PLANE)
    return collide(Shape{a.type, a.scale}, a.pose, Shape{b.type, b.scale}, b.pose, reach);
  const Plane plane = plane_of(a.pose);
  if (b.type == GeoType::SPHERE) return plane_sphere(plane, b.pose, b.scale.x);
  if (b.type == GeoType::CAPSULE) return plane_capsule(plane, b.pose, b.scale.x, b.scale.y);
  if (b.type == GeoType::ELLIPSOID) return plane_ellipsoid(plane, b.pose, b.scale);
  if (b.type == GeoType::CYLINDER) return plane_cylinder(plane, b.pose, b.scale.x, b.scale.y);
  if (b.type == GeoType::BOX) return plane_box(plane, b.pose, b.scale, reach);
  return plane_cone(plane, b.pose, b.scale.x, b.scale.y);
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

struct RigidContactFindArguments {
  const Vec2i* pairs;
  const RigidShape* shapes;
  int64_t per_pair;               // rows of a pair without a plane, at most
  geometry::Manifold* manifolds;  // a row per pair: the contacts that are rows
  int32_t* counts;                // of these
};
NOVAPHY_ROW_KERNEL(rigid_contact_find, 5, RigidContactFindArguments) {
  const Vec2i pair = a.pairs[row];
  const RigidShape& s0 = a.shapes[pair.x];
  const RigidShape& s1 = a.shapes[pair.y];
  a.counts[row] = 0;
  if (!geometry::boxes_meet(s0.box, s1.box)) return;
  const float gap = s0.gap + s1.gap;
  const geometry::Manifold all = rigid_manifold(s0, s1, (gap + s0.margin) + s1.margin);
  const bool reduces = s0.type != GeoType::PLANE && all.count > a.per_pair;
  const geometry::Manifold found = reduces ? geometry::reduce_contacts<geometry::kManifoldCapacity>(
                                                 all, static_cast<int32_t>(a.per_pair))
                                           : all;
  const float inside = ((core_radius(s0) + core_radius(s1)) + s0.margin) + s1.margin;
  geometry::Manifold& kept = a.manifolds[row];
  kept.normal = math::normalize(found.normal);
  kept.count = 0;
  for (int32_t k = 0; k < found.count; ++k) {
    const CorePoints core = core_points(s0, s1, kept.normal, found.points[k]);
    // Written so that a NaN is no contact.
    if (math::dot(core.b - core.a, kept.normal) - inside <= gap)
      kept.points[kept.count++] = found.points[k];
  }
  a.counts[row] = kept.count;
}

struct RigidContactWriteArguments {
  const Vec2i* pairs;
  const RigidShape* shapes;
  const geometry::Manifold* manifolds;
  const int32_t* counts;
  const int32_t* before;  // the rows before each pair: a scan of the counts
  int64_t rows;           // capacity
  int32_t* count;
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
NOVAPHY_ROW_KERNEL(rigid_contact_write, 17, RigidContactWriteArguments) {
  const int32_t first = a.before[row], count = a.counts[row];
  if (row == n - 1) *a.count = first + count;
  if (count == 0) return;
  const Vec2i pair = a.pairs[row];
  const RigidShape& s0 = a.shapes[pair.x];
  const RigidShape& s1 = a.shapes[pair.y];
  const Transformf to0 = math::inverse(s0.owner), to1 = math::inverse(s1.owner);
  const geometry::Manifold& manifold = a.manifolds[row];
  const Vec3f& normal = manifold.normal;
  for (int32_t k = 0; k < count; ++k) {
    const int64_t at = first + k;
    if (at >= a.rows) return;
    const CorePoints core = core_points(s0, s1, normal, manifold.points[k]);
    const float margin0 = core_radius(s0) + s0.margin, margin1 = core_radius(s1) + s1.margin;
    a.shape0[at] = pair.x;
    a.shape1[at] = pair.y;
    a.point0[at] = math::transform_point(to0, core.a);
    a.point1[at] = math::transform_point(to1, core.b);
    a.offset0[at] = math::rotate(to0.q, normal * margin0);
    a.offset1[at] = math::rotate(to1.q, normal * -margin1);
    a.normal[at] = normal;
    a.margin0[at] = margin0;
    a.margin1[at] = margin1;
    a.point_id[at] = manifold.points[k].feature;
  }
}

struct RigidContactClearArguments {
  int64_t pairs;
  int32_t* count;
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
  Vec3f* force;
};
// Empties the row if it lies behind the last contact, else its force; the row behind all sets the
// count where no pair has done it.
NOVAPHY_ROW_KERNEL(rigid_contact_clear, 13, RigidContactClearArguments) {
  if (row == n - 1) {
    if (a.pairs == 0) *a.count = 0;
    return;
  }
  const bool touches = a.pairs != 0 && row < *a.count;
  if (!touches && a.shape0[row] < 0) return;  // empty already
  a.force[row] = Vec3f{};
  if (touches) return;
  a.shape0[row] = -1;
  a.shape1[row] = -1;
  a.point0[row] = Vec3f{};
  a.point1[row] = Vec3f{};
  a.offset0[row] = Vec3f{};
  a.offset1[row] = Vec3f{};
  a.normal[row] = Vec3f{};
  a.margin0[row] = 0.0f;
  a.margin1[row] = 0.0f;
  a.point_id[row] = -1;
}

}  // namespace novaphy
