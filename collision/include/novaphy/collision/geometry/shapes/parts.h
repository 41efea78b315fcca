// The common parts of the solids: points, features, and contacts with a plane.
#pragma once

#include "novaphy/collision/geometry/plane_pairs.h"
#include "novaphy/collision/geometry/shape.h"
#include "novaphy/collision/surface_distance_trace.h"

namespace novaphy::geometry {

struct SolidPoint {
  float distance{};  // distance of x, < 0 inside
  Vec3f normal{};    // unit, outward
};

inline SolidPoint point_to_center(const Vec3f& x) {
  const float l = math::length(x);
  if (!(l > 0.0f)) return {0.0f, {-1.0f, 0.0f, 0.0f}};
  return {l, x / l};
}

inline constexpr int32_t kFeatureCapacity = 16;
inline constexpr float kCapCosine = 0.92388f;  // cos 22.5 deg: nearer directions select the cap

// A face is a convex polygon, counter-clockwise seen from outside. `face` is its number in the
// shape; 0 if the shape has no faces. The numbers of caps are 0 (lower) and 1.
struct Feature {
  Vec3f points[kFeatureCapacity];
  Vec3f normal{};     // only for a face
  int32_t count = 0;  // 1: a point, 2: an edge, else a face
  int32_t face = 0;
};

inline void add_point(Feature& feature, const Vec3f& point) {
  feature.points[feature.count++] = point;
}

inline Feature point_feature(const Vec3f& point) {
  Feature feature;
  add_point(feature, point);
  return feature;
}

// Returns a cap at height z: a polygon with 8 points of the rim. The points are fixed in the frame
// of the shape, so that the manifold of a resting shape does not rotate by rounding.
inline Feature cap_feature(float radius, float z, bool top) {
  const float r = radius, k = 0.70710678f * radius;
  const float x[8] = {r, k, 0.0f, -k, -r, -k, 0.0f, k};
  Feature feature;
  feature.normal = {0.0f, 0.0f, top ? 1.0f : -1.0f};
  feature.face = top ? 1 : 0;
  for (int32_t i = 0; i < 8; ++i) {
    const int32_t j = top ? i : 7 - i;
    add_point(feature, {x[j], x[(j + 6) % 8], z});  // sin t = cos(t - 90 deg)
  }
  return feature;
}

// Returns the horizontal part of d, scaled to `length`. The result is zero if d is along the axis.
inline Vec3f radial(const Vec3f& d, float length) {
  const float rho = math::sqrt(d.x * d.x + d.y * d.y);
  if (!(rho > 0.0f)) return {};
  return {d.x * (length / rho), d.y * (length / rho), 0.0f};
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

}  // namespace novaphy::geometry
