// The contacts of a triangle mesh with a convex shape or another mesh. These kernels run between
// rigid_contact_find and rigid_contact_write (rigid_contact_kernels.h), which skip mesh pairs.
#pragma once

#include "novaphy/collision/geometry/mesh_mesh.h"
#include "novaphy/collision/geometry/rigid_rows_kernels.h"
#include "novaphy/core/row_kernel.h"
#include "novaphy/core/row_scratch.h"

namespace novaphy {

// A contact of a mesh pair that becomes a row. The normal points from the mesh to the other shape.
struct MeshRow {
  geometry::ContactPoint point;
  Vec3f normal;
};
struct MeshRows {
  int32_t count;
  MeshRow rows[geometry::kMeshContacts];
};

// Returns an id from the triangle and the feature on it. The id is the same in every step. Two
// different contacts have the same id with a probability of 2^-31.
inline int32_t mesh_point_id(int32_t triangle, int32_t feature) {
  uint32_t x = static_cast<uint32_t>(triangle) * 0x9E3779B9u + static_cast<uint32_t>(feature);
  x = (x ^ (x >> 16)) * 0x85EBCA6Bu;
  x = (x ^ (x >> 13)) * 0xC2B2AE35u;
  return static_cast<int32_t>((x ^ (x >> 16)) & 0x7FFFFFFFu);
}

// The contacts of a pair in the frame of the mesh. If more contacts are found than fit, they are
// reduced during the search. The search has the fixed order of the tree.
struct MeshContacts {
  static constexpr int32_t kCapacity = 512;
  geometry::MeshContact contacts[kCapacity];
  int32_t count;

  void find(const geometry::MeshView& mesh, const geometry::Shape& b, const Transformf& b_in_mesh,
            float reach) {
    count = 0;
    geometry::collide_mesh(mesh, b, b_in_mesh, reach, [&](const geometry::MeshContact& contact) {
      if (count == kCapacity)
        count = geometry::reduce_mesh_contacts(mesh, contacts, count, kCapacity / 2);
      contacts[count++] = contact;
    });
    count = geometry::reduce_mesh_contacts(mesh, contacts, count);
  }
  // Finds the contacts of two meshes in the same way as those of a mesh and a convex shape.
  void find(const geometry::MeshView& a, const geometry::MeshView& b, const Transformf& b_in_a,
            const geometry::MeshReach& reach) {
    count = 0;
    const Quatf& q = b_in_a.q;
    if (!geometry::is_finite(b_in_a.p) || !geometry::is_finite((q.x + q.y) + (q.z + q.w))) return;
    geometry::collide_meshes(a, b, b_in_a, reach, [&](const geometry::MeshContact& contact) {
      if (count == kCapacity) {
        count = geometry::drop_long_ways(contacts, count);
        count = geometry::reduce_mesh_contacts(a, contacts, count, kCapacity / 2);
      }
      contacts[count++] = contact;
    });
    count = geometry::drop_long_ways(contacts, count);
    count = geometry::reduce_mesh_contacts(a, contacts, count);
  }
};

struct RigidMeshFindArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> mesh_pairs;  // indices of mesh pairs in `pairs`
                    Reads<Vec2i> pairs; Reads<RigidShape> shapes;
                    Optional<Writes<MeshContacts>> scratch;  // for devices: a row per mesh pair
                    Writes<MeshRows> found;                  // a row for each mesh pair
                    Updates<int32_t> counts;                 // a row for each pair
  )
};
NOVAPHY_ROW_KERNEL(rigid_mesh_find, RigidMeshFindArguments) {
  const Vec2i pair = a.pairs[a.mesh_pairs[row]];
  const RigidShape& s0 = a.shapes[pair.x];
  const RigidShape& s1 = a.shapes[pair.y];
  MeshRows& kept = a.found[row];
  kept.count = 0;
  a.counts[a.mesh_pairs[row]] = 0;
  if (!geometry::boxes_meet(s0.box, s1.box)) return;
  const bool mesh_is_first = s0.type == GeoType::MESH;
  const RigidShape& mesh = mesh_is_first ? s0 : s1;
  const RigidShape& other = mesh_is_first ? s1 : s0;
  const float gap = s0.gap + s1.gap;
  NOVAPHY_ROW_SCRATCH(MeshContacts, found, a.scratch + row);
  const Transformf relative = geometry::relative_pose(mesh.pose, other.pose);
  const float reach = reach_of(s0, s1);
  if (other.type == GeoType::MESH)
    found.find(mesh.geometry->mesh, other.geometry->mesh, relative,
               geometry::mesh_reach(*mesh.geometry, *other.geometry, reach, reach - gap));
  else
    found.find(mesh.geometry->mesh, convex_shape(other), relative, reach);
  const float inside = ((core_radius(s0) + core_radius(s1)) + s0.margin) + s1.margin;
  for (int32_t k = 0; k < found.count; ++k) {
    const geometry::MeshContact& contact = found.contacts[k];
    MeshRow candidate;
    candidate.point = {math::transform_point(mesh.pose, contact.point.position),
                       contact.point.distance,
                       mesh_point_id(contact.triangle, contact.point.feature)};
    candidate.normal = math::normalize(math::rotate(mesh.pose.q, contact.normal));
    if (!mesh_is_first) candidate.normal = -candidate.normal;
    const CorePoints core = core_points(s0, s1, candidate.normal, candidate.point);
    // This form of the comparison excludes NaN.
    if (math::dot(core.b - core.a, candidate.normal) - inside <= s0.row_gap + s1.row_gap)
      kept.rows[kept.count++] = candidate;
  }
  a.counts[a.mesh_pairs[row]] = kept.count;
}

