// The sphere of a shape. Its core is the center.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Sphere {
  float radius;
  explicit Sphere(const Vec3f& scale) : radius(scale.x) {}

  float extent(const Vec3f&) const { return radius; }
  Vec3f support(const Vec3f&) const { return {}; }
  Feature feature(const Vec3f&) const { return point_feature({}); }
  SolidPoint core_distance(const Vec3f& x) const { return point_to_center(x); }
  SurfaceDistance<float> distance(const Vec3f& x) const { return sphere_distance(x, radius); }
  Manifold on_plane(const Plane& plane, const Transformf& pose, float) const {
    Manifold manifold = plane_manifold(plane);
    add_plane_sphere(manifold, plane, pose.p, radius, 0);
    return manifold;
  }
};

}  // namespace novaphy::geometry
