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

#include "novaphy/collision/geometry/clip_manifold.h"

namespace novaphy::geometry {

// Returns the contact of a sphere A and a solid B with a closed-form distance. Frame of A.
inline Manifold collide_sphere(const ShapePair& pair, float gap) {
  const Vec3f center = apply_transposed(pair.rotation, -pair.offset);
  const SolidPoint p = with_solid(pair.b->type, pair.b->scale,
                                  [&](const auto& solid) { return solid.core_distance(center); });
  const float ra = core_radius(*pair.a), distance = (p.distance - ra) - core_radius(*pair.b);
  Manifold manifold;
  if (!(distance <= gap)) return manifold;
  manifold.normal = apply(pair.rotation, -p.normal);
  add_contact(manifold, manifold.normal * (ra + 0.5f * distance), distance,
              contact_feature(0, 0, kWitnessCode));
  return manifold;
}

}  // namespace novaphy::geometry
