// Finds which contacts have moving contact points (moving_contact_trace.h), one contact row per
// kernel row. Freestanding: shared by host and device kernels.
#pragma once

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/semi_implicit/moving_contact_trace.h"

namespace novaphy {

inline bool is_endless_plane(int32_t type, const Vec3f& scale) {
  return type == static_cast<int32_t>(GeoType::PLANE) && !(scale.x > 0.0f && scale.y > 0.0f);
}

// Returns whether the derivative of a particle's contact point on a shape is exact everywhere. The
// derivative on a hull, a mesh or a finite plane takes the face at the point for endless.
inline bool is_followed_by_particles(int32_t type) {
  const auto is = [&](GeoType wanted) { return type == static_cast<int32_t>(wanted); };
  return !is(GeoType::PLANE) && !is(GeoType::MESH) && !is(GeoType::CONVEX_MESH);
}

// Arrays of contacts, of the model and of a state.
struct MovingContacts {
  NOVAPHY_ARGUMENTS(Reads<int32_t> shape0, shape1; Detached<Reads<Vec3f>> point0, point1, normal;
                    Detached<Reads<Transformf>> body_q; Reads<int32_t> shape_body, shape_type;
                    Detached<Reads<Transformf>> shape_transform;
                    Detached<Reads<Vec3f>> shape_scale;)
};
// Returns whether the points and the normal of a contact row move with the state. The contact must
// have been found from the state.
inline bool contact_moves(const MovingContacts& c, int64_t row) {
  const int32_t shape[2] = {c.shape0[row], c.shape1[row]};
  const Vec3f point[2] = {c.point0[row], c.point1[row]}, normal = c.normal[row];
  Transformf pose[2];
  Vec3f world[2];
  for (int side = 0; side < 2; ++side) {
    const int32_t body = c.shape_body[shape[side]];
    pose[side] = body < 0 ? Transformf::identity() : c.body_q[body];
    world[side] = math::transform_point(pose[side], point[side]);
  }
  const auto feature = [&](int side) {
    const int32_t type = c.shape_type[shape[side]];
    const auto is = [&](GeoType wanted) { return type == static_cast<int32_t>(wanted); };
    const auto of = contact_shape<GeoType, bool, float>(is, c.shape_transform[shape[side]],
                                                        c.shape_scale[shape[side]]);
    return contact_feature_of(of, pose[side], point[side], world[1 - side], normal, side == 0);
  };
  return moving_contact(feature(0), feature(1), normal).is_exact;
}

}  // namespace novaphy
