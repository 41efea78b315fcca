// The solids whose surface is a formula. A solid is a struct with the functions
//   extent(axis)           half the size along a unit vector with coordinates >= 0 (m)
//   support(d)             the point of the core that is farthest along d
//   feature(d)             the feature of the core along d (parts.h)
//   core_distance(x)       the signed distance of x to the core (m), by the rules of sphere_pairs.h
//   distance(x)            the signed distance of x to the surface (m), by the rules of particles
//   on_plane(plane, pose, reach)   the contacts with a plane (plane_pairs.h)
// Directions and points have the frame of the shape. Hulls and meshes have tables (shape.h).
#pragma once

#include "novaphy/collision/geometry/shapes/box.h"
#include "novaphy/collision/geometry/shapes/capsule.h"
#include "novaphy/collision/geometry/shapes/cone.h"
#include "novaphy/collision/geometry/shapes/cylinder.h"
#include "novaphy/collision/geometry/shapes/ellipsoid.h"
#include "novaphy/collision/geometry/shapes/sphere.h"

namespace novaphy::geometry {

// Returns f(solid) for the solid of a type. Every other type counts as a sphere.
template <class F>
auto with_solid(GeoType type, const Vec3f& scale, const F& f) {
  switch (type) {
    case GeoType::CAPSULE:
      return f(Capsule(scale));
    case GeoType::ELLIPSOID:
      return f(Ellipsoid(scale));
    case GeoType::CYLINDER:
      return f(Cylinder(scale));
    case GeoType::BOX:
      return f(Box(scale));
    case GeoType::CONE:
      return f(Cone(scale));
    default:
      return f(Sphere(scale));
  }
}

}  // namespace novaphy::geometry
