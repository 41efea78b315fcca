// A triangle mesh (A) against a convex shape (B): the contacts of B with each triangle near it,
// without those of inner edges, and their reduction.
//
// Triangle against B: as any two convex shapes. The normal n stands if the mesh about the corners
// of the triangle that lie farthest along n stays below the plane across n there (normal_stands):
// over flat and concave edges it does not, since such an edge is only a cut. Then the triangle's
// own normal takes its place, with the separation along it, and only what of B lies over the
// triangle counts. So a shape slides over flat and concave edges as over one face. Where n does not
// stand and points into the mesh, B is deep: such contacts count only where a pair has no others,
// and of them those along the shortest way out. What is wholly behind a triangle does not touch it,
// so a shape far inside of a mesh has no contacts.
//
// Reduction (reduce_mesh_contacts): contacts are sorted by (distance, triangle, feature); each
// joins the first group whose deepest contact has a normal within 5 degrees; of a group stay those
// that are farthest in eight directions across the normal, which are the same from step to step,
// and the deepest if none of these is as deep; groups follow until `limit` contacts stay. The
// result is a function of the set: the order in which contacts came has no effect, nor has the
// capacity, as long as all found room.
// Frame of the mesh, m.
#pragma once

#include "novaphy/collision/geometry/convex_pair.h"
#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::geometry {

inline constexpr float kLeanSine = 1e-3f;     // a normal leans over an edge
inline constexpr float kBehindCosine = 0.1f;  // a normal points into the mesh, not along it
inline constexpr float kLongWay = 2.0f;
inline constexpr float kAsDeep = 1.2f;
inline constexpr float kSmallestWay = 1e-30f;      // m: not 0
inline constexpr float kGroupCosine = 0.9961947f;  // 5 deg
inline constexpr int32_t kGroupPoints = 9;
inline constexpr int32_t kMeshContacts = 32;  // of a pair
inline constexpr float kSamePoint = 1e-4f;    // of the extent of a group's points
inline constexpr Vec3f kSteadyDirection = {0.83f, 0.47f, 0.31f};  // along nothing that is common

struct MeshContact {
  ContactPoint point{};
  Vec3f normal{};  // from the mesh to B
  int32_t triangle = 0;
  float way_out = 0.0f;  // m: collide_triangle
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

// True if the mesh lies below the plane across n through each corner of the triangle that is
// farthest along n, as far as the neighbours of the corner tell.
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

// The contacts of B with one triangle, before reduction. `way_out` (m) is 0, or, for contacts that
// count only where there are no others, the distance along the triangle's normal, < 0.
NOVAPHY_OUT_OF_LINE ContactCandidates collide_triangle(const MeshView& mesh, int32_t triangle,
                                                       const Shape& b, const Transformf& b_in_mesh,
                                                       float gap, float& way_out) {
  ContactCandidates found;
  way_out = 0.0f;
  if (mesh.normals[triangle] == Vec3f{}) return found;
  TriangleHull t;
  make_triangle(t, mesh, triangle);
  Shape a;
  a.type = GeoType::CONVEX_MESH;
  a.hull = view_of(t);
  const ShapePair pair = shape_pair(a, b, b_in_mesh);
  Proximity proximity = convex_proximity(pair, gap);
  if (!(proximity.distance <= gap)) return found;
  const float along = math::dot(proximity.normal, t.normals[0]);
  const bool stands = along >= kFaceCosine ||
                      (along >= -kBehindCosine && normal_stands(mesh, triangle, proximity.normal));
  Feature front, facing;
  if (stands && along < kFaceCosine) {
    facing_features(pair, proximity.normal, front, facing);
    return clip_candidates(pair, proximity, corners_along(t, proximity.normal), facing, gap);
  }
  if (!stands && proximity.distance > 0.0f) return found;
  const float shortest = proximity.distance;
  proximity = face_proximity(pair, t);
  if (!stands && (along < -kBehindCosine || proximity.distance < kLongWay * shortest))
    way_out = math::min(proximity.distance, -kSmallestWay);
  facing_features(pair, proximity.normal, front, facing);
  found.normal = proximity.normal;
  const bool as_deep = clip_features(pair, proximity, front, facing, true, gap, found);
  // The deepest point of a round or turned shape is no corner of its feature.
  Feature deepest;
  add_point(deepest, proximity.on_b);
  if (!as_deep && proximity.distance <= gap && clip_to_face(front, deepest).count == 1)
    add_contact(found, (proximity.on_a + proximity.on_b) * 0.5f, proximity.distance,
                contact_feature(front.face, facing.face, kWitnessCode));
  return found;
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

// All contacts within the gap, before reduction; the number found, of which the first `capacity`
// are written.
inline int32_t collide_mesh(const MeshView& mesh, const Shape& b, const Transformf& b_in_mesh,
                            float gap, MeshContact* out, int32_t capacity) {
  int32_t count = 0;
  Shape none;
  const ShapePair pair = shape_pair(none, b, b_in_mesh);
  for_triangles_in(mesh, box_in_mesh(pair, gap), [&](int32_t triangle) {
    float way_out = 0.0f;
    const ContactCandidates found = collide_triangle(mesh, triangle, b, b_in_mesh, gap, way_out);
    for (int32_t i = 0; i < found.count; ++i, ++count)
      if (count < capacity) out[count] = {found.points[i], found.normal, triangle, way_out};
  });
  return count;
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

// Drops contacts with a way out where they do not count: where the pair has others, all but those
// that one of these confirms, a contact with the same normal that is about as deep (a corner that
// has just passed an inner edge); else all that do not lie along the shortest way. The number that
// stays, in order.
inline int32_t keep_ways_out(MeshContact* c, int32_t count) {
  bool touches = false;
  int32_t shortest = -1;
  for (int32_t i = 0; i < count; ++i) {
    if (c[i].way_out == 0.0f)
      touches = touches || c[i].point.distance <= 0.0f;
    else if (shortest < 0 || c[i].way_out > c[shortest].way_out)
      shortest = i;
  }
  if (shortest < 0) return count;
  const auto counts = [&](const MeshContact& contact) {
    if (!touches) return math::dot(contact.normal, c[shortest].normal) >= kGroupCosine;
    for (int32_t i = 0; i < count; ++i)
      if (c[i].way_out == 0.0f && math::dot(contact.normal, c[i].normal) >= kGroupCosine &&
          contact.point.distance >= kAsDeep * c[i].point.distance)
        return true;
    return false;
  };
  for (int32_t i = 0; i < count; ++i) c[i].kept = c[i].way_out == 0.0f || counts(c[i]);
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
inline int32_t reduce_mesh_contacts(MeshContact* c, int32_t count, int32_t limit = kMeshContacts) {
  sort_mesh_contacts(c, count);
  count = keep_ways_out(c, count);
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
