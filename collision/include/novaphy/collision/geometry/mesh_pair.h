// A triangle mesh (A) against a convex shape (B): the contacts of B with each triangle near it,
// without those of inner edges, and their reduction.
//
// Triangle against B: as any two convex shapes, with the normal n and a rank (MeshRank).
// - Counts. The normal stands: the mesh about the part of the triangle that is farthest along n
// stays
//   below the plane across n there (normal_stands), so that part is one of the surface and not of
//   its cut. Or n is within 3 degrees of the triangle's own normal, which takes its place with the
//   separation along it; only what of B lies over the triangle counts then.
// - Seam. In the second case B's deepest point lies over another triangle, and n stands: a convex
//   edge of less than 6 degrees.
// - WayOut. B overlaps the triangle, and n does not stand: B is deep, or the edge is flat or
// concave.
//   What of B lies over the triangle has the triangle's own normal.
// - Beside. As before, but nothing of B over the triangle touches it: B's deepest point.
// A contact that is no Counts stays only where no better one takes B off its triangle
// (drop_explained). So a shape slides over flat and concave edges as over one face, and a touch at
// one place takes nothing from another. A shape wholly behind a triangle does not touch it, so a
// shape far inside of a mesh has no contacts.
//
// Reduction (reduce_mesh_contacts) sorts contacts by (distance, triangle, feature). Each contact
// joins the first group whose deepest contact has a normal within 5 degrees. From each group the
// contacts stay that are farthest in eight directions across the normal. The directions are the
// same from step to step. The deepest stays too if none of these is as deep. Groups follow until
// `limit` contacts stay.
//
// The result is a function of the set: neither the order of contacts nor the capacity has an
// effect, as long as all found room.
// Frame of the mesh, m.
#pragma once

#include "novaphy/collision/geometry/convex_pair.h"
#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::geometry {

inline constexpr float kLeanSine = 1e-3f;     // a normal leans over an edge
inline constexpr float kBehindCosine = 0.1f;  // a normal points into the mesh, not along it
inline constexpr float kSeamNear = 0.05f;     // of the triangle: in one place
inline constexpr int32_t kBesideFace = 2;     // names what is not over the face
inline constexpr float kAsDeep = 1.2f;
inline constexpr float kLongWay = 2.0f;            // of the shortest
inline constexpr float kGroupCosine = 0.9961947f;  // 5 deg
inline constexpr int32_t kGroupPoints = 9;
inline constexpr int32_t kMeshContacts = 32;  // of a pair
inline constexpr float kSamePoint = 1e-4f;    // of the extent of a group's points
inline constexpr Vec3f kSteadyDirection = {0.83f, 0.47f, 0.31f};  // along nothing that is common

enum class MeshRank : int32_t { Counts, Seam, WayOut, Beside };

struct MeshContact {
  ContactPoint point{};
  Vec3f normal{};  // from the mesh to B
  int32_t triangle = 0;
  MeshRank rank = MeshRank::Counts;
  float way_out = 0.0f;  // m: the separation of B from the triangle along the normal
  Vec3f shortest{};      // m: the way that takes B off the triangle, were it alone
  float clears = 0.0f;   // m: how far along the normal B begins once it is out along it
  int32_t group = -1;    // within reduce_mesh_contacts
  bool kept = false;
};

// A triangle as a polytope with two faces, 0 in front and 1 behind.
struct TriangleHull {
  Vec3f vertices[3], normals[2];
  int32_t face_starts[3], face_vertices[6];
};
inline void make_triangle(TriangleHull& t, const MeshView& mesh, int32_t index) {
  const Vec3i v = mesh.triangles[index];
  t.vertices[0] = mesh.vertices[v.x];
  t.vertices[1] = mesh.vertices[v.y];
  t.vertices[2] = mesh.vertices[v.z];
  t.normals[0] = mesh.normals[index];
  t.normals[1] = -mesh.normals[index];
  for (int32_t k = 0; k < 3; ++k) {
    t.face_starts[k] = 3 * k;
    t.face_vertices[k] = k;
    t.face_vertices[3 + k] = 2 - k;
  }
}
inline HullView view_of(const TriangleHull& t) {
  HullView view;
  view.vertices = t.vertices;
  view.face_normals = t.normals;
  view.face_starts = t.face_starts;
  view.face_vertices = t.face_vertices;
  view.vertex_count = 3;
  view.face_count = 2;
  return view;
}

