// The contacts of two convex shapes. The table has the method for each pair of types:
//
//              sphere    capsule   ellipsoid cylinder  box       cone      hull
//   sphere     closed    closed    GJK/EPA   closed    closed    closed    GJK/EPA
//   capsule              closed    GJK/EPA   GJK/EPA   closed    GJK/EPA   GJK/EPA
//   box                                                SAT, clip
//   all others: GJK distance, EPA penetration, clipped features
//
// The code calls the shape with the smaller type A, so that both orders of a pair of different
// types give the same bits. A pair with a value that is not finite has no contacts.
#pragma once

#include "novaphy/collision/geometry/box_box.h"
#include "novaphy/collision/geometry/capsule_pairs.h"
#include "novaphy/collision/geometry/sphere_pairs.h"

namespace novaphy::geometry {

// Requires type(a) <= type(b). The result is in the frame of A.
inline Manifold collide_ordered(const ShapePair& pair, float gap) {
  const GeoType a = pair.a->type, b = pair.b->type;
  if (a == GeoType::SPHERE && has_trait<&ShapeTraits::has_closed_distance>(b))
    return collide_sphere(pair, gap);
  if (a == GeoType::CAPSULE && b == GeoType::CAPSULE) return collide_capsules(pair, gap);
  if (a == GeoType::CAPSULE && b == GeoType::BOX) return collide_capsule_box(pair, gap);
  if (a == GeoType::BOX && b == GeoType::BOX) return collide_boxes(pair, gap);
  return collide_convex(pair, gap);
}

// Returns the points with a distance of at most `gap` (m) in the world frame, with the normal from
// a to b.
inline Manifold collide(const Shape& a, const Transformf& pose_a, const Shape& b,
                        const Transformf& pose_b, float gap) {
  constexpr auto kConvex = &ShapeTraits::is_convex;
  if (!has_trait<kConvex>(a.type) || !has_trait<kConvex>(b.type)) return {};
  const bool swap = b.type < a.type;
  const Transformf& first = swap ? pose_b : pose_a;
  const Transformf relative = relative_pose(first, swap ? pose_a : pose_b);
  const ShapePair pair = swap ? shape_pair(b, a, relative) : shape_pair(a, b, relative);
  if (!is_finite(pair)) return {};
  const Manifold manifold = in_frame(collide_ordered(pair, gap), first);
  return swap ? exchanged(manifold) : manifold;
}

}  // namespace novaphy::geometry
