// The capsule along z. Its core is the segment between the centers of the caps.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Capsule {
  float radius, half_height;
  explicit Capsule(const Vec3f& scale) : radius(scale.x), half_height(scale.y) {}

  float extent(const Vec3f& axis) const { return radius + half_height * axis.z; }
  Vec3f support(const Vec3f& d) const {
    return {0.0f, 0.0f, d.z < 0.0f ? -half_height : half_height};
  }
  // The feature is the segment.
  Feature feature(const Vec3f&) const {
    Feature feature;
    add_point(feature, {0.0f, 0.0f, -half_height});
    add_point(feature, {0.0f, 0.0f, half_height});
    return feature;
  }
  SolidPoint core_distance(const Vec3f& x) const {
    return point_to_center(x - Vec3f{0.0f, 0.0f, math::clamp(x.z, -half_height, half_height)});
  }
  SurfaceDistance<float> distance(const Vec3f& x) const {
    return capsule_distance(x, radius, half_height);
  }
  // Adds both ends of the capsule. The end at +z has feature 0 and comes first.
  Manifold on_plane(const Plane& plane, const Transformf& pose, float) const {
    const Vec3f half = math::rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f}) * half_height;
    Manifold manifold = plane_manifold(plane);
    add_plane_sphere(manifold, plane, pose.p + half, radius, 0);
    add_plane_sphere(manifold, plane, pose.p - half, radius, 1);
    return manifold;
  }
};

}  // namespace novaphy::geometry
