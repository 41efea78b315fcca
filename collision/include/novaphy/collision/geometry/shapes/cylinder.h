// The cylinder along z.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Cylinder {
  float radius, half_height;
  explicit Cylinder(const Vec3f& scale) : radius(scale.x), half_height(scale.y) {}

  float extent(const Vec3f& axis) const {
    return radius * math::sqrt(axis.x * axis.x + axis.y * axis.y) + half_height * axis.z;
  }
  Vec3f support(const Vec3f& d) const {
    return radial(d, radius) + Vec3f{0.0f, 0.0f, d.z < 0.0f ? -half_height : half_height};
  }
  // The feature is a cap or a generator.
  Feature feature(const Vec3f& d) const {
    if (math::abs(d.z) > kCapCosine) {
      const bool top = d.z > 0.0f;
      return cap_feature(radius, top ? half_height : -half_height, top);
    }
    Feature feature;
    const Vec3f side = radial(d, radius), up = {0.0f, 0.0f, half_height};
    add_point(feature, side - up);
    add_point(feature, side + up);
    return feature;
  }
  SolidPoint core_distance(const Vec3f& x) const {
    const SurfaceDistance<float> p = distance(x);
    return {p.distance, p.normal};
  }
  SurfaceDistance<float> distance(const Vec3f& x) const {
    return cylinder_distance(x, radius, half_height);
  }
  // Adds the lower cap, and the deepest point of the other cap (feature 4). This point is the
  // second end of the generator on which the cylinder rolls.
  Manifold on_plane(const Plane& plane, const Transformf& pose, float) const {
    const Vec3f u = math::rotate(pose.q, Vec3f{1.0f, 0.0f, 0.0f});
    const Vec3f v = math::rotate(pose.q, Vec3f{0.0f, 1.0f, 0.0f});
    const Vec3f axis = math::rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f});
    const bool top_is_lower = math::dot(plane.normal, axis) < 0.0f;
    const Vec3f lower = axis * (top_is_lower ? half_height : -half_height);
    Manifold manifold = plane_manifold(plane);
    add_plane_disc(manifold, plane, pose.p + lower, u, v, axis, radius);
    add_plane_point(manifold, plane, (pose.p - lower) + deepest_of_rim(plane.normal, u, v, radius),
                    4);
    return manifold;
  }
};

}  // namespace novaphy::geometry
