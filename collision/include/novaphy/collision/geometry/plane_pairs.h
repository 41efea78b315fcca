// Contacts of an infinite plane (A) with the other primitives (B), in closed form.
//
// The pose of a plane gives its normal n (local +z) and its origin p. Distances are those of points
// of B to the plane, and are exact for every listed point. The position of a contact is the point x
// of B moved back by half its distance d: x - (n/2) d. GeoType describes the sizes. Source: plane
// with sphere, capsule and box: Newton 1.8.0, with the same bits on the CPU.
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

inline Manifold plane_sphere(const Plane& plane, const Transformf& sphere, float radius) {
  Manifold manifold = plane_manifold(plane);
  add_plane_sphere(manifold, plane, sphere.p, radius, 0);
  return manifold;
}

// Adds both ends of the capsule. The end at +z has feature 0 and comes first.
inline Manifold plane_capsule(const Plane& plane, const Transformf& capsule, float radius,
                              float half_height) {
  const Vec3f half = math::rotate(capsule.q, Vec3f{0.0f, 0.0f, 1.0f}) * half_height;
  Manifold manifold = plane_manifold(plane);
  add_plane_sphere(manifold, plane, capsule.p + half, radius, 0);
  add_plane_sphere(manifold, plane, capsule.p - half, radius, 1);
  return manifold;
}

// Returns the four deepest corners within `reach` (m), each in the slot where it was found. A
// corner that is deeper than the least deep of four replaces it. If both are equally deep, the
// earlier corner stays. The feature is the index of the corner: bit k is set for the + side of axis
// k.
inline Manifold plane_box(const Plane& plane, const Transformf& box, const Vec3f& half,
                          float reach) {
  const Vec3f& n = plane.normal;
  const float center = math::dot(box.p - plane.point, n);
  Manifold manifold = plane_manifold(plane);
  if (center - 1.001f * math::length(half) > reach) return manifold;  // no corner is within reach
  const Vec3f ex = math::rotate(box.q, Vec3f{1.0f, 0.0f, 0.0f});
  const Vec3f ey = math::rotate(box.q, Vec3f{0.0f, 1.0f, 0.0f});
  const Vec3f ez = math::rotate(box.q, Vec3f{0.0f, 0.0f, 1.0f});
  int highest = 0;
  for (int32_t k = 0; k < 8; ++k) {
    const Vec3f sign = {(k & 1) != 0 ? half.x : -half.x, (k & 2) != 0 ? half.y : -half.y,
                        (k & 4) != 0 ? half.z : -half.z};
    const Vec3f corner = (ex * sign.x + ey * sign.y) + ez * sign.z;
    const float d = center + math::dot(n, corner);
    if (d > reach) continue;
    const ContactPoint point = {(corner + box.p) - (n * 0.5f) * d, d, k};
    if (manifold.count < 4) {
      const int slot = manifold.count++;
      manifold.points[slot] = point;
      if (slot == 0 || d > manifold.points[highest].distance) highest = slot;
    } else if (d < manifold.points[highest].distance) {
      manifold.points[highest] = point;
      highest = 0;
      for (int slot = 1; slot < 4; ++slot)
        if (manifold.points[slot].distance > manifold.points[highest].distance) highest = slot;
    }
  }
  return manifold;
}

// Returns the deepest point of a disc's rim, relative to the center of the disc. The unit vectors u
// and v span the disc. If the disc is parallel to the plane, the result is along u.
inline Vec3f deepest_of_rim(const Vec3f& n, const Vec3f& u, const Vec3f& v, float radius) {
  const float x = -math::dot(n, u), y = -math::dot(n, v);
  const float length = math::sqrt(x * x + y * y);
  if (!(length > 1e-6f)) return u * radius;
  return u * (x / length * radius) + v * (y / length * radius);
}

inline constexpr float kFlatCap = 0.92387953f;     // cosine of 22.5 degrees
inline constexpr float kRestingCap = 0.99862953f;  // of 3 degrees

