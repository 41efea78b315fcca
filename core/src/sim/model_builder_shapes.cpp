// Shapes of a ModelBuilder.
#include <algorithm>
#include <limits>

#include "builder_checks.h"
#include "mass_properties.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {

int32_t ModelBuilder::append_shape(std::string_view name, const ShapeArgs& args,
                                   std::shared_ptr<const Mesh> mesh) {
  require(args.body >= -1 && args.body < body_count(), ErrorKind::Index, name,
          ": body: expected -1 (the world) to ", body_count() - 1, " (body_count is ", body_count(),
          "), got ", args.body, ", which is out of range");
  const bool has_vertices = shape_traits(args.type).size == ShapeSize::FACTORS;
  require(!has_vertices || mesh != nullptr, ErrorKind::Value, name,
          ": type: ", geo_type_name(args.type),
          " needs vertices; use add_shape_mesh or add_shape_convex_hull");
  const Vec3f scale = detail::checked_scale(name, args.type, args.scale);
  const Transformf xform = detail::checked_pose(name, args.xform);
  require(args.type != GeoType::PLANE || args.body < 0 ||
              bodies_[static_cast<size_t>(args.body)].is_kinematic,
          ErrorKind::Value, name,
          ": body: expected -1 (the world) or a kinematic body for a plane, got the dynamic body ",
          args.body);
  ShapeConfig cfg = args.cfg ? *args.cfg : default_shape_cfg;
  detail::check_shape_config(name, cfg);
  if (args.is_static || cfg.is_site) cfg.density = 0.0f;
  SolidProperties solid;
  if (has_vertices) {
    const bool has_mass = args.body >= 0 && cfg.density > 0.0f &&
                          !bodies_[static_cast<size_t>(args.body)].lock_inertia;
    if (has_mass) solid = solid_properties(name, args.type, *mesh, scale, cfg);
  } else if (args.body >= 0) {
    detail::shape_mass(name, args.type, scale, cfg);
  }
  if (!cfg.gap) detail::check_not_negative({name, "rigid_gap"}, rigid_gap);
  require(shape_count() < std::numeric_limits<int32_t>::max(), ErrorKind::Value, name,
          ": expected at most ", std::numeric_limits<int32_t>::max(), " shapes");
  const int32_t index = shape_count();
  shapes_.push_back({.body = args.body,
                     .type = args.type,
                     .xform = xform,
                     .scale = scale,
                     .cfg = cfg,
                     .gap = cfg.gap.value_or(rigid_gap),
                     .world = current_world_,
                     .label = args.label.empty() ? "shape_" + std::to_string(index) : args.label,
                     .mesh = std::move(mesh),
                     .solid = solid});
  return index;
}

int32_t ModelBuilder::add_shape(const ShapeArgs& args) { return append_shape("add_shape", args); }

int32_t ModelBuilder::add_shape_plane(const ShapePlaneArgs& args) {
  return append_shape(
      "add_shape_plane",
      {.body = args.body,
       .type = GeoType::PLANE,
       .xform = args.xform ? *args.xform : detail::plane_pose("add_shape_plane", args.plane),
       .scale = {args.width, args.length, 0.0f},
       .cfg = args.cfg,
       .label = args.label});
}

int32_t ModelBuilder::add_ground_plane(const GroundArgs& args) {
  detail::check_finite({"add_ground_plane", "height"}, args.height);
  const Vec3f up = up_vector();
  return add_shape_plane({.plane = {up.x, up.y, up.z, -args.height},
                          .width = 0.0f,
                          .length = 0.0f,
                          .cfg = args.cfg,
                          .label = args.label});
}

int32_t ModelBuilder::add_shape_sphere(int32_t body, const ShapeSphereArgs& args) {
  return append_shape("add_shape_sphere", {.body = body,
                                           .type = GeoType::SPHERE,
                                           .xform = args.xform,
                                           .scale = {args.radius, 0.0f, 0.0f},
                                           .cfg = args.cfg,
                                           .label = args.label});
}

int32_t ModelBuilder::add_shape_box(int32_t body, const ShapeBoxArgs& args) {
  return append_shape("add_shape_box", {.body = body,
                                        .type = GeoType::BOX,
                                        .xform = args.xform,
                                        .scale = {args.hx, args.hy, args.hz},
                                        .cfg = args.cfg,
                                        .label = args.label});
}

int32_t ModelBuilder::add_shape_capsule(int32_t body, const ShapeCapsuleArgs& args) {
  return append_shape("add_shape_capsule", {.body = body,
                                            .type = GeoType::CAPSULE,
                                            .xform = args.xform,
                                            .scale = {args.radius, args.half_height, 0.0f},
                                            .cfg = args.cfg,
                                            .label = args.label});
}

int32_t ModelBuilder::add_shape_cylinder(int32_t body, const ShapeCylinderArgs& args) {
  return append_shape("add_shape_cylinder", {.body = body,
                                             .type = GeoType::CYLINDER,
                                             .xform = args.xform,
                                             .scale = {args.radius, args.half_height, 0.0f},
                                             .cfg = args.cfg,
                                             .label = args.label});
}

int32_t ModelBuilder::add_shape_cone(int32_t body, const ShapeConeArgs& args) {
  return append_shape("add_shape_cone", {.body = body,
                                         .type = GeoType::CONE,
                                         .xform = args.xform,
                                         .scale = {args.radius, args.half_height, 0.0f},
                                         .cfg = args.cfg,
                                         .label = args.label});
}

int32_t ModelBuilder::add_shape_ellipsoid(int32_t body, const ShapeEllipsoidArgs& args) {
  return append_shape("add_shape_ellipsoid", {.body = body,
                                              .type = GeoType::ELLIPSOID,
                                              .xform = args.xform,
                                              .scale = {args.rx, args.ry, args.rz},
                                              .cfg = args.cfg,
                                              .label = args.label});
}

int32_t ModelBuilder::add_site(const ShapeArgs& args) {
  ShapeArgs site = args;
  site.cfg = ShapeConfig{.is_visible = args.cfg && args.cfg->is_visible, .is_site = true};
  return append_shape("add_site", site);
}

void ModelBuilder::add_shape_collision_filter_pair(int32_t a, int32_t b) {
  for (const int32_t shape : {a, b}) {
    require(shape >= 0 && shape < shape_count(), ErrorKind::Index,
            "add_shape_collision_filter_pair: expected shapes from 0 to ", shape_count() - 1,
            ", got ", shape);
  }
  require(a != b, ErrorKind::Value,
          "add_shape_collision_filter_pair: expected two different shapes, got ", a, " twice");
  filter_pairs_.insert(std::minmax(a, b));
}

}  // namespace novaphy
