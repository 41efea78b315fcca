// The feature of a shape in a direction: a face, an edge or a point of its core (shape.h).
//
// A face is a convex polygon, counter-clockwise seen from outside, with its normal. The caps of
// cylinders and cones are polygons with 8 rim points. These points are fixed in the shape's frame,
// so that the manifold of a resting shape does not rotate by rounding. The generators of cylinders
// and cones and the segment of a capsule are edges. A hull face with more than 16 corners is
// represented by every k-th corner.
//
// `face` is the number of the face in the shape. A face of a box has the number 2 axis + side (0:
// negative, 1: positive). Caps have 0 and 1, faces of a hull their index, and other shapes 0. Frame
// of the shape.
#pragma once

#include "novaphy/collision/geometry/support.h"

namespace novaphy::geometry {

inline constexpr int32_t kFeatureCapacity = 16;
inline constexpr float kCapCosine = 0.92388f;  // cos 22.5 deg: nearer directions select the cap

struct Feature {
  Vec3f points[kFeatureCapacity];
  Vec3f normal{};     // only for a face
  int32_t count = 0;  // 1: a point, 2: an edge, else a face
  int32_t face = 0;
};

inline void add_point(Feature& feature, const Vec3f& point) {
  feature.points[feature.count++] = point;
}

inline Feature box_feature(const Vec3f& h, const Vec3f& d) {
  const float x = math::abs(d.x), y = math::abs(d.y), z = math::abs(d.z);
  const int32_t axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
  const bool positive = !(component(d, axis) < 0.0f);
  const int32_t u = (axis + 1) % 3, v = (axis + 2) % 3;
  const float s = positive ? 1.0f : -1.0f;
  Feature feature;
  feature.normal = unit_axis(axis, s);
  feature.face = 2 * axis + (positive ? 1 : 0);
  const Vec3f center = unit_axis(axis, s * component(h, axis)), a = unit_axis(u, component(h, u)),
              b = unit_axis(v, s * component(h, v));
  add_point(feature, (center - a) - b);
  add_point(feature, (center + a) - b);
  add_point(feature, (center + a) + b);
  add_point(feature, (center - a) + b);
  return feature;
}

inline Feature cap_feature(float radius, float z, bool top) {
  const float r = radius, k = 0.70710678f * radius;
  const float x[8] = {r, k, 0.0f, -k, -r, -k, 0.0f, k};
  Feature feature;
  feature.normal = {0.0f, 0.0f, top ? 1.0f : -1.0f};
  feature.face = top ? 1 : 0;
  for (int32_t i = 0; i < 8; ++i) {
    const int32_t j = top ? i : 7 - i;
    add_point(feature, {x[j], x[(j + 6) % 8], z});  // sin t = cos(t - 90 deg)
  }
  return feature;
}

inline Feature cylinder_feature(float radius, float half_height, const Vec3f& d) {
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

inline Feature cone_feature(float radius, float half_height, const Vec3f& d) {
  if (-d.z > kCapCosine) return cap_feature(radius, -half_height, false);
  Feature feature;
  add_point(feature, radial(d, radius) + Vec3f{0.0f, 0.0f, -half_height});
  add_point(feature, {0.0f, 0.0f, half_height});
  return feature;
}

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
  const Vec3f s = shape.scale;
  Feature feature;
  switch (shape.type) {
    case GeoType::BOX:
      return box_feature(s, d);
    case GeoType::CYLINDER:
      return cylinder_feature(s.x, s.y, d);
    case GeoType::CONE:
      return cone_feature(s.x, s.y, d);
    case GeoType::CONVEX_MESH:
      return hull_feature(shape.hull, d);
    case GeoType::CAPSULE:
      add_point(feature, {0.0f, 0.0f, -s.y});
      add_point(feature, {0.0f, 0.0f, s.y});
      return feature;
    default:
      add_point(feature, core_support(shape, d));
      return feature;
  }
}

}  // namespace novaphy::geometry
