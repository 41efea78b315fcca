// The kernels of the search for rigid contacts (see collision_pipeline.h). Shapes are transformed
// to the world frame, and every candidate pair computes its manifold. A scan of the counts gives
// the first row of each pair, and the pairs write their rows. If more rows than slots exist, pairs
// keep only the rows within a common fraction of their gaps.
#pragma once

#include "novaphy/collision/geometry/collide.h"
#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/collision/geometry/rigid_rows_kernels.h"
#include "novaphy/collision/geometry/shapes/list.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {

// Returns an upper bound of the extent of the shape (m) from its origin along a unit vector in its
// frame. For a hull or mesh the extent is measured from the middle of its box.
inline float reach_along(const RigidShape& shape, const Vec3f& axis) {
  const float x = math::abs(axis.x), y = math::abs(axis.y), z = math::abs(axis.z);
  if (shape.geometry != nullptr) {
    const Vec3f size = shape.geometry->box.hi - shape.geometry->box.lo;
    return 0.5f * ((size.x * x + size.y * y) + size.z * z);
  }
  if (!has_trait<&ShapeTraits::is_convex>(shape.type)) return 1.0e6f;  // a plane
  return geometry::with_solid(shape.type, shape.scale, [&](const auto& solid) {
    return solid.extent({x, y, z});
  });
}

// Returns the shape's part of the distance at which points may touch within a step of dt. The part
// is twice the path of the shape's points, plus kMoreSpeed (m/s) dt for velocity changes in the
// step. Both terms are slightly larger than the limits of the solvers
// (dynamics/articulation/islands.h), so that the solvers get all rows that they solve.
inline constexpr float kMoreSpeed = 2.1f;
inline float step_gap(const RigidShape& shape, const SpatialVectorf& twist, const Vec3f& arm,
                      float dt) {
  const Vec3f reach = {reach_along(shape, {1.0f, 0.0f, 0.0f}),
                       reach_along(shape, {0.0f, 1.0f, 0.0f}),
                       reach_along(shape, {0.0f, 0.0f, 1.0f})};
  const float speed =
      math::length(twist.linear + math::cross(twist.angular, arm)) +
      math::length(twist.angular) * (math::length(reach) + (shape.margin + shape.gap));
  return (2.0f * speed + kMoreSpeed) * dt;
}

// Returns whether rigid_mesh_kernels.h handles a pair: a mesh with a convex shape or another mesh.
// Requires a <= b.
inline bool is_mesh_pair(GeoType a, GeoType b) {
  return a == GeoType::MESH || (b == GeoType::MESH && a != GeoType::PLANE);
}

struct RigidContactShapeArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> shape_body, shape_type; Detached<Reads<Vec3f>> shape_scale;
                    Detached<Reads<Transformf>> shape_transform;
                    Detached<Reads<float>> shape_margin, shape_gap;
                    Detached<Reads<Transformf>> body_q; Detached<Reads<SpatialVectorf>> body_qd;
                    Detached<Reads<Vec3f>> body_com; Detached<Reads<float>> shape_material_ka;
                    Number<float> dt;            // s, step that the rows are for; 0: no limit
                    ReadsRow<int32_t> geometry;  // row of `views`, or -1
                    Reads<geometry::GeometryView> views; Writes<RigidShape> shapes;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_shape, RigidContactShapeArguments) {
  RigidShape& shape = a.shapes[row];
  const int32_t body = a.shape_body[row];
  shape.type = static_cast<GeoType>(a.shape_type[row]);
  shape.geometry = a.geometry[row] < 0 ? nullptr : &a.views[a.geometry[row]];
  shape.scale = a.shape_scale[row];
  shape.margin = a.shape_margin[row];
  shape.gap = a.shape_gap[row];
  shape.owner = body < 0 ? Transformf::identity() : a.body_q[body];
  shape.pose =
      body < 0 ? a.shape_transform[row] : math::multiply(shape.owner, a.shape_transform[row]);
  Vec3f center = shape.pose.p;
  if (shape.geometry != nullptr) {
    const geometry::Box3& box = shape.geometry->box;
    center = math::transform_point(shape.pose, (box.lo + box.hi) * 0.5f);
  }
  shape.row_gap = shape.gap;
  if (a.dt.value > 0.0f) {
    const SpatialVectorf twist = body < 0 ? SpatialVectorf{} : a.body_qd[body];
    const Vec3f com = body < 0 ? center : math::transform_point(shape.owner, a.body_com[body]);
    // Adhesion acts up to the distance shape_material_ka (m).
    shape.row_gap = math::min(
        shape.gap, step_gap(shape, twist, center - com, a.dt.value) + a.shape_material_ka[row]);
  }
  // The boxes grow by more than the rounding errors, so that touching shapes always overlap.
  const float beyond = (shape.margin + shape.row_gap) + 1.0e-4f;
  const Vec3f grow = {
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{1.0f, 0.0f, 0.0f})),
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{0.0f, 1.0f, 0.0f})),
      beyond + reach_along(shape, math::rotate_inverse(shape.pose.q, Vec3f{0.0f, 0.0f, 1.0f}))};
  shape.box = {center - grow, center + grow};
}