// The corners of the triangle that are farthest along n: what of it meets a shape that lies there.
inline Feature corners_along(const TriangleHull& t, const Vec3f& n) {
  float height[3];
  for (int32_t k = 0; k < 3; ++k) height[k] = math::dot(n, t.vertices[k] - t.vertices[0]);
  const float highest = math::max(height[0], math::max(height[1], height[2]));
  const float size = math::max(math::length(t.vertices[1] - t.vertices[0]),
                               math::length(t.vertices[2] - t.vertices[0]));
  Feature feature;
  feature.normal = t.normals[0];
  for (int32_t k = 0; k < 3; ++k)
    if (height[k] >= highest - kLeanSine * size) add_point(feature, t.vertices[k]);
  return feature;
}

// True if the mesh lies below the plane across n through the face, edge or corner of the triangle
// that is farthest along n: about an edge as the triangle beyond it tells, about a corner as its
// neighbours do.
inline bool normal_stands(const MeshView& mesh, int32_t triangle, const Vec3f& n) {
  const Vec3i t = mesh.triangles[triangle];
  const int32_t corners[3] = {t.x, t.y, t.z};
  float height[3], highest = 0.0f, size = 0.0f;
  for (int32_t k = 0; k < 3; ++k) {
    const Vec3f from_first = mesh.vertices[corners[k]] - mesh.vertices[t.x];
    height[k] = math::dot(n, from_first);
    size = math::max(size, math::length(from_first));
    if (k == 0 || height[k] > highest) highest = height[k];
  }
  int32_t count = 0, low = 0;
  for (int32_t k = 0; k < 3; ++k)
    if (height[k] >= highest - kLeanSine * size)
      ++count;
    else
      low = k;
  if (count == 3 && math::dot(n, mesh.normals[triangle]) >= kFaceCosine) return true;
  if (count == 2) {
    const Vec3i& all = mesh.across[triangle];
    const int32_t across = low == 0 ? all.y : low == 1 ? all.z : all.x;
    if (across == kMeshBorder) return true;
    if (across >= 0) {
      const Vec3f a = mesh.vertices[corners[(low + 1) % 3]];
      const Vec3f edge = mesh.vertices[corners[(low + 2) % 3]] - a;
      Vec3f d = mesh.vertices[across] - a;
      d = d - edge * (math::dot(d, edge) / math::dot(edge, edge));
      return math::dot(n, d) <= kLeanSine * math::length(d);
    }
  }
  for (int32_t k = 0; k < 3; ++k) {
    if (height[k] < highest - kLeanSine * size) continue;
    const Vec3f corner = mesh.vertices[corners[k]];
    for (int32_t i = mesh.ring_starts[corners[k]]; i < mesh.ring_starts[corners[k] + 1]; ++i) {
      const Vec3f d = mesh.vertices[mesh.ring[i]] - corner;
      if (math::dot(n, d) > kLeanSine * math::length(d)) return false;
    }
  }
  return true;
}

// Proximity along the triangle's own normal.
inline Proximity face_proximity(const ShapePair& pair, const TriangleHull& t) {
  const Vec3f n = t.normals[0];
  const SupportPoint p = support_point(pair, n);
  const float r = core_radius(*pair.b), distance = math::dot(p.b - t.vertices[0], n) - r;
  const Vec3f on_b = p.b - n * r;
  return {n, distance, on_b - n * distance, on_b};
}

