// A cheap test of a mesh triangle and a convex shape B before GJK. The test detects pairs that have
// no contact, and pairs in which B faces the triangle.
//
// The core of B must be a box about its own origin: a box, the segment of a capsule, or the center
// of a sphere. Let w be the vector from a point of the triangle to the nearest point of the core.
// In the frame of B, each coordinate of w is a monotone function of the same coordinate of the
// triangle's point. The vectors w of the corners therefore bound w over the triangle. The
// normal of the pair is w / |w| for one point.
//
// The function collide_triangle (mesh_triangle.h) adds no contact if the shapes are farther apart
// than the gap. For separate shapes it also adds no contact if the normal is neither that of the
// face nor valid for the surface (normal_stands). No normal is valid if, for every w, the mesh
// rises above the plane perpendicular to w. The test checks the corners and edges that may be the
// farthest along w. Tolerances cover the rounding of GJK, which decides doubtful cases. Frame of B,
// m.
#pragma once

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::geometry {

inline constexpr float kForeseenEdge = 4.0f;    // of the gap: longest edge for the test
inline constexpr float kSurelyRises = 0.008f;   // sine: kLeanSine plus the error of a normal
inline constexpr float kSurelyTilted = 0.056f;  // sine: above that of kFaceCosine, 0.0523
inline constexpr float kSurelyFacing = 0.048f;  // sine: below that of kFaceCosine
inline constexpr float kSurelyApart = 1e-3f;    // of the sizes

// Computes the half extents of the core box. Returns false if the core of B is not a box.
inline bool core_box(const Shape& b, Vec3f& half) {
  half = {};
  if (b.type == GeoType::BOX) half = b.scale;
  if (b.type == GeoType::CAPSULE) half.z = b.scale.y;
  return b.type == GeoType::BOX || b.type == GeoType::CAPSULE || b.type == GeoType::SPHERE;
}

// Bounds of the vector w and of its length over a triangle (m).
struct Ways {
  Vec3f lo{}, hi{};
  float least = 0.0f, most = 0.0f;
};
inline float way_along(float x, float half) {
  return x > half ? half - x : x < -half ? -half - x : 0.0f;
}
inline void take_axis(const Vec3f* corners, int32_t axis, float half, float& lo, float& hi,
                      float& least, float& most) {
  const float w0 = way_along(component(corners[0], axis), half),
              w1 = way_along(component(corners[1], axis), half),
              w2 = way_along(component(corners[2], axis), half);
  lo = math::min(w0, math::min(w1, w2));
  hi = math::max(w0, math::max(w1, w2));
  const float near = lo > 0.0f ? lo : hi < 0.0f ? hi : 0.0f, far = math::max(-lo, hi);
  least += near * near;
  most += far * far;
}
inline Ways ways_from(const Vec3f* corners, const Vec3f& half) {
  Ways w;
  take_axis(corners, 0, half.x, w.lo.x, w.hi.x, w.least, w.most);
  take_axis(corners, 1, half.y, w.lo.y, w.hi.y, w.least, w.most);
  take_axis(corners, 2, half.z, w.lo.z, w.hi.z, w.least, w.most);
  w.least = math::sqrt(w.least);
  w.most = math::sqrt(w.most);
  return w;
}
// Returns the smallest possible dot product of w and d.
inline float least_along(const Ways& w, const Vec3f& d) {
  return (d.x * (d.x > 0.0f ? w.lo.x : w.hi.x) + d.y * (d.y > 0.0f ? w.lo.y : w.hi.y)) +
         d.z * (d.z > 0.0f ? w.lo.z : w.hi.z);
}
// Returns whether a point at the offset d (of the given length) lies above the plane perpendicular
// to w, for every w.
inline bool rises(const Ways& w, const Vec3f& d, float length) {
  return least_along(w, d) > kSurelyRises * length * w.most;
}

// Returns whether the mesh rises at every corner, and over every edge, that may be the farthest
// along some w. `corners` are the triangle's corners in the frame of B.
inline bool rises_beyond(const MeshView& mesh, int32_t triangle, const ShapePair& pair,
                         const Vec3f* corners, const Ways& w) {
  const Vec3i t = mesh.triangles[triangle], all = mesh.across[triangle];
  const int32_t vertices[3] = {t.x, t.y, t.z}, across[3] = {all.y, all.z, all.x};
  const auto in_b = [&](int32_t vertex) {
    return apply_transposed(pair.rotation, mesh.vertices[vertex] - pair.offset);
  };
  const float size = math::max(
      math::length(corners[1] - corners[0]),
      math::max(math::length(corners[2] - corners[1]), math::length(corners[0] - corners[2])));
  const auto below = [&](int32_t k, int32_t other) {
    return rises(w, corners[other] - corners[k], size);
  };
  for (int32_t k = 0; k < 3; ++k) {
    const int32_t i = (k + 1) % 3, j = (k + 2) % 3;
    // The edge from i to j, with the opposite vertex across[k].
    if (!below(i, k) && !below(j, k) && !below(i, j) && !below(j, i)) {
      if (across[k] == kMeshBorder) return false;
      if (across[k] >= 0) {
        const Vec3f edge = corners[j] - corners[i], d = in_b(across[k]) - corners[i];
        const Vec3f up = d - edge * (math::dot(d, edge) / math::dot(edge, edge));
        if (!rises(w, up, math::length(up))) return false;
      }
    }
    bool found = below(k, i) || below(k, j);
    const int32_t end = mesh.ring_starts[vertices[k] + 1];
    for (int32_t r = mesh.ring_starts[vertices[k]]; !found && r < end; ++r) {
      const Vec3f d = in_b(mesh.ring[r]) - corners[k];
      found = rises(w, d, math::length(d));
    }
    if (!found) return false;
  }
  return true;
}

struct Foreseen {
  bool no_contact = false;  // collide_triangle would add no contact
  // A lower bound of the distance (m) that GJK would find. Above 0: the distance is within the gap,
  // and GJK's normal is that of the triangle. 0: unknown.
  float facing = 0.0f;
};
// Returns what the test detects. `half` is the result of core_box.
NOVAPHY_OUT_OF_LINE Foreseen foresee(const MeshView& mesh, int32_t triangle, const ShapePair& pair,
                                     const Vec3f& half, float gap) {
  Foreseen known;
  const Vec3i t = mesh.triangles[triangle];
  const Vec3f corners[3] = {apply_transposed(pair.rotation, mesh.vertices[t.x] - pair.offset),
                            apply_transposed(pair.rotation, mesh.vertices[t.y] - pair.offset),
                            apply_transposed(pair.rotation, mesh.vertices[t.z] - pair.offset)};
  const Ways w = ways_from(corners, half);
  const float radius = core_radius(*pair.b), apart = w.least - radius;
  const float rounding =
      kSurelyApart * ((w.most + math::length(half)) + 0.1f * math::length(pair.offset));
  if (!(apart > rounding)) return known;
  known.no_contact = apart > gap + rounding;
  if (known.no_contact) return known;
  const Vec3f normal = apply_transposed(pair.rotation, mesh.normals[triangle]);
  const Vec3f middle = w.lo + w.hi, across = middle - normal * math::dot(middle, normal);
  if (least_along(w, across) > kSurelyTilted * w.most * math::length(across)) {
    known.no_contact = rises_beyond(mesh, triangle, pair, corners, w);
    return known;
  }
  const Vec3f u = any_orthogonal(normal), v = math::cross(normal, u);
  const auto most_off = [&](const Vec3f& d) {
    return math::max(-least_along(w, d), -least_along(w, -d));
  };
  const float x = most_off(u), y = most_off(v), most = kSurelyFacing * w.least;
  if (x * x + y * y < most * most && least_along(w, normal) > 0.0f &&
      w.most - radius < gap - rounding)
    known.facing = apart;
  return known;
}

}  // namespace novaphy::geometry