// Returns the manifold of a pair with a.type <= b.type in the world frame. Points whose distance
// exceeds `reach` (m) may be missing.
inline geometry::Manifold rigid_manifold(const RigidShape& a, const RigidShape& b, float reach) {
  using namespace geometry;
  if (a.type != GeoType::PLANE)
    return collide(convex_shape(a), a.pose, convex_shape(b), b.pose, reach);
  const Plane plane = plane_of(a.pose);
  if (b.geometry == nullptr)
    return with_solid(b.type, b.scale,
                      [&](const auto& solid) { return solid.on_plane(plane, b.pose, reach); });
  const GeometryView& solid = *b.geometry;
  const bool is_mesh = b.type == GeoType::MESH;
  return plane_vertices(plane, b.pose, is_mesh ? solid.mesh.vertices : solid.hull.vertices,
                        is_mesh ? solid.mesh.vertex_count : solid.hull.vertex_count,
                        math::length(solid.box.hi - solid.box.lo), reach);
}

// Keeps the points of a manifold that become rows. A pair without a plane has at most `per_pair`
// rows.
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
    // This form of the comparison excludes NaN.
    if (math::dot(core.b - core.a, kept.normal) - inside <= s0.row_gap + s1.row_gap)
      kept.points[kept.count++] = found.points[k];
  }
}

struct RigidContactFindArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<int32_t>> pairs_found;  // number of valid pairs; null: all pairs
                    ReadsRow<Vec2i> pairs; Reads<RigidShape> shapes;
                    Number<int64_t> per_pair;  // largest number of rows of a pair without a plane
                    Writes<geometry::Manifold> manifolds;  // the points of each pair that are rows
                    WritesRow<int32_t> counts;             // number of these points
  )
};
NOVAPHY_ROW_KERNEL(rigid_contact_find, RigidContactFindArguments) {
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

// Sums counts over chunks of kScanChunk pairs.
struct RigidContactChunkArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> counts; Number<int64_t> pair_count; WritesRow<int32_t> sums;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_chunk, RigidContactChunkArguments) {
  int32_t sum = 0;
  for (int64_t k = row * kScanChunk; k < (row + 1) * kScanChunk && k < a.pair_count; ++k)
    sum += a.counts[k];
  a.sums[row] = sum;
}

inline constexpr int64_t kLimitSums = 128;  // number of partial sums

// Counts the rows within each fraction of the gap, as partial sums. rigid_mesh_limit_sum adds the
// rows of mesh pairs.
struct RigidContactLimitSumArguments {
  NOVAPHY_ARGUMENTS(Reads<Vec2i> pairs; Reads<RigidShape> shapes;
                    Reads<geometry::Manifold> manifolds; Part<PairRows> found;
                    Number<int64_t> pair_count, capacity;
                    Writes<int32_t> sums;  // kLimitParts values for each partial sum
  )
};
NOVAPHY_ROW_KERNEL(rigid_contact_limit_sum, RigidContactLimitSumArguments) {
  if (rows_up_to(a.found, a.pair_count - 1) <= a.capacity) return;
  int32_t sums[kLimitParts] = {};
  for (int64_t pair = row; pair < a.pair_count; pair += n) {
    if (a.found.counts[pair] == 0) continue;
    const RigidShape& s0 = a.shapes[a.pairs[pair].x];
    const RigidShape& s1 = a.shapes[a.pairs[pair].y];
    if (is_mesh_pair(s0.type, s1.type)) continue;
    for (int32_t i = 0; i < a.found.counts[pair]; ++i)
      for (int32_t k = 0; k < kLimitParts; ++k)
        sums[k] += is_within(s0, s1, a.manifolds[pair].points[i], k) ? 1 : 0;
  }
  for (int32_t k = 0; k < kLimitParts; ++k) a.sums[row * kLimitParts + k] = sums[k];
}

