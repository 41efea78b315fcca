// The contacts of a triangle of a mesh (A) with a convex shape (B), as two convex shapes. Each
// contact has a normal n and a rank (MeshRank):
//
// - Counts: the normal is valid. Around the part of the triangle that is farthest along n, the mesh
//   stays below the plane perpendicular to n (normal_stands), so this part is on the surface. A
//   normal within 3 degrees of the triangle's normal is also valid. The triangle's normal then
//   replaces n, and the separation along it is used for the part of B over the triangle.
// - Seam: n is valid and within 3 degrees of the triangle's normal, but B's deepest point lies over
//   another triangle. The edge between both triangles is convex, with an angle below 6 degrees.
// - WayOut: B overlaps the triangle, and n is not valid, because B is deep, or the edge is flat or
//   concave. The part of B over the triangle has the triangle's normal.
// - Beside: B's deepest point, if B overlaps the triangle, but no part of B over the triangle
//   touches.
//
// A contact of another rank than Counts stays only if no better contact moves B off the triangle
// (drop_explained). A shape therefore slides over flat and concave edges as over one face, and a
// contact in one place does not remove contacts elsewhere. A shape that is completely behind a
// triangle does not touch this triangle. A shape deep inside of a mesh therefore has no contacts.
// Frame of the mesh, m.
#pragma once

#include "novaphy/collision/geometry/convex_pair.h"
#include "novaphy/collision/geometry/mesh_foreseen.h"

namespace novaphy::geometry {

inline constexpr float kLeanSine = 1e-3f;     // tolerance of a normal that leans over an edge
inline constexpr float kBehindCosine = 0.1f;  // limit for a normal that points into the mesh
inline constexpr int32_t kBesideFace = 2;     // feature of a contact beside the face
inline constexpr float kAsDeep = 1.2f;
inline constexpr float kSurelyDeep = 1.19f;  // of the distance from Foreseen

enum class MeshRank : int32_t { Counts, Seam, WayOut, Beside };

struct MeshContact {
  ContactPoint point{};
  Vec3f normal{};  // from the mesh to B
  int32_t triangle = 0;
  MeshRank rank = MeshRank::Counts;
  float way_out = 0.0f;  // m, separation of B and the triangle along the normal
  Vec3f shortest{};      // m, shortest translation of B off this triangle
  float clears = 0.0f;   // m, position of B along the normal after that translation
  int32_t group = -1;    // used by reduce_mesh_contacts
  bool kept = false;
};

// The triangle as a polytope with two faces, 0 in front and 1 behind.
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

// Returns the face, edge or corner of the triangle that is farthest along n. This feature touches a
// shape in that direction.
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

// Returns whether the mesh lies below a plane perpendicular to n. The plane passes through the
// face, edge or corner of the triangle that is farthest along n. For an edge the test checks the
// neighboring triangle, and for a corner the neighbors of the corner.
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

// Returns the proximity along the triangle's normal.
inline Proximity face_proximity(const ShapePair& pair, const TriangleHull& t) {
  const Vec3f n = t.normals[0];
  const SupportPoint p = support_point(pair, n);
  const float r = core_radius(*pair.b), distance = math::dot(p.b - t.vertices[0], n) - r;
  const Vec3f on_b = p.b - n * r;
  return {n, distance, on_b - n * distance, on_b};
}

// Returns the contacts of B over the face of the triangle. `over` is the proximity of B and the
// triangle's plane. `front` and `facing` receive the features of the triangle and of B. If no
// corner of B's feature is as deep as B's deepest point (a round or rotated shape), that point is
// added.
inline ContactCandidates over_face(const ShapePair& pair, const Proximity& over, float gap,
                                   Feature& front, Feature& facing) {
  facing_features(pair, over.normal, front, facing);
  ContactCandidates found;
  found.normal = over.normal;
  const bool as_deep = clip_features(pair, over, front, facing, true, gap, found);
  if (!as_deep && over.distance <= gap && is_over_face(front, over.on_b))
    add_contact(found, (over.on_a + over.on_b) * 0.5f, over.distance,
                contact_feature(front.face, facing.face, kWitnessCode));
  return found;
}
inline bool has_deeper(const ContactCandidates& found, float distance) {
  for (int32_t i = 0; i < found.count; ++i)
    if (found.points[i].distance <= distance) return true;
  return false;
}

// Makes a contact of a triangle from a point, the proximity `along` its normal, and its rank.
// `nearest` is the proximity along the shortest way out. The rank Counts does not use it.
inline MeshContact mesh_contact(int32_t triangle, const ContactPoint& point, const Proximity& along,
                                const Proximity& nearest, MeshRank rank) {
  MeshContact contact;
  contact.point = point;
  contact.normal = along.normal;
  contact.triangle = triangle;
  contact.rank = rank;
  contact.way_out = along.distance;
  contact.shortest = nearest.normal * -nearest.distance;
  contact.clears = math::dot(along.normal, along.on_b) + math::max(-point.distance, 0.0f);
  return contact;
}

// Calls add(contact) for the contacts of B with one triangle, before reduction. `foreseen` is
// Foreseen::facing. If it is above 0, most triangles need no GJK.
template <class Add>
NOVAPHY_OUT_OF_LINE void collide_triangle(const MeshView& mesh, int32_t triangle, const Shape& b,
                                          const Transformf& b_in_mesh, float gap, float foreseen,
                                          Add add) {
  if (mesh.normals[triangle] == Vec3f{}) return;
  TriangleHull t;
  make_triangle(t, mesh, triangle);
  Shape a;
  a.type = GeoType::CONVEX_MESH;
  a.hull = view_of(t);
  const ShapePair pair = shape_pair(a, b, b_in_mesh);
  if (foreseen > 0.0f) {
    const Proximity over = face_proximity(pair, t);
    Feature front, facing;
    const ContactCandidates found = over_face(pair, over, gap, front, facing);
    if (has_deeper(found, kSurelyDeep * foreseen)) {
      for (int32_t i = 0; i < found.count; ++i)
        add(mesh_contact(triangle, found.points[i], over, {}, MeshRank::Counts));
      return;
    }
  }
  const Proximity nearest = convex_proximity(pair, gap);
  if (!(nearest.distance <= gap)) return;
  const auto emit = [&](const ContactPoint& point, const Proximity& along, MeshRank rank) {
    add(mesh_contact(triangle, point, along, nearest, rank));
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
  const ContactCandidates found = over_face(pair, over, gap, front, facing);
  emit_all(found, over, faces ? MeshRank::Counts : MeshRank::WayOut);
  if (!stands) {
    if (nearest.distance > 0.0f || cosine < -kBehindCosine) return;
    if (has_deeper(found, 0.0f)) return;
    emit({(over.on_a + over.on_b) * 0.5f, over.distance,
          contact_feature(kBesideFace, facing.face, kWitnessCode)},
         over, MeshRank::Beside);
    return;
  }
  // B's deepest point may lie over a neighboring face that slopes away from this face.
  const float deep = nearest.distance + (kAsDeep - 1.0f) * math::abs(nearest.distance) +
                     kDeepestShare * extent(front);
  if (has_deeper(found, deep)) return;
  facing_features(pair, nearest.normal, front, facing);
  Feature seam = corners_along(t, nearest.normal);
  seam.face = kBesideFace;
  emit_all(clip_candidates(pair, nearest, seam, facing, gap), nearest, MeshRank::Seam);
}

}  // namespace novaphy::geometry