// Adds the contacts of a disc with the unit axis `axis`. Feature 0 is its deepest point. If the
// disc is within 22.5 degrees of the plane, three rim points follow, 120 degrees apart, starting at
// u (features 1 to 3). These points rotate with the body. A steeper disc rolls on its rim, and
// therefore has only the deepest point. Rim points near the deepest point are left out: within 1 %
// of the radius, or within 60 degrees for a disc tilted by more than 3 degrees.
inline void add_plane_disc(Manifold& manifold, const Plane& plane, const Vec3f& center,
                           const Vec3f& u, const Vec3f& v, const Vec3f& axis, float radius) {
  const Vec3f deepest = deepest_of_rim(plane.normal, u, v, radius);
  add_plane_point(manifold, plane, center + deepest, 0);
  const float flatness = math::abs(math::dot(plane.normal, axis));
  if (!(flatness > kFlatCap)) return;
  const float apart = (flatness > kRestingCap ? 0.01f : 1.0f) * radius;
  constexpr float kSine = 0.8660254f;  // sine of 120 degrees
  const Vec3f rim[3] = {u * radius, (u * -0.5f + v * kSine) * radius,
                        (u * -0.5f - v * kSine) * radius};
  for (int32_t k = 0; k < 3; ++k) {
    if (math::length(rim[k] - deepest) > apart)
      add_plane_point(manifold, plane, center + rim[k], k + 1);
  }
}

// Adds the lower cap, and the deepest point of the other cap (feature 4). This point is the second
// end of the generator on which the cylinder rolls.
inline Manifold plane_cylinder(const Plane& plane, const Transformf& cylinder, float radius,
                               float half_height) {
  const Vec3f u = math::rotate(cylinder.q, Vec3f{1.0f, 0.0f, 0.0f});
  const Vec3f v = math::rotate(cylinder.q, Vec3f{0.0f, 1.0f, 0.0f});
  const Vec3f axis = math::rotate(cylinder.q, Vec3f{0.0f, 0.0f, 1.0f});
  const bool top_is_lower = math::dot(plane.normal, axis) < 0.0f;
  const Vec3f lower = axis * (top_is_lower ? half_height : -half_height);
  Manifold manifold = plane_manifold(plane);
  add_plane_disc(manifold, plane, cylinder.p + lower, u, v, axis, radius);
  add_plane_point(manifold, plane,
                  (cylinder.p - lower) + deepest_of_rim(plane.normal, u, v, radius), 4);
  return manifold;
}

// Adds the base (features 0 to 3) and the apex (4).
inline Manifold plane_cone(const Plane& plane, const Transformf& cone, float radius,
                           float half_height) {
  const Vec3f u = math::rotate(cone.q, Vec3f{1.0f, 0.0f, 0.0f});
  const Vec3f v = math::rotate(cone.q, Vec3f{0.0f, 1.0f, 0.0f});
  const Vec3f axis = math::rotate(cone.q, Vec3f{0.0f, 0.0f, 1.0f}), half = axis * half_height;
  Manifold manifold = plane_manifold(plane);
  add_plane_disc(manifold, plane, cone.p - half, u, v, axis, radius);
  add_plane_point(manifold, plane, cone.p + half, 4);
  return manifold;
}

// Returns the contact of the deepest point.
inline Manifold plane_ellipsoid(const Plane& plane, const Transformf& ellipsoid,
                                const Vec3f& half_axes) {
  const Vec3f n = math::rotate_inverse(ellipsoid.q, plane.normal);
  const Vec3f scaled = {half_axes.x * n.x, half_axes.y * n.y, half_axes.z * n.z};
  const Vec3f towards = math::normalize(scaled);
  const Vec3f deepest = {-half_axes.x * towards.x, -half_axes.y * towards.y,
                         -half_axes.z * towards.z};
  Manifold manifold = plane_manifold(plane);
  add_plane_point(manifold, plane, math::transform_point(ellipsoid, deepest), 0);
  return manifold;
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
