// Contacts of a sphere with a sphere, capsule, box, cylinder or cone, in closed form. The distance
// is the signed distance of the sphere's center to the other solid, minus the radius. A pair has
// one contact.
//
// A solid of revolution is reduced to its cross section, a rectangle or a triangle. The cross
// section lies in the half plane (rho, z) through the sphere's center. For a center inside of the
// solid the nearest face counts.
//
// If the nearest point is not unique, the choice is fixed. If both centers coincide, or the center
// lies on the segment of a capsule, the normal is +x. Inside of a box the face of the lowest axis
// is chosen, on the + side at 0. On the axis of a cylinder or cone the side towards +x is chosen.
// If side and cap are equally near, the cap is chosen.
//
// Frame of the solid (m), which is B. A is the sphere, and the normal points from A to B.
#pragma once

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/collision/geometry/clip_manifold.h"

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

inline SolidPoint point_to_box(const Vec3f& x, const Vec3f& h) {
  const Vec3f nearest = {math::clamp(x.x, -h.x, h.x), math::clamp(x.y, -h.y, h.y),
                         math::clamp(x.z, -h.z, h.z)};
  const Vec3f d = x - nearest;
  const float l = math::length(d);
  if (l > 0.0f) return {l, d / l};
  int32_t axis = 0;
  for (int32_t i = 1; i < 3; ++i)
    if (math::abs(component(x, i)) - component(h, i) >
        math::abs(component(x, axis)) - component(h, axis))
      axis = i;
  return {math::abs(component(x, axis)) - component(h, axis),
          unit_axis(axis, math::sign(component(x, axis)))};
}

inline SolidPoint point_to_cylinder(const Vec3f& x, float radius, float half_height) {
  const SurfaceDistance<float> p = cylinder_distance(x, radius, half_height);
  return {p.distance, p.normal};
}
inline SolidPoint point_to_cone(const Vec3f& x, float radius, float half_height) {
  const SurfaceDistance<float> p = cone_distance(x, radius, half_height);
  return {p.distance, p.normal};
}

inline bool has_closed_point_distance(GeoType type) {
  return type == GeoType::SPHERE || type == GeoType::CAPSULE || type == GeoType::BOX ||
         type == GeoType::CYLINDER || type == GeoType::CONE;
}

// Returns the signed distance of the point x to the core of a solid.
inline SolidPoint point_to_core(const Vec3f& x, const Shape& solid) {
  const Vec3f s = solid.scale;
  switch (solid.type) {
    case GeoType::BOX:
      return point_to_box(x, s);
    case GeoType::CYLINDER:
      return point_to_cylinder(x, s.x, s.y);
    case GeoType::CONE:
      return point_to_cone(x, s.x, s.y);
    case GeoType::CAPSULE:
      return point_to_center(x - Vec3f{0.0f, 0.0f, math::clamp(x.z, -s.y, s.y)});
    default:
      return point_to_center(x);
  }
}

// Returns the contact of a sphere A and a solid B with a closed-form distance. Frame of A.
inline Manifold collide_sphere(const ShapePair& pair, float gap) {
  const Vec3f center = apply_transposed(pair.rotation, -pair.offset);
  const SolidPoint p = point_to_core(center, *pair.b);
  const float ra = core_radius(*pair.a), distance = (p.distance - ra) - core_radius(*pair.b);
  Manifold manifold;
  if (!(distance <= gap)) return manifold;
  manifold.normal = apply(pair.rotation, -p.normal);
  add_contact(manifold, manifold.normal * (ra + 0.5f * distance), distance,
              contact_feature(0, 0, kWitnessCode));
  return manifold;
}

}  // namespace novaphy::geometry
