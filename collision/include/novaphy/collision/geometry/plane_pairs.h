// Contacts of an infinite plane (A) with the other primitives (B), in closed form.
//
// The pose of a plane gives its normal n (local +z) and its origin p. Distances are those of points
// of B to the plane, and are exact for every listed point. The position of a contact is the point x
// of B moved back by half its distance d: x - (n/2) d. Each solid of shapes/ adds its points in
// on_plane(). Source: plane with sphere, capsule and box: Newton 1.8.0, with the same bits on the
// CPU.
//
// Freestanding (no standard headers), because device code includes this header.
#pragma once

#include "novaphy/collision/geometry/manifold.h"

namespace novaphy::geometry {

struct Plane {
  Vec3f point, normal;
};
inline Plane plane_of(const Transformf& pose) {
  return {pose.p, math::rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f})};
}

inline Manifold plane_manifold(const Plane& plane) {
  Manifold manifold;
  manifold.normal = plane.normal;
  return manifold;
}

// Adds the contact of the plane and a point x of B.
inline void add_plane_point(Manifold& manifold, const Plane& plane, const Vec3f& x,
                            int32_t feature) {
  const Vec3f& n = plane.normal;
  const float d = math::dot(n, x - plane.point);
  add_contact(manifold, x - (n * 0.5f) * d, d, feature);
}

// Adds the contact of the plane and a sphere that is a part of B.
inline void add_plane_sphere(Manifold& manifold, const Plane& plane, const Vec3f& center,
                             float radius, int32_t feature) {
  const Vec3f& n = plane.normal;
  const float d = math::dot(center - plane.point, n) - radius;
  add_contact(manifold, center - n * (radius + 0.5f * d), d, feature);
}

inline constexpr float kPlaneBand = 0.05f;       // of the size: band below the deepest vertex
inline constexpr float kEquallyDeep = 1e-5f;     // of the size: then the first vertex counts
inline constexpr float kSamePlanePoint = 1e-4f;  // of the size

// Returns up to four vertices of a hull or mesh that are nearly as deep as the deepest vertex, by
// the rule of reduce_contacts. Distances and areas are compared in the frame of the shape, so that
// a resting shape keeps its vertices. `size` (m) is the size of the shape. The feature is the index
// of the vertex.
inline Manifold plane_vertices(const Plane& plane, const Transformf& pose, const Vec3f* vertices,
                               int32_t count, float size, float reach) {
  const Vec3f n = math::rotate_inverse(pose.q, plane.normal);
  const float origin = math::dot(plane.normal, pose.p - plane.point);
  Manifold manifold = plane_manifold(plane);
  struct Vertices {
    const Vec3f* vertices;
    Vec3f n;
    int32_t count;
    float lowest, tolerance, limit;
    int32_t chosen[4], chosen_count;
    int32_t size() const { return count; }
    float height(int32_t i) const { return math::dot(n, vertices[i]); }
    ContactPoint point(int32_t i) const {
      const float above = height(i) - lowest;
      return {vertices[i], above <= tolerance ? 0.0f : above, i};
    }
    bool open(int32_t i) const {
      for (int32_t k = 0; k < chosen_count; ++k)
        if (chosen[k] == i) return false;
      return height(i) <= limit;
    }
    void take(int32_t i) { chosen[chosen_count++] = i; }
  } set{vertices, n, count, math::dot(n, vertices[0]), kEquallyDeep * size, 0.0f, {}, 0};
  for (int32_t i = 1; i < count; ++i) set.lowest = math::min(set.lowest, set.height(i));
  if (!(origin + set.lowest <= reach)) return manifold;
  set.limit = math::min(reach - origin, set.lowest + kPlaneBand * size);
  take_extremes(set, n, 4, kSamePlanePoint * size);
  for (int32_t k = 0; k < set.chosen_count; ++k)
    add_plane_point(manifold, plane, math::transform_point(pose, vertices[set.chosen[k]]),
                    set.chosen[k]);
  sort_contacts(manifold);
  return manifold;
}

}  // namespace novaphy::geometry
