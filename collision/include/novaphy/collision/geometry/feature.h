// The feature of a shape in a direction: a face, an edge or a point of its core (shape.h).
//
// Solids return their feature (shapes/parts.h). The faces of a hull have their index as number. A
// hull face with more than 16 corners is represented by every k-th corner. Frame of the shape.
#pragma once

#include "novaphy/collision/geometry/support.h"

namespace novaphy::geometry {

inline Feature hull_feature(const HullView& hull, const Vec3f& d) {
  int32_t best = 0;
  float alignment = -2.0f;
  for (int32_t i = 0; i < hull.face_count; ++i) {
    const float a = math::dot(hull.face_normals[i], d);
    if (a > alignment) {
      alignment = a;
      best = i;
    }
  }
  Feature feature;
  feature.face = best;
  feature.normal = hull.face_normals[best];
  const int32_t begin = hull.face_starts[best], count = hull.face_starts[best + 1] - begin;
  const int32_t stride = (count + kFeatureCapacity - 1) / kFeatureCapacity;
  for (int32_t i = 0; i < count; i += stride)
    add_point(feature, hull.vertices[hull.face_vertices[begin + i]]);
  return feature;
}

// Returns the feature of the shape that is farthest along the unit vector d.
NOVAPHY_OUT_OF_LINE Feature supporting_feature(const Shape& shape, const Vec3f& d) {
  if (shape.type == GeoType::CONVEX_MESH) return hull_feature(shape.hull, d);
  return with_solid(shape.type, shape.scale, [&](const auto& solid) { return solid.feature(d); });
}

}  // namespace novaphy::geometry
