// The search for rigid contacts as kernels: shapes are moved to the world, every candidate pair is
// asked for its manifold, a scan of the counts gives the rows before each pair, and the pairs write
// their rows. What a contact is: collision_pipeline.h.
#pragma once

#include "novaphy/collision/geometry/collide.h"
#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/collision/geometry/plane_pairs.h"
#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {

// How far the shape reaches from its origin (a hull or mesh: the middle of its box) along a unit
// vector of its own frame, at most.
inline float reach_along(const RigidShape& shape, const Vec3f& axis) {
  const float x = math::abs(axis.x), y = math::abs(axis.y), z = math::abs(axis.z);
  if (shape.geometry != nullptr) {
    const Vec3f size = shape.geometry->box.hi - shape.geometry->box.lo;
    return 0.5f * ((size.x * x + size.y * y) + size.z * z);
  }
  const Vec3f& s = shape.scale;
  if (shape.type == GeoType::SPHERE) return s.x;
  if (shape.type == GeoType::CAPSULE) return s.x + s.y * z;
  if (shape.type == GeoType::BOX || shape.type == GeoType::ELLIPSOID)
    return (s.x * x + s.y * y) + s.z * z;
  if (shape.type == GeoType::CYLINDER || shape.type == GeoType::CONE)
    return s.x * math::sqrt(x * x + y * y) + s.y * z;
  return 1.0e6f;  // a plane
}

// Of types in their order: a mesh and a convex shape or mesh, which rigid_mesh_kernels.h handles.
inline bool is_mesh_pair(GeoType a, GeoType b) {
  return a == GeoType::MESH || (b == GeoType::MESH && a != GeoType::PLANE);
}

struct RigidContactShapeArguments {
  const int32_t* body;
  const int32_t* type;
  const Vec3f* scale;
  const Transformf* xform;
  const float* margin;
  const float* gap;
  const Transformf* body_q;
  const int32_t* geometry;  // of the shapes: rows of `views`, or -1
  const geometry::GeometryView* views;
  RigidShape* shapes;
};
NOVAPHY_ROW_KERNEL(rigid_contact_shape, 10, RigidContactShapeArguments) {
  RigidShape& shape = a.shapes[row];
  const int32_t body = a.body[row];
  shape.type = static_cast<GeoType>(a.type[row]);
  shape.geometry = a.geometry[row] < 0 ? nullptr : &a.views[a.geometry[row]];
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
  Vec3f centre = shape.pose.p;
  if (shape.geometry != nullptr) {
    const geometry::Box3& box = shape.geometry->box;
    centre = math::transform_point(shape.pose, (box.lo + box.hi) * 0.5f);
  }
  shape.box = {centre - grow, centre + grow};
}

// The manifold of a pair, a.type <= b.type, in the world. `reach` (m): farther points need not
// come.
inline geometry::Manifold rigid_manifold(const RigidShape& a, const RigidShape& b, float reach) {
  using namespace geometry;
  if (a.type != GeoType::PLANE)
    return collide(convex_shape(a), a.pose, convex_shape(b), b.pose, reach);
  const Plane plane = plane_of(a.pose);
  if (b.type == GeoType::SPHERE) return plane_sphere(plane, b.pose, b.scale.x);
  if (b.type == GeoType::CAPSULE) return plane_capsule(plane, b.pose, b.scale.x, b.scale.y);
  if (b.type == GeoType::ELLIPSOID) return plane_ellipsoid(plane, b.pose, b.scale);
  if (b.type == GeoType::CYLINDER) return plane_cylinder(plane, b.pose, b.scale.x, b.scale.y);
  if (b.type == GeoType::BOX) return plane_box(plane, b.pose, b.scale, reach);
  if (b.type == GeoType::CONE) return plane_cone(plane, b.pose, b.scale.x, b.scale.y);
  const GeometryView& solid = *b.geometry;
  const bool is_mesh = b.type == GeoType::MESH;
  return plane_vertices(plane, b.pose, is_mesh ? solid.mesh.vertices : solid.hull.vertices,
                        is_mesh ? solid.mesh.vertex_count : solid.hull.vertex_count,
                        math::length(solid.box.hi - solid.box.lo), reach);
}