// Do for mesh pairs what rigid_contact_limit_sum, rigid_contact_farther and rigid_contact_trim do
// for other pairs.
struct RigidMeshLimitSumArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> mesh_pairs; Reads<Vec2i> pairs; Reads<RigidShape> shapes;
                    Reads<MeshRows> found; Number<int64_t> mesh_pair_count; Updates<int32_t> sums;)
};
NOVAPHY_ROW_KERNEL(rigid_mesh_limit_sum, RigidMeshLimitSumArguments) {
  for (int64_t m = row; m < a.mesh_pair_count; m += n) {
    const Vec2i pair = a.pairs[a.mesh_pairs[m]];
    for (int32_t i = 0; i < a.found[m].count; ++i)
      for (int32_t k = 0; k < kLimitParts; ++k)
        if (is_within(a.shapes[pair.x], a.shapes[pair.y], a.found[m].rows[i].point, k))
          ++a.sums[row * kLimitParts + k];
  }
}

struct RigidMeshFartherArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidContactLimit> limit; ReadsRow<int32_t> mesh_pairs;
                    Reads<Vec2i> pairs; Reads<RigidShape> shapes; Reads<MeshRows> found;
                    Updates<int32_t> farther;)
};
NOVAPHY_ROW_KERNEL(rigid_mesh_farther, RigidMeshFartherArguments) {
  const Vec2i pair = a.pairs[a.mesh_pairs[row]];
  const RigidShape &s0 = a.shapes[pair.x], &s1 = a.shapes[pair.y];
  int32_t count = 0;
  for (int32_t i = 0; a.limit->part > 0 && i < a.found[row].count; ++i) {
    const geometry::ContactPoint& point = a.found[row].rows[i].point;
    if (!is_within(s0, s1, point, a.limit->part) && is_within(s0, s1, point, a.limit->part - 1))
      ++count;
  }
  a.farther[a.mesh_pairs[row]] = count;
}

struct RigidMeshTrimArguments {
  NOVAPHY_ARGUMENTS(Reads<RigidContactLimit> limit; ReadsRow<int32_t> mesh_pairs;
                    Reads<Vec2i> pairs; Reads<RigidShape> shapes; Part<PairRows> farther;
                    Updates<MeshRows> found; Updates<int32_t> counts;)
};
NOVAPHY_ROW_KERNEL(rigid_mesh_trim, RigidMeshTrimArguments) {
  if (a.limit->part == 0) return;
  const Vec2i pair = a.pairs[a.mesh_pairs[row]];
  MeshRows& found = a.found[row];
  const int32_t count = found.count;
  int32_t before = rows_before(a.farther, a.mesh_pairs[row]);
  found.count = 0;
  for (int32_t i = 0; i < count; ++i)
    if (stays(*a.limit, a.shapes[pair.x], a.shapes[pair.y], found.rows[i].point, before))
      found.rows[found.count++] = found.rows[i];
  a.counts[a.mesh_pairs[row]] = found.count;
}

struct RigidMeshWriteArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> mesh_pairs; Reads<Vec2i> pairs; Reads<RigidShape> shapes;
                    Reads<MeshRows> found; Part<PairRows> of_pairs; Part<RigidContactRows> rows;)
};
NOVAPHY_ROW_KERNEL(rigid_mesh_write, RigidMeshWriteArguments) {
  const Vec2i pair = a.pairs[a.mesh_pairs[row]];
  const MeshRows& found = a.found[row];
  const ToOwners owners = to_owners(a.shapes[pair.x], a.shapes[pair.y]);
  const int32_t first = rows_before(a.of_pairs, a.mesh_pairs[row]);
  for (int32_t k = 0; k < found.count; ++k)
    write_contact(a.rows, first + k, pair, a.shapes, owners, found.rows[k].normal,
                  found.rows[k].point);
}

}  // namespace novaphy
