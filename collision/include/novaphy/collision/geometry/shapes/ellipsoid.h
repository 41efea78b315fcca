// The ellipsoid with half axes along x, y and z.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Ellipsoid {
  Vec3f axes;
  explicit Ellipsoid(const Vec3f& scale) : axes(scale) {}

  float extent(const Vec3f& axis) const {
    return (axes.x * axis.x + axes.y * axis.y) + axes.z * axis.z;
  }
  Vec3f support(const Vec3f& d) const {
    const Vec3f s = {axes.x * d.x, axes.y * d.y, axes.z * d.z};
    const float l = math::length(s);
    if (!(l > 0.0f)) return {axes.x, 0.0f, 0.0f};
    return {axes.x * (s.x / l), axes.y * (s.y / l), axes.z * (s.z / l)};
  }
  // The feature is the farthest point.
  Feature feature(const Vec3f& d) const { return point_feature(support(d)); }
  SolidPoint core_distance(const Vec3f& x) const {
    const SurfaceDistance<float> p = distance(x);
    return {p.distance, p.normal};
  }
  SurfaceDistance<float> distance(const Vec3f& x) const { return ellipsoid_distance(x, axes); }
  // Returns the contact of the deepest point.
  Manifold on_plane(const Plane& plane, const Transformf& pose, float) const {
    const Vec3f n = math::rotate_inverse(pose.q, plane.normal);
    const Vec3f scaled = {axes.x * n.x, axes.y * n.y, axes.z * n.z};
    const Vec3f towards = math::normalize(scaled);
    const Vec3f deepest = {-axes.x * towards.x, -axes.y * towards.y, -axes.z * towards.z};
    Manifold manifold = plane_manifold(plane);
    add_plane_point(manifold, plane, math::transform_point(pose, deepest), 0);
    return manifold;
  }
};

}  // namespace novaphy::geometry
