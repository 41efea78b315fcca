// The kernels of the search for soft contacts (see collision_pipeline.h). The first kernel prepares
// the shapes. Every candidate pair of a particle and a shape (candidate_pairs.h) tests whether it
// touches. A scan of the results gives the slot of each pair, and touching pairs write their
// contact.
#pragma once

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/collision/geometry/point_distance.h"
#include "novaphy/collision/geometry/shapes/list.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {

// The data of a shape that particles may touch.
struct SoftContactShape {
  GeoType type;
  float reach;  // m: gap + margin
  Vec3f scale;
  Transformf xform, pose, to_local;  // shape to body, shape to world, world to shape
  Vec3f velocity;  // zero velocity of the surface, body frame; its zeros have the signs of a
                   // rotated vector
  const geometry::GeometryView* geometry;  // for a hull or mesh, else null
};

// Returns the signed distance (m) and normal for a particle at x with the given radius (m), in the
// frame of the shape.
inline SurfaceDistance<float> surface_distance(const SoftContactShape& shape, const Vec3f& x,
                                               float radius) {
  if (shape.geometry != nullptr) {
    const geometry::SolidPoint point =
        shape.type == GeoType::MESH
            ? geometry::point_to_mesh(x, shape.geometry->mesh, shape.reach + radius)
            : geometry::point_to_hull(x, shape.geometry->hull);
    return {point.distance, point.normal};
  }
  if (!has_trait<&ShapeTraits::is_convex>(shape.type))
    return plane_distance(x, shape.scale.x, shape.scale.y);
  return geometry::with_solid(shape.type, shape.scale,
                              [&](const auto& solid) { return solid.distance(x); });
}

// Prepares shapes. The inputs are detached, because a contact has no gradient.
struct SoftContactShapeArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> candidates;  // shapes that particles may touch
                    Reads<int32_t> body; Detached<Reads<Transformf>> body_q; Reads<int32_t> type;
                    Detached<Reads<Vec3f>> scale; Detached<Reads<Transformf>> xform;
                    Detached<Reads<float>> margin; Number<float> gap;
                    Reads<int32_t> geometry;  // for each shape: row of `views`, or -1
                    Reads<geometry::GeometryView> views;
                    Writes<SoftContactShape> shapes;  // for each shape of the model
  )
};
// Prepares the candidate shape `row`.
NOVAPHY_ROW_KERNEL(soft_contact_shape, SoftContactShapeArguments) {
  const int32_t s = a.candidates[row];
  SoftContactShape& shape = a.shapes[s];
  shape.type = static_cast<GeoType>(a.type[s]);
  shape.reach = a.gap.value + a.margin[s];
  shape.scale = a.scale[s];
  shape.xform = a.xform[s];
  const int32_t body = a.body[s];
  shape.pose =
      body < 0 ? static_shape_pose(shape.xform) : math::multiply(a.body_q[body], shape.xform);
  shape.to_local = math::inverse(shape.pose);
  shape.velocity = math::rotate(shape.xform.q, Vec3f{});
  shape.geometry = a.geometry[s] < 0 ? nullptr : &a.views[a.geometry[s]];
}

struct SoftContactTouchArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> pair_particle;  // this and the next: a row for each pair
                    ReadsRow<int32_t> pair_shape; Reads<SoftContactShape> shapes;
                    Detached<Reads<Vec3f>> q; Detached<Reads<float>> radius; Reads<int32_t> flags;
                    WritesRow<int32_t> touches;  // a row for each pair
  )
};
// Sets touches to 1 if the pair `row` touches, else to 0.
NOVAPHY_ROW_KERNEL(soft_contact_touch, SoftContactTouchArguments) {
  const int32_t p = a.pair_particle[row];
  const SoftContactShape& shape = a.shapes[a.pair_shape[row]];
  bool touches = has_flag(a.flags[p], ParticleFlags::ACTIVE);
  if (touches) {
    const Vec3f x = math::transform_point(shape.to_local, a.q[p]);
    touches = surface_distance(shape, x, a.radius[p]).distance < shape.reach + a.radius[p];
  }
  a.touches[row] = touches ? 1 : 0;
}

struct SoftContactWriteArguments {
  NOVAPHY_ARGUMENTS(
      ReadsRow<int32_t> pair_particle;  // this and the next: a row for each pair
      ReadsRow<int32_t> pair_shape; Reads<SoftContactShape> shapes; Detached<Reads<Vec3f>> q;
      Detached<Reads<float>> radius;
      ReadsRow<int32_t> before;  // slots before each pair: the scan of soft_contact_touch
      Number<int64_t> slots;
      UpdatesRow<int32_t> tids;         // input: whether the pair touches; output: its slot, or -1
      Writes<int32_t> count, particle;  // from here on: a row for each slot
      Writes<int32_t> shape; Writes<Vec3f> body_pos, body_vel, normal;)
};
// Writes the contact of the pair `row` into its slot, if the pair touches.
NOVAPHY_ROW_KERNEL(soft_contact_write, SoftContactWriteArguments) {
  const int32_t slot = a.before[row];
  const bool touches = a.tids[row] != 0;
  if (row == n - 1) *a.count = slot + (touches ? 1 : 0);
  if (!touches || slot >= a.slots) {
    a.tids[row] = -1;
    return;
  }
  const int32_t p = a.pair_particle[row], s = a.pair_shape[row];
  const SoftContactShape& shape = a.shapes[s];
  const Vec3f x = math::transform_point(shape.to_local, a.q[p]);
  const StaticContact<float> contact =
      static_contact_record(shape.xform, shape.pose, x, surface_distance(shape, x, a.radius[p]));
  a.tids[row] = slot;
  a.particle[slot] = p;
  a.shape[slot] = s;
  a.body_pos[slot] = contact.point;
  a.body_vel[slot] = shape.velocity;
  a.normal[slot] = contact.normal;
}

struct SoftContactNoneArguments {
  NOVAPHY_ARGUMENTS(Writes<int32_t> count;)
};
// Sets the count to 0 if no pair exists.
NOVAPHY_ROW_KERNEL(soft_contact_none, SoftContactNoneArguments) { a.count[row] = 0; }

struct SoftContactClearArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> count; Writes<int32_t> particle;  // from here on: a row per slot
                    Writes<int32_t> shape; Writes<Vec3f> body_pos, body_vel, normal;)
};
// Clears the slot `row` if it is after the last contact.
NOVAPHY_ROW_KERNEL(soft_contact_clear, SoftContactClearArguments) {
  if (row < *a.count) return;
  a.particle[row] = -1;
  a.shape[row] = -1;
  a.body_pos[row] = Vec3f{};
  a.body_vel[row] = Vec3f{};
  a.normal[row] = Vec3f{};
}

struct ContactGenerationArguments {
  NOVAPHY_ARGUMENTS(UpdatesRow<int32_t> generation;)
};
// Increases the generation. This launch is separate, so that a step that runs again for a gradient
// does not depend on the earlier generation.
NOVAPHY_ROW_KERNEL(contact_generation, ContactGenerationArguments) { ++a.generation[row]; }

}  // namespace novaphy
