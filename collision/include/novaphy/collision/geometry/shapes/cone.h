// The cone along z, with the base at -half_height and the apex at +half_height.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Cone {
  float radius, half_height;
  explicit Cone(const Vec3f& scale) : radius(scale.x), half_height(scale.y) {}

  float extent(const Vec3f& axis) const {
    return radius * math::sqrt(axis.x * axis.x + axis.y * axis.y) + half_height * axis.z;
  }
  Vec3f support(const Vec3f& d) const {
    const Vec3f rim = radial(d, radius) + Vec3f{0.0f, 0.0f, -half_height};
    const Vec3f apex = {0.0f, 0.0f, half_height};
    return math::dot(apex, d) > math::dot(rim, d) ? apex : rim;
  }
  // The feature is the base or a generator.
  Feature feature(const Vec3f& d) const {
    if (-d.z > kCapCosine) return cap_feature(radius, -half_height, false);
    Feature feature;
    add_point(feature, radial(d, radius) + Vec3f{0.0f, 0.0f, -half_height});
    add_point(feature, {0.0f, 0.0f, half_height});
    return feature;
  }
  SolidPoint core_distance(const Vec3f& x) const {
    const SurfaceDistance<float> p = distance(x);
    return {p.distance, p.normal};
  }
  SurfaceDistance<float> distance(const Vec3f& x) const {
    return cone_distance(x, radius, half_height);
  }
  // Adds the base (features 0 to 3) and the apex (4).
  Manifold on_plane(const Plane& plane, const Transformf& pose, float) const {
    const Vec3f u = math::rotate(pose.q, Vec3f{1.0f, 0.0f, 0.0f});
    const Vec3f v = math::rotate(pose.q, Vec3f{0.0f, 1.0f, 0.0f});
    const Vec3f axis = math::rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f}), half = axis * half_height;
    Manifold manifold = plane_manifold(plane);
    add_plane_disc(manifold, plane, pose.p - half, u, v, axis, radius);
    add_plane_point(manifold, plane, pose.p + half, 4);
    return manifold;
  }
};

}  // namespace novaphy::geometry
