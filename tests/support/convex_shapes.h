// A shape of each convex type, for scenes in which all types touch.
#pragma once

#include <vector>

#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing {

// Seven types in turns: box, sphere, capsule, cylinder, cone, ellipsoid, convex hull.
inline void add_convex_shape(ModelBuilder& builder, int32_t body, int kind,
                             const ShapeConfig& cfg) {
  static const std::vector<Vec3f> wedge = {{0.1f, 0.1f, -0.1f},   {-0.1f, 0.1f, -0.1f},
                                           {0.1f, -0.1f, -0.1f},  {-0.1f, -0.1f, -0.1f},
                                           {0.05f, 0.02f, 0.12f}, {-0.08f, 0.0f, 0.1f}};
  switch (kind % 7) {
    case 0:
      builder.add_shape_box(body, {.hx = 0.1f, .hy = 0.08f, .hz = 0.12f, .cfg = cfg});
      break;
    case 1:
      builder.add_shape_sphere(body, {.radius = 0.1f, .cfg = cfg});
      break;
    case 2:
      builder.add_shape_capsule(body, {.radius = 0.06f, .half_height = 0.1f, .cfg = cfg});
      break;
    case 3:
      builder.add_shape_cylinder(body, {.radius = 0.09f, .half_height = 0.1f, .cfg = cfg});
      break;
    case 4:
      builder.add_shape_cone(body, {.radius = 0.1f, .half_height = 0.1f, .cfg = cfg});
      break;
    case 5:
      builder.add_shape_ellipsoid(body, {.rx = 0.12f, .ry = 0.08f, .rz = 0.1f, .cfg = cfg});
      break;
    default:
      builder.add_shape_convex_hull(body, {.vertices = wedge, .cfg = cfg});
  }
}

}  // namespace novaphy::testing