struct RigidContactLimitArguments {
  NOVAPHY_ARGUMENTS(Part<PairRows> found; Reads<int32_t> sums;
                    Number<int64_t> pair_count, capacity, rows;  // rows: number of partial sums
                    Writes<RigidContactLimit> limit;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_limit, RigidContactLimitArguments) {
  *a.limit = {rows_up_to(a.found, a.pair_count - 1), 0, 0};
  if (a.limit->total <= a.capacity) return;
  int64_t sum = a.limit->total;
  while (sum > a.capacity) {
    ++a.limit->part;
    sum = 0;
    for (int64_t i = 0; i < a.rows; ++i) sum += a.sums[i * kLimitParts + a.limit->part];
  }
  a.limit->room = static_cast<int32_t>(a.capacity - sum);
}

// Counts for each pair the rows that are outside of the limit's fraction and within the next larger
// fraction.
struct RigidContactFartherArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidContactLimit> limit; ReadsRow<Vec2i> pairs; Reads<RigidShape> shapes;
                    Reads<geometry::Manifold> manifolds; ReadsRow<int32_t> counts;
                    WritesRow<int32_t> farther;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_farther, RigidContactFartherArguments) {
  const RigidShape& s0 = a.shapes[a.pairs[row].x];
  const RigidShape& s1 = a.shapes[a.pairs[row].y];
  int32_t count = 0;
  const bool is_mesh = is_mesh_pair(s0.type, s1.type);
  for (int32_t i = 0; a.limit->part > 0 && !is_mesh && i < a.counts[row]; ++i) {
    const geometry::ContactPoint& point = a.manifolds[row].points[i];
    if (!is_within(s0, s1, point, a.limit->part) && is_within(s0, s1, point, a.limit->part - 1))
      ++count;
  }
  a.farther[row] = count;
}

struct RigidContactTrimArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidContactLimit> limit; ReadsRow<Vec2i> pairs; Reads<RigidShape> shapes;
                    Part<PairRows> farther; Updates<geometry::Manifold> manifolds;
                    Updates<int32_t> counts;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_trim, RigidContactTrimArguments) {
  if (a.limit->part == 0 || a.counts[row] == 0) return;
  const RigidShape& s0 = a.shapes[a.pairs[row].x];
  const RigidShape& s1 = a.shapes[a.pairs[row].y];
  if (is_mesh_pair(s0.type, s1.type)) return;
  geometry::Manifold& manifold = a.manifolds[row];
  const int32_t count = manifold.count;
  int32_t before = rows_before(a.farther, row);
  manifold.count = 0;
  for (int32_t i = 0; i < count; ++i)
    if (stays(*a.limit, s0, s1, manifold.points[i], before))
      manifold.points[manifold.count++] = manifold.points[i];
  a.counts[row] = manifold.count;
}

struct RigidContactWriteArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<RigidContactLimit>> limit;  // null: all rows fit
                    Optional<Reads<int32_t>> pairs_found;  // may exceed the room; null: all pairs
                    ReadsRow<Vec2i> pairs; Reads<RigidShape> shapes;
                    Reads<geometry::Manifold> manifolds; Part<PairRows> found;
                    Writes<int32_t> rigid_contact_count; Part<RigidContactRows> rows;
                    Writes<int32_t> rows_filled;)
};
NOVAPHY_ROW_KERNEL(rigid_contact_write, RigidContactWriteArguments) {
  const int32_t count = a.found.counts[row];
  if (count == 0 && row < n - 1) return;
  const int32_t first = rows_before(a.found, row);
  if (row == n - 1) {
    // Each pair that did not fit into the list of pairs counts as one row after the written rows.
    const int64_t found = a.pairs_found == nullptr ? n : *a.pairs_found;
    int64_t rows = a.limit == nullptr ? first + count : a.limit->total;
    *a.rows_filled = first + count;
    if (found > n) rows = (a.rows.capacity < rows ? rows : a.rows.capacity.value) + (found - n);
    *a.rigid_contact_count = rows < 0x7FFFFFFF ? static_cast<int32_t>(rows) : 0x7FFFFFFF;
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
  NOVAPHY_ARGUMENTS(Number<int64_t> pairs; Updates<int32_t> rigid_contact_count;
                    Optional<Reads<int32_t>> rows_filled;  // null: no rows
                    Reads<int32_t> shape0;                 // of each row

                    Part<RigidContactRows> rows; Writes<Vec3f> rigid_contact_force;)
};
// Clears a row after the last contact, or clears the force of a valid row. The last thread sets the
// count to 0 if no pair exists.
NOVAPHY_ROW_KERNEL(rigid_contact_clear, RigidContactClearArguments) {
  if (row == n - 1) {
    if (a.pairs == 0) *a.rigid_contact_count = 0;
    return;
  }
  const bool touches = a.rows_filled != nullptr && row < *a.rows_filled;
  if (!touches && a.shape0[row] < 0) return;  // already empty
  a.rigid_contact_force[row] = Vec3f{};
  if (touches) return;
  a.rows.rigid_contact_shape0[row] = -1;
  a.rows.rigid_contact_shape1[row] = -1;
  a.rows.rigid_contact_point0[row] = Vec3f{};
  a.rows.rigid_contact_point1[row] = Vec3f{};
  a.rows.rigid_contact_offset0[row] = Vec3f{};
  a.rows.rigid_contact_offset1[row] = Vec3f{};
  a.rows.rigid_contact_normal[row] = Vec3f{};
  a.rows.rigid_contact_margin0[row] = 0.0f;
  a.rows.rigid_contact_margin1[row] = 0.0f;
  a.rows.rigid_contact_point_id[row] = -1;
}

}  // namespace novaphy
