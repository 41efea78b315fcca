// The signed distance of a point to a convex hull or a triangle mesh, with the outward normal of
// the surface at the nearest point. The nearest point is x - normal * distance. Frame of the shape,
// m.
//
// For a mesh the sign follows from the angle-weighted normal of all triangles that meet in the
// nearest point, which is correct for closed meshes. Points beside a border are outside. Source: J.
// A. Baerentzen, H. Aanaes, Signed Distance Computation Using the Angle Weighted Pseudonormal
// (2005).
#pragma once

#include "novaphy/collision/geometry/geometry_view.h"
#include "novaphy/collision/geometry/segment.h"
#include "novaphy/collision/geometry/sphere_pairs.h"

namespace novaphy::geometry {

inline constexpr float kFarAway = 1e30f;     // m, represents a distance beyond the search range
inline constexpr float kSameCorner = 1e-4f;  // of the triangle: nearer points count as one point
inline constexpr float kOnSurface = 1e-6f;   // of the triangle: nearer points define no direction

inline SolidPoint point_to_hull(const Vec3f& x, const HullView& hull) {
  SolidPoint deepest{-kFarAway, {}}, nearest{kFarAway, {}};
  for (int32_t f = 0; f < hull.face_count; ++f) {
    const Vec3f n = hull.face_normals[f];
    const int32_t begin = hull.face_starts[f], end = hull.face_starts[f + 1];
    const float above = math::dot(n, x - hull.vertices[hull.face_vertices[begin]]);
    if (above > deepest.distance) deepest = {above, n};
    if (!(above > 0.0f)) continue;
    // The nearest point of a face is the projection of x if x is over the face, else a point of an
    // edge.
    bool over = true;
    for (int32_t k = begin; k < end; ++k) {
      const Vec3f a = hull.vertices[hull.face_vertices[k]];
      const Vec3f edge = hull.vertices[hull.face_vertices[k + 1 == end ? begin : k + 1]] - a;
      if (!(math::dot(math::cross(edge, x - a), n) < 0.0f)) continue;
      over = false;
      const Vec3f d = x - (a + edge * nearest_parameter(x, a, edge));
      const float length = math::length(d);
      if (length < nearest.distance && length > 0.0f) nearest = {length, d * (1.0f / length)};
    }
    if (over && above < nearest.distance) nearest = {above, n};
  }
  return nearest.distance < kFarAway ? nearest : deepest;
}

// The point of a triangle nearest to x, and the angle (rad) that the triangle fills around this
// point: 2 pi inside, pi on an edge. `corner`: index of the corner if the point is a corner, else
// -1.
struct TrianglePoint {
  Vec3f point{};
  float angle = 0.0f;
  int32_t corner = -1;
};
inline float angle_between(const Vec3f& u, const Vec3f& v) {
  const float c = math::dot(u, v) / (math::length(u) * math::length(v));
  // An approximation of acos with an error of 1 %, which is sufficient for weights.
  const float a = math::sqrt(math::max(2.0f - 2.0f * math::abs(c), 0.0f));
  const float angle = a * (1.0f + a * a / 24.0f);
  return c < 0.0f ? 3.1415927f - angle : angle;
}
inline TrianglePoint nearest_of_triangle(const Vec3f (&v)[3], const Vec3f& n, const Vec3f& x) {
  constexpr float kPi = 3.1415927f;
  TrianglePoint nearest;
  float least = kFarAway;
  bool over = true;
  for (int32_t k = 0; k < 3; ++k) {
    const Vec3f edge = v[(k + 1) % 3] - v[k];
    if (!(math::dot(math::cross(edge, x - v[k]), n) < 0.0f)) continue;
    over = false;
    const float s = nearest_parameter(x, v[k], edge);
    const Vec3f point = v[k] + edge * s, d = x - point;
    const float square = math::dot(d, d);
    if (!(square < least)) continue;
    least = square;
    nearest = {point, kPi, s <= 0.0f ? k : s >= 1.0f ? (k + 1) % 3 : -1};
  }
  if (over) return {x - n * math::dot(n, x - v[0]), 2.0f * kPi, -1};
  if (nearest.corner >= 0) {
    const int32_t k = nearest.corner;
    nearest.angle = angle_between(v[(k + 1) % 3] - v[k], v[(k + 2) % 3] - v[k]);
  }
  return nearest;
}

inline float square_outside(const Box3& box, const Vec3f& x) {
  const Vec3f d = {math::max(math::max(box.lo.x - x.x, x.x - box.hi.x), 0.0f),
                   math::max(math::max(box.lo.y - x.y, x.y - box.hi.y), 0.0f),
                   math::max(math::max(box.lo.z - x.z, x.z - box.hi.z), 0.0f)};
  return math::dot(d, d);
}

// Returns the signed distance and normal. Returns kFarAway for a point that is farther than `reach`
// (m) outside of the mesh's box. For a mesh with a border, this box includes the region behind the
// mesh, up to the size of the mesh. `within` (m): a known upper bound of the distance to the
// surface, which saves time.
inline SolidPoint point_to_mesh(const Vec3f& x, const MeshView& mesh, float reach,
                                float within = kFarAway) {
  SolidPoint far{kFarAway, {0.0f, 0.0f, 1.0f}};
  // This form of the comparison treats a NaN as far.
  if (!(square_outside(mesh.behind, x) <= reach * reach)) return far;
  float least = kFarAway, tolerance = 0.0f;
  Vec3f nearest{}, normal{};
  int32_t meeting = 0, needed = 1;
  for (int32_t i = 0; i < mesh.node_count;) {
    const MeshNode& node = mesh.nodes[i];
    const float bound = math::min(least + tolerance, within);
    if (square_outside(node.box, x) > bound * bound) {
      i = node.skip;
      continue;
    }
    for (int32_t k = node.first; k < node.first + node.count; ++k) {
      const int32_t t = mesh.order[k];
      const Vec3f n = mesh.normals[t];
      if (n == Vec3f{}) continue;
      const Vec3i corners = mesh.triangles[t];
      const Vec3f v[3] = {mesh.vertices[corners.x], mesh.vertices[corners.y],
                          mesh.vertices[corners.z]};
      const TrianglePoint p = nearest_of_triangle(v, n, x);
      const float distance = math::length(x - p.point);
      const float size = math::length(v[1] - v[0]);
      if (meeting > 0 && math::length(p.point - nearest) <= tolerance) {
        normal = normal + n * p.angle;
        ++meeting;
        least = math::min(least, distance);
        continue;
      }
      if (!(distance < least)) continue;
      const int32_t corner = p.corner == 0 ? corners.x : p.corner == 1 ? corners.y : corners.z;
      least = distance;
      nearest = p.point;
      normal = n * p.angle;
      tolerance = kSameCorner * size;
      meeting = 1;
      needed = p.angle > 4.0f ? 1
               : p.corner < 0 ? 2
                              : mesh.ring_starts[corner + 1] - mesh.ring_starts[corner];
    }
    ++i;
  }
  if (meeting == 0) return far;
  const Vec3f d = x - nearest;
  const bool inside = meeting >= needed && math::dot(d, normal) < 0.0f;
  if (!(least > kOnSurface / kSameCorner * tolerance))
    return {inside ? -least : least, math::normalize(normal)};
  return {inside ? -least : least, d * ((inside ? -1.0f : 1.0f) / least)};
}

}  // namespace novaphy::geometry