// Keeps of a manifold, at most `per_pair` points where no plane is in it, what are rows.
inline void keep_rows(const RigidShape& s0, const RigidShape& s1, const geometry::Manifold& all,
                      int64_t per_pair, geometry::Manifold& kept) {
  const bool reduces = s0.type != GeoType::PLANE && all.count > per_pair;
  const geometry::Manifold found = reduces ? geometry::reduce_contacts<geometry::kManifoldCapacity>(
                                                 all, static_cast<int32_t>(per_pair))
                                           : all;
  const float inside = ((core_radius(s0) + core_radius(s1)) + s0.margin) + s1.margin;
  kept.normal = math::normalize(found.normal);
  kept.count = 0;
  for (int32_t k = 0; k < found.count; ++k) {
    const CorePoints core = core_points(s0, s1, kept.normal, found.points[k]);
    // Written so that a NaN is no contact.
    if (math::dot(core.b - core.a, kept.normal) - inside <= s0.gap + s1.gap)
      kept.points[kept.count++] = found.points[k];
  }
}

struct RigidContactFindArguments {
  const int32_t* pairs_found;  // as many of the pairs count; null: all
  const Vec2i* pairs;
  const RigidShape* shapes;
  int64_t per_pair;               // rows of a pair without a plane, at most
  geometry::Manifold* manifolds;  // a row per pair: the contacts that are rows
  int32_t* counts;                // of these
};
NOVAPHY_ROW_KERNEL(rigid_contact_find, 6, RigidContactFindArguments) {
  a.counts[row] = 0;
  if (a.pairs_found != nullptr && row >= *a.pairs_found) return;
  const Vec2i pair = a.pairs[row];
  const RigidShape& s0 = a.shapes[pair.x];
  const RigidShape& s1 = a.shapes[pair.y];
  if (!geometry::boxes_meet(s0.box, s1.box) || is_mesh_pair(s0.type, s1.type)) return;
  geometry::Manifold& kept = a.manifolds[row];
  keep_rows(s0, s1, rigid_manifold(s0, s1, reach_of(s0, s1)), a.per_pair, kept);
  a.counts[row] = kept.count;
}

struct RigidContactWriteArguments {
  const int32_t* pairs_found;  // may be more than there is room for; null: all
  const Vec2i* pairs;
  const RigidShape* shapes;
  const geometry::Manifold* manifolds;
  const int32_t* counts;
  const int32_t* before;  // the rows before each pair: a scan of the counts
  int32_t* count;
  RigidContactRows rows;
};
NOVAPHY_ROW_KERNEL(rigid_contact_write, 18, RigidContactWriteArguments) {
  const int32_t first = a.before[row], count = a.counts[row];
  if (row == n - 1) {
    // A pair for which there was no room counts as a row behind those that are there.
    const int64_t found = a.pairs_found == nullptr ? n : *a.pairs_found;
    int64_t rows = first + count;
    if (found > n) rows = (rows > a.rows.capacity ? rows : a.rows.capacity) + (found - n);
    *a.count = rows < 0x7FFFFFFF ? static_cast<int32_t>(rows) : 0x7FFFFFFF;
  }
  if (count == 0) return;
  const Vec2i pair = a.pairs[row];
  if (is_mesh_pair(a.shapes[pair.x].type, a.shapes[pair.y].type)) return;
  const geometry::Manifold& manifold = a.manifolds[row];
  const ToOwners owners = to_owners(a.shapes[pair.x], a.shapes[pair.y]);
  for (int32_t k = 0; k < count; ++k)
    write_contact(a.rows, first + k, pair, a.shapes, owners, manifold.normal, manifold.points[k]);
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
