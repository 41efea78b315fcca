// The box with half extents along x, y and z.
#pragma once

#include "novaphy/collision/geometry/shapes/parts.h"

namespace novaphy::geometry {

struct Box {
  Vec3f half;
  explicit Box(const Vec3f& scale) : half(scale) {}

  float extent(const Vec3f& axis) const {
    return (half.x * axis.x + half.y * axis.y) + half.z * axis.z;
  }
  Vec3f support(const Vec3f& d) const {
    return {d.x < 0.0f ? -half.x : half.x, d.y < 0.0f ? -half.y : half.y,
            d.z < 0.0f ? -half.z : half.z};
  }
  // The feature is a face. Its number is 2 axis + side (0: negative, 1: positive).
  Feature feature(const Vec3f& d) const {
    const float x = math::abs(d.x), y = math::abs(d.y), z = math::abs(d.z);
    const int32_t axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
    const bool positive = !(component(d, axis) < 0.0f);
    const int32_t u = (axis + 1) % 3, v = (axis + 2) % 3;
    const float s = positive ? 1.0f : -1.0f;
    Feature feature;
    feature.normal = unit_axis(axis, s);
    feature.face = 2 * axis + (positive ? 1 : 0);
    const Vec3f center = unit_axis(axis, s * component(half, axis)),
                a = unit_axis(u, component(half, u)), b = unit_axis(v, s * component(half, v));
    add_point(feature, (center - a) - b);
    add_point(feature, (center + a) - b);
    add_point(feature, (center + a) + b);
    add_point(feature, (center - a) + b);
    return feature;
  }
  // If x is inside, the face of the lowest axis counts among equally near faces, on the + side at
  // 0.
  SolidPoint core_distance(const Vec3f& x) const {
    const Vec3f nearest = {math::clamp(x.x, -half.x, half.x), math::clamp(x.y, -half.y, half.y),
                           math::clamp(x.z, -half.z, half.z)};
    const Vec3f d = x - nearest;
    const float l = math::length(d);
    if (l > 0.0f) return {l, d / l};
    int32_t axis = 0;
    for (int32_t i = 1; i < 3; ++i)
      if (math::abs(component(x, i)) - component(half, i) >
          math::abs(component(x, axis)) - component(half, axis))
        axis = i;
    return {math::abs(component(x, axis)) - component(half, axis),
            unit_axis(axis, math::sign(component(x, axis)))};
  }
  SurfaceDistance<float> distance(const Vec3f& x) const { return box_distance(x, half); }
  // Returns the four deepest corners within `reach` (m), each in the slot where it was found. A
  // corner that is deeper than the least deep of four replaces it. If both are equally deep, the
  // earlier corner stays. The feature is the index of the corner: bit k is set for the + side of
  // axis k.
  Manifold on_plane(const Plane& plane, const Transformf& pose, float reach) const {
    const Vec3f& n = plane.normal;
    const float center = math::dot(pose.p - plane.point, n);
    Manifold manifold = plane_manifold(plane);
    if (center - 1.001f * math::length(half) > reach) return manifold;  // no corner is within reach
    const Vec3f ex = math::rotate(pose.q, Vec3f{1.0f, 0.0f, 0.0f});
    const Vec3f ey = math::rotate(pose.q, Vec3f{0.0f, 1.0f, 0.0f});
    const Vec3f ez = math::rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f});
    int highest = 0;
    for (int32_t k = 0; k < 8; ++k) {
      const Vec3f sign = {(k & 1) != 0 ? half.x : -half.x, (k & 2) != 0 ? half.y : -half.y,
                          (k & 4) != 0 ? half.z : -half.z};
      const Vec3f corner = (ex * sign.x + ey * sign.y) + ez * sign.z;
      const float d = center + math::dot(n, corner);
      if (d > reach) continue;
      const ContactPoint point = {(corner + pose.p) - (n * 0.5f) * d, d, k};
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
};

}  // namespace novaphy::geometry
