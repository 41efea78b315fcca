// Contacts of a triangle mesh (A) with a convex shape (B). The file collects the contacts of B with
// each nearby triangle (mesh_triangle.h), drops wrong contacts at interior edges, and reduces the
// rest.
//
// The reduction (reduce_mesh_contacts) sorts contacts by (distance, triangle, feature). Each
// contact is added to the first group whose deepest contact has a normal within 5 degrees. Each
// group keeps its deepest contact, and the contacts that are farthest in eight fixed directions
// perpendicular to the normal. The reduction ends when `limit` contacts are kept.
//
// The result depends only on the set of contacts. Their order has no effect, and the capacity has
// no effect if all contacts fit. Frame of the mesh, m.
#pragma once

#include "novaphy/collision/geometry/mesh_triangle.h"

namespace novaphy::geometry {

inline constexpr float kSeamNear = 0.05f;          // of the triangle: counts as the same place
inline constexpr float kLongWay = 2.0f;            // multiple of the shortest way out
inline constexpr float kGroupCosine = 0.9961947f;  // 5 deg
inline constexpr int32_t kGroupPoints = 9;
inline constexpr int32_t kMeshContacts = 32;  // per pair
inline constexpr float kSamePoint = 1e-4f;    // of the extent of a group's points
inline constexpr Vec3f kSteadyDirection = {0.83f, 0.47f, 0.31f};  // parallel to no common direction

// Returns the bounding box of B in the frame of the mesh, enlarged by the gap.
inline Box3 box_in_mesh(const ShapePair& pair, float gap) {
  const float grow = core_radius(*pair.b) + gap;
  Box3 box;
  float* lo[3] = {&box.lo.x, &box.lo.y, &box.lo.z};
  float* hi[3] = {&box.hi.x, &box.hi.y, &box.hi.z};
  for (int32_t i = 0; i < 3; ++i) {
    const Vec3f d = math::row(pair.rotation, i);
    const float p = component(pair.offset, i);
    *lo[i] = (p + math::dot(d, core_support(*pair.b, -d))) - grow;
    *hi[i] = (p + math::dot(d, core_support(*pair.b, d))) + grow;
  }
  return box;
}

// Calls add(contact) for all contacts within the gap, before reduction, in the order of the tree.
template <class Add>
void collide_mesh(const MeshView& mesh, const Shape& b, const Transformf& b_in_mesh, float gap,
                  Add add) {
  Shape none;
  const ShapePair pair = shape_pair(none, b, b_in_mesh);
  if (!is_finite(pair)) return;
  Vec3f half;
  // If triangles are large, the bounds of the cheap test are too loose.
  const bool foresees = core_box(b, half) && mesh.longest_edge <= kForeseenEdge * gap;
  for_triangles_in(mesh, box_in_mesh(pair, gap), [&](int32_t triangle) {
    const Foreseen known = foresees ? foresee(mesh, triangle, pair, half, gap) : Foreseen{};
    if (!known.no_contact) collide_triangle(mesh, triangle, b, b_in_mesh, gap, known.facing, add);
  });
}

inline bool comes_before(const MeshContact& a, const MeshContact& b) {
  if (a.point.distance != b.point.distance) return a.point.distance < b.point.distance;
  if (a.triangle != b.triangle) return a.triangle < b.triangle;
  return a.point.feature < b.point.feature;
}

inline void sort_mesh_contacts(MeshContact* c, int32_t count) {  // heap sort
  auto sift = [&](int32_t root, int32_t end) {
    for (int32_t child = 2 * root + 1; child < end; child = 2 * root + 1) {
      if (child + 1 < end && comes_before(c[child], c[child + 1])) ++child;
      if (!comes_before(c[root], c[child])) return;
      const MeshContact swap = c[root];
      c[root] = c[child];
      c[child] = swap;
      root = child;
    }
  };
  for (int32_t i = count / 2; i-- > 0;) sift(i, count);
  for (int32_t end = count - 1; end > 0; --end) {
    const MeshContact swap = c[0];
    c[0] = c[end];
    c[end] = swap;
    sift(0, end);
  }
}

// Returns whether the translation of `contact` moves B off the triangle of the contact `of`. If
// `of` has the rank Seam, both contacts must also be near each other, because a seam contact only
// repeats a contact of the same place.
inline bool takes_off(const MeshView& mesh, const MeshContact& contact, const MeshContact& of) {
  const Vec3i t = mesh.triangles[of.triangle];
  const Vec3f &x = mesh.vertices[t.x], &y = mesh.vertices[t.y], &z = mesh.vertices[t.z];
  const float size = math::max(math::length(y - x), math::length(z - x));
  const Vec3f& n = contact.normal;
  if (of.rank == MeshRank::Seam &&
      !(math::length(contact.point.position - of.point.position) <= kSeamNear * size))
    return false;
  if (math::max(math::dot(n, x), math::max(math::dot(n, y), math::dot(n, z))) <=
      contact.clears + kLeanSine * size)
    return true;
  const float along = -kAsDeep * contact.point.distance * math::dot(n, of.shortest);
  return along > 0.0f && along >= math::dot(of.shortest, of.shortest);
}

// Drops contacts that another contact explains. A contact explains another one if its translation
// moves B off the triangle of the other contact. The explaining contact has a lower rank, or the
// same rank and a shorter way out. A contact that is much deeper than its triangle requires is
// explained by any such contact.
//
// Exceptions for a WayOut contact: contacts in the same direction do not explain it. Nothing
// explains it if a Counts contact in the same direction is about as deep, as for a corner that has
// just passed an interior edge. Returns the number of remaining contacts, which keep their order.
inline int32_t drop_explained(const MeshView& mesh, MeshContact* c, int32_t count) {
  const auto is_explained = [&](int32_t of) {
    const MeshContact& contact = c[of];
    const bool is_long = contact.rank != MeshRank::Seam &&
                         contact.point.distance < -kLongWay * math::length(contact.shortest);
    bool explained = false;
    for (int32_t i = 0; i < count; ++i) {
      const MeshContact& by = c[i];
      if (by.rank > contact.rank || by.triangle == contact.triangle) continue;
      if (by.rank == contact.rank &&
          !(by.way_out > contact.way_out || (by.way_out == contact.way_out && i < of)))
        continue;
      if (contact.rank == MeshRank::WayOut &&
          math::dot(contact.normal, by.normal) >= kGroupCosine) {
        if (by.rank != MeshRank::WayOut && contact.point.distance >= kAsDeep * by.point.distance)
          return false;
        continue;
      }
      if (contact.rank != MeshRank::Seam && !(by.point.distance <= 0.0f)) continue;
      explained = explained || is_long || takes_off(mesh, by, contact);
    }
    return explained;
  };
  for (int32_t i = 0; i < count; ++i) c[i].kept = c[i].rank == MeshRank::Counts || !is_explained(i);
  int32_t n = 0;
  for (int32_t i = 0; i < count; ++i)
    if (c[i].kept) c[n++] = c[i];
  return n;
}

// Keeps the deepest contact of a group, which is the first, and the extreme contacts. Returns the
// number of kept contacts, at most `room`.
inline int32_t keep_extremes(MeshContact* c, int32_t count, int32_t group, float extent,
                             int32_t room) {
  const Vec3f n = c[group].normal, across = kSteadyDirection - n * math::dot(n, kSteadyDirection);
  const Vec3f u = math::length(across) > 0.1f ? math::normalize(across) : any_orthogonal(n);
  const Vec3f v = math::cross(n, u);
  const float same = kSamePoint * extent;
  int32_t kept = 0;
  Vec3f taken[kGroupPoints];
  const auto keep = [&](int32_t i) {
    for (int32_t k = 0; k < kept; ++k)
      if (!(math::length(taken[k] - c[i].point.position) > same)) return;
    if (kept == room || kept == kGroupPoints) return;
    taken[kept++] = c[i].point.position;
    c[i].kept = true;
  };
  bool has_deepest = false;
  constexpr float kHalf = 0.70710678f;
  const float x[8] = {1.0f, kHalf, 0.0f, -kHalf, -1.0f, -kHalf, 0.0f, kHalf};
  int32_t extremes[8];
  for (int32_t k = 0; k < 8; ++k) {
    const Vec3f direction = u * x[k] + v * x[(k + 6) % 8];
    float farthest = 0.0f;
    int32_t best = -1;
    for (int32_t i = group; i < count; ++i) {
      if (c[i].group != group) continue;
      const float along = math::dot(direction, c[i].point.position - c[group].point.position);
      if (best >= 0 && !(along > farthest)) continue;
      best = i;
      farthest = along;
    }
    extremes[k] = best;
    has_deepest = has_deepest || c[best].point.distance <= c[group].point.distance + same;
  }
  if (!has_deepest) keep(group);
  for (int32_t k = 0; k < 8; ++k) keep(extremes[k]);
  return kept;
}

// Reduces the contacts in place. Returns the number of remaining contacts, in the order of the head
// of the file.
inline int32_t reduce_mesh_contacts(const MeshView& mesh, MeshContact* c, int32_t count,
                                    int32_t limit = kMeshContacts) {
  sort_mesh_contacts(c, count);
  count = drop_explained(mesh, c, count);
  for (int32_t i = 0; i < count; ++i) {
    c[i].group = -1;
    c[i].kept = false;
  }
  int32_t kept = 0;
  for (int32_t seed = 0; seed < count && kept < limit; ++seed) {
    if (c[seed].group >= 0) continue;
    float extent = 0.0f;
    for (int32_t i = seed; i < count; ++i) {
      if (c[i].group >= 0 || math::dot(c[i].normal, c[seed].normal) < kGroupCosine) continue;
      c[i].group = seed;
      extent = math::max(extent, math::length(c[i].point.position - c[seed].point.position));
    }
    kept += keep_extremes(c, count, seed, extent, limit - kept);
  }
  int32_t n = 0;
  for (int32_t i = 0; i < count; ++i)
    if (c[i].kept) c[n++] = c[i];
  return n;
}

}  // namespace novaphy::geometry