// Calls add(contact) for the contacts of B with one triangle, before reduction.
template <class Add>
NOVAPHY_OUT_OF_LINE void collide_triangle(const MeshView& mesh, int32_t triangle, const Shape& b,
                                          const Transformf& b_in_mesh, float gap, Add add) {
  if (mesh.normals[triangle] == Vec3f{}) return;
  TriangleHull t;
  make_triangle(t, mesh, triangle);
  Shape a;
  a.type = GeoType::CONVEX_MESH;
  a.hull = view_of(t);
  const ShapePair pair = shape_pair(a, b, b_in_mesh);
  const Proximity nearest = convex_proximity(pair, gap);
  if (!(nearest.distance <= gap)) return;
  const auto emit = [&](const ContactPoint& point, const Proximity& along, MeshRank rank) {
    MeshContact contact;
    contact.point = point;
    contact.normal = along.normal;
    contact.triangle = triangle;
    contact.rank = rank;
    contact.way_out = along.distance;
    contact.shortest = nearest.normal * -nearest.distance;
    contact.clears = math::dot(along.normal, along.on_b) + math::max(-point.distance, 0.0f);
    add(contact);
  };
  const auto emit_all = [&](const ContactCandidates& found, const Proximity& along, MeshRank rank) {
    for (int32_t i = 0; i < found.count; ++i) emit(found.points[i], along, rank);
  };
  const float cosine = math::dot(nearest.normal, t.normals[0]);
  const bool stands = cosine >= -kBehindCosine && normal_stands(mesh, triangle, nearest.normal);
  const bool faces = cosine >= kFaceCosine;
  Feature front, facing;
  if (stands && !faces) {
    facing_features(pair, nearest.normal, front, facing);
    emit_all(clip_candidates(pair, nearest, corners_along(t, nearest.normal), facing, gap), nearest,
             MeshRank::Counts);
    return;
  }
  if (!faces && nearest.distance > 0.0f) return;
  const Proximity over = face_proximity(pair, t);
  facing_features(pair, over.normal, front, facing);
  ContactCandidates found;
  found.normal = over.normal;
  const bool as_deep = clip_features(pair, over, front, facing, true, gap, found);
  // The deepest point of a round or turned shape is no corner of its feature.
  Feature deepest;
  add_point(deepest, over.on_b);
  if (!as_deep && over.distance <= gap && clip_to_face(front, deepest).count == 1)
    add_contact(found, (over.on_a + over.on_b) * 0.5f, over.distance,
                contact_feature(front.face, facing.face, kWitnessCode));
  emit_all(found, over, faces ? MeshRank::Counts : MeshRank::WayOut);
  if (!stands) {
    if (nearest.distance > 0.0f || cosine < -kBehindCosine) return;
    for (int32_t i = 0; i < found.count; ++i)
      if (found.points[i].distance <= 0.0f) return;
    emit({(over.on_a + over.on_b) * 0.5f, over.distance,
          contact_feature(kBesideFace, facing.face, kWitnessCode)},
         over, MeshRank::Beside);
    return;
  }
  // B's deepest point may lie over a face that falls away from this one.
  const float deep = nearest.distance + (kAsDeep - 1.0f) * math::abs(nearest.distance) +
                     kDeepestShare * extent(front);
  for (int32_t i = 0; i < found.count; ++i)
    if (found.points[i].distance <= deep) return;
  facing_features(pair, nearest.normal, front, facing);
  Feature seam = corners_along(t, nearest.normal);
  seam.face = kBesideFace;
  emit_all(clip_candidates(pair, nearest, seam, facing, gap), nearest, MeshRank::Seam);
}

// The box of B in the mesh, grown by the gap.
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
  for_triangles_in(mesh, box_in_mesh(pair, gap), [&](int32_t triangle) {
    collide_triangle(mesh, triangle, b, b_in_mesh, gap, add);
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

// True if B no longer meets the triangle of `of` once it is out along `contact`. For a seam, which
// only doubles what is in its place, they must be near.
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

// Drops contacts that another one explains, which takes B off their triangle: one of a lower rank,
// or of the same with a shorter way. For one that is far deeper than its triangle alone would have
// it, any such contact will do. A way out over its triangle is not explained by contacts in
// its own direction; where one that counts is about as deep, nothing explains it: a corner that has
// just passed an inner edge. The number that stays, in order.
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

// Keeps the deepest contact of group `group` (its first one) and its extremes; the number kept, at
// most `room`.
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

// Reduces in place; the number that stays, sorted as above.
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
