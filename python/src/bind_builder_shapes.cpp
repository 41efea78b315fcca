// Shapes and sites of ModelBuilder.
#include "doc_builder.h"
#include "novaphy/core/sim/model_builder.h"
#include "pickle.h"

namespace novaphy::python {
namespace {

void bind_any_shape(py::class_<ModelBuilder>& c) {
  c.def(
       "add_shape",
       [](py::object self, int32_t body, int32_t type, py::handle xform, const ShapeConfig* cfg,
          py::handle scale, py::handle src, bool is_static, py::handle color,
          const std::optional<std::string>& label) {
         ModelBuilder& b = self.cast<ModelBuilder&>();
         const auto geo_type = static_cast<GeoType>(type);
         if (!src.is_none()) {
           require(geo_type == GeoType::MESH || geo_type == GeoType::CONVEX_MESH, ErrorKind::Value,
                   "add_shape: src: expected None, of types other than MESH and CONVEX_MESH");
           ShapeConfig of_mesh = shape_config(b, cfg, color);
           if (is_static) of_mesh.density = 0.0f;
           return self
               .attr(geo_type == GeoType::MESH ? "add_shape_mesh" : "add_shape_convex_hull")(
                   body, "mesh"_a = src, "xform"_a = xform, "scale"_a = scale, "cfg"_a = of_mesh,
                   "label"_a = label)
               .cast<int32_t>();
         }
         ShapeArgs args{.body = body,
                        .type = geo_type,
                        .xform = to_transform(xform, "xform"),
                        .cfg = shape_config(b, cfg, color),
                        .label = text(label),
                        .is_static = is_static};
         if (!scale.is_none()) args.scale = to_vec3(scale, "scale");
         return b.add_shape(args);
       },
       py::kw_only(), "body"_a = -1, "type"_a, "xform"_a = py::none(), "cfg"_a = py::none(),
       "scale"_a = py::none(), "src"_a = py::none(), "is_static"_a = false, "color"_a = py::none(),
       "label"_a = py::none(), doc::kAddShape)
      .def(
          "add_site",
          [](ModelBuilder& b, int32_t body, py::handle xform, int32_t type, py::handle scale,
             const std::optional<std::string>& label, bool visible) {
            ShapeArgs args{.body = body,
                           .type = static_cast<GeoType>(type),
                           .xform = to_transform(xform, "xform"),
                           .cfg = ShapeConfig{.is_visible = visible},
                           .label = text(label)};
            args.scale = to_vec3(scale, "scale");
            return b.add_site(args);
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(),
          "type"_a = static_cast<int32_t>(GeoType::SPHERE),
          "scale"_a = py::make_tuple(0.01, 0.01, 0.01), "label"_a = py::none(), "visible"_a = false,
          doc::kAddSite);
}

void bind_planes(py::class_<ModelBuilder>& c) {
  c.def(
       "add_shape_plane",
       [](ModelBuilder& b, py::handle plane, py::handle xform, float width, float length,
          int32_t body, const ShapeConfig* cfg, py::handle color,
          const std::optional<std::string>& label) {
         ShapePlaneArgs args{.width = width,
                             .length = length,
                             .body = body,
                             .cfg = shape_config(b, cfg, color),
                             .label = text(label)};
         args.plane = to_vec4(plane, "plane");
         if (!xform.is_none()) args.xform = to_transform(xform, "xform");
         return b.add_shape_plane(args);
       },
       "plane"_a = py::make_tuple(0.0, 0.0, 1.0, 0.0), py::kw_only(), "xform"_a = py::none(),
       "width"_a = 10.0f, "length"_a = 10.0f, "body"_a = -1, "cfg"_a = py::none(),
       "color"_a = py::none(), "label"_a = py::none(), doc::kAddPlane)
      .def(
          "add_ground_plane",
          [](ModelBuilder& b, float height, const ShapeConfig* cfg, py::handle color,
             const std::optional<std::string>& label) {
            return b.add_ground_plane({.height = height,
                                       .cfg = shape_config(b, cfg, color),
                                       .label = label.value_or("ground_plane")});
          },
          py::kw_only(), "height"_a = 0.0f, "cfg"_a = py::none(), "color"_a = py::none(),
          "label"_a = py::none(),
          "Adds an infinite plane at a height (m) along the up axis. Returns the index.");
}

void bind_solids(py::class_<ModelBuilder>& c) {
  c.def(
       "add_shape_sphere",
       [](ModelBuilder& b, int32_t body, py::handle xform, float radius, const ShapeConfig* cfg,
          py::handle color, const std::optional<std::string>& label) {
         return b.add_shape_sphere(body, {.xform = to_transform(xform, "xform"),
                                          .radius = radius,
                                          .cfg = shape_config(b, cfg, color),
                                          .label = text(label)});
       },
       "body"_a, py::kw_only(), "xform"_a = py::none(), "radius"_a = 1.0f, "cfg"_a = py::none(),
       "color"_a = py::none(), "label"_a = py::none(),
       "Adds a sphere with a radius (m) and returns its index. xform: the pose in the body (m, "
       "xyzw). For cfg and color see add_shape.")
      .def(
          "add_shape_box",
          [](ModelBuilder& b, int32_t body, py::handle xform, float hx, float hy, float hz,
             const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
            return b.add_shape_box(body, {.xform = to_transform(xform, "xform"),
                                          .hx = hx,
                                          .hy = hy,
                                          .hz = hz,
                                          .cfg = shape_config(b, cfg, color),
                                          .label = text(label)});
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(), "hx"_a = 0.5f, "hy"_a = 0.5f,
          "hz"_a = 0.5f, "cfg"_a = py::none(), "color"_a = py::none(), "label"_a = py::none(),
          "Adds a box by its half extents (m). Returns the index.")
      .def(
          "add_shape_ellipsoid",
          [](ModelBuilder& b, int32_t body, py::handle xform, float rx, float ry, float rz,
             const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
            return b.add_shape_ellipsoid(body, {.xform = to_transform(xform, "xform"),
                                                .rx = rx,
                                                .ry = ry,
                                                .rz = rz,
                                                .cfg = shape_config(b, cfg, color),
                                                .label = text(label)});
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(), "rx"_a = 1.0f, "ry"_a = 0.75f,
          "rz"_a = 0.5f, "cfg"_a = py::none(), "color"_a = py::none(), "label"_a = py::none(),
          "Adds an ellipsoid by its half axes (m). Returns the index.");
}

void bind_round_solids(py::class_<ModelBuilder>& c) {
  c.def(
       "add_shape_capsule",
       [](ModelBuilder& b, int32_t body, py::handle xform, float radius, float half_height,
          const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
         return b.add_shape_capsule(body, {.xform = to_transform(xform, "xform"),
                                           .radius = radius,
                                           .half_height = half_height,
                                           .cfg = shape_config(b, cfg, color),
                                           .label = text(label)});
       },
       "body"_a, py::kw_only(), "xform"_a = py::none(), "radius"_a = 1.0f, "half_height"_a = 0.5f,
       "cfg"_a = py::none(), "color"_a = py::none(), "label"_a = py::none(),
       "Adds a capsule along local z and returns its index. radius: m. half_height: half the "
       "length of the cylindrical part, without the round caps (m).")
      .def(
          "add_shape_cylinder",
          [](ModelBuilder& b, int32_t body, py::handle xform, float radius, float half_height,
             const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
            return b.add_shape_cylinder(body, {.xform = to_transform(xform, "xform"),
                                               .radius = radius,
                                               .half_height = half_height,
                                               .cfg = shape_config(b, cfg, color),
                                               .label = text(label)});
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(), "radius"_a = 1.0f,
          "half_height"_a = 0.5f, "cfg"_a = py::none(), "color"_a = py::none(),
          "label"_a = py::none(),
          "Adds a cylinder along local z, with its radius and half_height (m). Returns the index.")
      .def(
          "add_shape_cone",
          [](ModelBuilder& b, int32_t body, py::handle xform, float radius, float half_height,
             const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
            return b.add_shape_cone(body, {.xform = to_transform(xform, "xform"),
                                           .radius = radius,
                                           .half_height = half_height,
                                           .cfg = shape_config(b, cfg, color),
                                           .label = text(label)});
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(), "radius"_a = 1.0f,
          "half_height"_a = 0.5f, "cfg"_a = py::none(), "color"_a = py::none(),
          "label"_a = py::none(),
          "Adds a cone along local z, with its base radius and half_height (m). The apex is at "
          "z = +half_height. Returns the index.");
}

}  // namespace

void bind_builder_shapes(py::class_<ModelBuilder>& c) {
  bind_any_shape(c);
  bind_planes(c);
  bind_solids(c);
  bind_round_solids(c);
  c.def("add_shape_collision_filter_pair", &ModelBuilder::add_shape_collision_filter_pair, "a"_a,
        "b"_a, "Excludes contacts between the shapes a and b. IndexError: a shape does not exist.");
}

}  // namespace novaphy::python
