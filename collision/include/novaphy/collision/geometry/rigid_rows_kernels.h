// Writes the rows of rigid contacts, for the kernels of a search.
#pragma once

#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/row_kernel.h"

namespace novaphy {

// The output arrays of the rows.
struct RigidContactRows {
  NOVAPHY_ARGUMENTS(Number<int64_t> capacity;
                    Writes<int32_t> rigid_contact_shape0, rigid_contact_shape1;
                    Writes<Vec3f> rigid_contact_point0, rigid_contact_point1, rigid_contact_offset0,
                    rigid_contact_offset1, rigid_contact_normal;
                    Writes<float> rigid_contact_margin0, rigid_contact_margin1;
                    Writes<int32_t> rigid_contact_point_id;)
};

// `counts`: the number of rows of each pair. `before`: the number of rows before each chunk of
// kScanChunk pairs. A scan over chunks is short even if the list has room for many more pairs.
inline constexpr int64_t kScanChunk = 32;
struct PairRows {
  NOVAPHY_ARGUMENTS(Reads<int32_t> counts, before;)
};
inline int32_t rows_before(const PairRows& rows, int64_t pair) {
  int32_t sum = rows.before[pair / kScanChunk];
  for (int64_t k = pair - pair % kScanChunk; k < pair; ++k) sum += rows.counts[k];
  return sum;
}
inline int32_t rows_up_to(const PairRows& rows, int64_t pair) {
  return rows_before(rows, pair) + rows.counts[pair];
}

// The transforms from the world into the frames of the owners (bodies or the world) of a pair's
// shapes.
struct ToOwners {
  Transformf to0, to1;
};
inline ToOwners to_owners(const RigidShape& s0, const RigidShape& s1) {
  return {math::inverse(s0.owner), math::inverse(s1.owner)};
}
// Writes the row `at` unless it is beyond the capacity. The normal points from shape pair.x to
// pair.y.
inline void write_contact(const RigidContactRows& rows, int64_t at, const Vec2i& pair,
                          const RigidShape* shapes, const ToOwners& owners, const Vec3f& normal,
                          const geometry::ContactPoint& point) {
  if (at >= rows.capacity) return;
  const RigidShape& s0 = shapes[pair.x];
  const RigidShape& s1 = shapes[pair.y];
  const Transformf &to0 = owners.to0, &to1 = owners.to1;
  const CorePoints core = core_points(s0, s1, normal, point);
  const float margin0 = core_radius(s0) + s0.margin, margin1 = core_radius(s1) + s1.margin;
  rows.rigid_contact_shape0[at] = pair.x;
  rows.rigid_contact_shape1[at] = pair.y;
  rows.rigid_contact_point0[at] = math::transform_point(to0, core.a);
  rows.rigid_contact_point1[at] = math::transform_point(to1, core.b);
  rows.rigid_contact_offset0[at] = math::rotate(to0.q, normal * margin0);
  rows.rigid_contact_offset1[at] = math::rotate(to1.q, normal * -margin1);
  rows.rigid_contact_normal[at] = normal;
  rows.rigid_contact_margin0[at] = margin0;
  rows.rigid_contact_margin1[at] = margin1;
  rows.rigid_contact_point_id[at] = point.feature;
}

}  // namespace novaphy
