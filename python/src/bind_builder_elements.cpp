// ModelBuilder's springs, triangles, bending edges, tetrahedra, grids and meshes, and shapes that
// are meshes.
#include "convert.h"
#include "doc_builder_elements.h"
#include "element_arguments.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy::python {
namespace {

using Builder = py::class_<ModelBuilder>;

// Returns no material if all columns are None, one if no column is a list, else one per element.
template <class Material>
std::vector<Material> materials(
    std::initializer_list<std::tuple<py::handle, const char*, OptionalFloat Material::*>> columns) {
  std::vector<std::vector<float>> values;
  size_t count = 0;
  for (const auto& [value, name, member] : columns) {
    values.push_back(one_or_each(value, name));
    count = std::max(count, values.back().size());
  }
  std::vector<Material> rows(count);
  size_t c = 0;
  for (const auto& [value, name, member] : columns) {
    const std::vector<float>& column = values[c++];
    require(column.size() <= 1 || column.size() == count, ErrorKind::Value, name, ": expected ",
            count, " values, got ", column.size());
    for (size_t n = 0; n < count && !column.empty(); ++n)
      rows[n].*member = column.size() == 1 ? column[0] : column[n];
  }
  return rows;
}

template <size_t N, class Row>
std::vector<Row> rows_of(std::initializer_list<std::pair<py::handle, const char*>> columns) {
  std::vector<std::vector<int32_t>> values;
  for (const auto& [value, name] : columns) {
    values.push_back(to_int_list(value, name));
    require(values.back().size() == values[0].size(), ErrorKind::Value, name, ": expected ",
            values[0].size(), " indices as i has, got ", values.back().size());
  }
  std::vector<Row> rows;
  for (size_t n = 0; n < values[0].size(); ++n) {
    if constexpr (N == 3) {
      rows.push_back({values[0][n], values[1][n], values[2][n]});
    } else {
      rows.push_back({values[0][n], values[1][n], values[2][n], values[3][n]});
    }
  }
  return rows;
}

void bind_single(Builder& c) {
  c.def("add_spring", &ModelBuilder::add_spring, "i"_a, "j"_a, "ke"_a, "kd"_a, "control"_a = 0.0f,
        "tension_only"_a = false, doc::kAddSpring);
  c.def(
      "add_triangle",
      [](ModelBuilder& b, int32_t i, int32_t j, int32_t k, OptionalFloat ke, OptionalFloat ka,
         OptionalFloat kd, OptionalFloat drag, OptionalFloat lift) {
        return b.add_triangle(i, j, k, {ke, ka, kd, drag, lift});
      },
      "i"_a, "j"_a, "k"_a, py::kw_only(), "tri_ke"_a = py::none(), "tri_ka"_a = py::none(),
      "tri_kd"_a = py::none(), "tri_drag"_a = py::none(), "tri_lift"_a = py::none(),
      doc::kAddTriangle);
  c.def(
      "add_triangles",
      [](ModelBuilder& b, py::handle i, py::handle j, py::handle k, py::handle ke, py::handle ka,
         py::handle kd, py::handle drag, py::handle lift) {
        return b.add_triangles(rows_of<3, Vec3i>({{i, "i"}, {j, "j"}, {k, "k"}}),
                               materials<TriMaterial>({{ke, "tri_ke", &TriMaterial::ke},
                                                       {ka, "tri_ka", &TriMaterial::ka},
                                                       {kd, "tri_kd", &TriMaterial::kd},
                                                       {drag, "tri_drag", &TriMaterial::drag},
                                                       {lift, "tri_lift", &TriMaterial::lift}}));
      },
      "i"_a, "j"_a, "k"_a, py::kw_only(), "tri_ke"_a = py::none(), "tri_ka"_a = py::none(),
      "tri_kd"_a = py::none(), "tri_drag"_a = py::none(), "tri_lift"_a = py::none(),
      doc::kAddTriangles);
  c.def(
      "add_edge",
      [](ModelBuilder& b, int32_t i, int32_t j, int32_t k, int32_t l, OptionalFloat rest,
         OptionalFloat ke, OptionalFloat kd) {
        return b.add_edge(i, j, k, l, rest, EdgeMaterial{ke, kd});
      },
      "i"_a, "j"_a, "k"_a, "l"_a, py::kw_only(), "rest"_a = py::none(), "edge_ke"_a = py::none(),
      "edge_kd"_a = py::none(), doc::kAddEdge);
  c.def(
      "add_edges",
      [](ModelBuilder& b, py::handle i, py::handle j, py::handle k, py::handle l, py::handle rest,
         py::handle ke, py::handle kd) {
        const std::vector<float> angles =
            rest.is_none() ? std::vector<float>() : to_float_list(rest, "rest");
        b.add_edges(rows_of<4, Vec4i>({{i, "i"}, {j, "j"}, {k, "k"}, {l, "l"}}), angles,
                    materials<EdgeMaterial>(
                        {{ke, "edge_ke", &EdgeMaterial::ke}, {kd, "edge_kd", &EdgeMaterial::kd}}));
      },
      "i"_a, "j"_a, "k"_a, "l"_a, py::kw_only(), "rest"_a = py::none(), "edge_ke"_a = py::none(),
      "edge_kd"_a = py::none(),
      "Adds n bending edges from four lists {n} of particles. rest: None, or a list {n} of angles "
      "(rad). Each material (see add_edge) is one number, or a list with one number per edge.");
}

void bind_tetrahedra(Builder& c) {
  c.def(
      "add_tetrahedron",
      [](ModelBuilder& b, int32_t i, int32_t j, int32_t k, int32_t l, OptionalFloat mu,
         OptionalFloat lambda, OptionalFloat damp, OptionalFloat young, OptionalFloat ratio) {
        return b.add_tetrahedron(
            i, j, k, l, {one_of(mu), one_of(lambda), one_of(damp), one_of(young), one_of(ratio)});
      },
      "i"_a, "j"_a, "k"_a, "l"_a, "k_mu"_a = py::none(), "k_lambda"_a = py::none(),
      "k_damp"_a = py::none(), py::kw_only(), "youngs_modulus"_a = py::none(),
      "poisson_ratio"_a = py::none(), doc::kAddTet);
  c.def(
      "add_tetrahedra",
      [](ModelBuilder& b, py::handle i, py::handle j, py::handle k, py::handle l, py::handle mu,
         py::handle lambda, py::handle damp, py::handle young, py::handle ratio) {
        const TetMaterialLists of(mu, lambda, damp, young, ratio);
        return b.add_tetrahedra(rows_of<4, Vec4i>({{i, "i"}, {j, "j"}, {k, "k"}, {l, "l"}}),
                                of.view());
      },
      "i"_a, "j"_a, "k"_a, "l"_a, py::kw_only(), "k_mu"_a = py::none(), "k_lambda"_a = py::none(),
      "k_damp"_a = py::none(), "youngs_modulus"_a = py::none(), "poisson_ratio"_a = py::none(),
      "Adds n tetrahedra from four lists {n} of particles. Returns the volumes {n} (m^3). Each "
      "material (see add_tetrahedron) is one number, or a list with one number per tetrahedron.");
}

void bind_grids(Builder& c) {
  const py::tuple origin = py::make_tuple(0.0, 0.0, 0.0);
  const py::tuple no_turn = py::make_tuple(0.0, 0.0, 0.0, 1.0);
  c.def(
      "add_particle_grid",
      [](ModelBuilder& b, py::handle pos, py::handle rot, py::handle vel, int32_t dim_x,
         int32_t dim_y, int32_t dim_z, double cell_x, double cell_y, double cell_z, float mass,
         double jitter, OptionalFloat radius_mean, double radius_std, uint64_t seed) {
        b.add_particle_grid({placement(pos, rot, vel), dim_x, dim_y, dim_z, cell_x, cell_y, cell_z,
                             mass, jitter, radius_mean, radius_std, seed});
      },
      py::kw_only(), "pos"_a = origin, "rot"_a = no_turn, "vel"_a = origin, "dim_x"_a, "dim_y"_a,
      "dim_z"_a, "cell_x"_a, "cell_y"_a, "cell_z"_a, "mass"_a, "jitter"_a = 0.0,
      "radius_mean"_a = py::none(), "radius_std"_a = 0.0, "seed"_a = 0, doc::kAddParticleGrid);
  c.def(
      "add_cloth_grid",
      [](ModelBuilder& b, py::handle pos, py::handle rot, py::handle vel, int32_t dim_x,
         int32_t dim_y, double cell_x, double cell_y, float mass, bool reverse_winding,
         bool fix_left, bool fix_right, bool fix_top, bool fix_bottom, OptionalFloat tri_ke,
         OptionalFloat tri_ka, OptionalFloat tri_kd, OptionalFloat tri_drag, OptionalFloat tri_lift,
         OptionalFloat edge_ke, OptionalFloat edge_kd, bool add_springs, OptionalFloat spring_ke,
         OptionalFloat spring_kd, OptionalFloat particle_radius) {
        b.add_cloth_grid({placement(pos, rot, vel),
                          dim_x,
                          dim_y,
                          cell_x,
                          cell_y,
                          mass,
                          reverse_winding,
                          fix_left,
                          fix_right,
                          fix_top,
                          fix_bottom,
                          {tri_ke, tri_ka, tri_kd, tri_drag, tri_lift},
                          {edge_ke, edge_kd},
                          add_springs,
                          spring_ke,
                          spring_kd,
                          particle_radius});
      },
      py::kw_only(), "pos"_a = origin, "rot"_a = no_turn, "vel"_a = origin, "dim_x"_a, "dim_y"_a,
      "cell_x"_a, "cell_y"_a, "mass"_a, "reverse_winding"_a = false, "fix_left"_a = false,
      "fix_right"_a = false, "fix_top"_a = false, "fix_bottom"_a = false, "tri_ke"_a = py::none(),
      "tri_ka"_a = py::none(), "tri_kd"_a = py::none(), "tri_drag"_a = py::none(),
      "tri_lift"_a = py::none(), "edge_ke"_a = py::none(), "edge_kd"_a = py::none(),
      "add_springs"_a = false, "spring_ke"_a = py::none(), "spring_kd"_a = py::none(),
      "particle_radius"_a = py::none(), doc::kAddClothGrid);
}

void bind_meshes(Builder& c) {
  const py::tuple origin = py::make_tuple(0.0, 0.0, 0.0);
  const py::tuple no_turn = py::make_tuple(0.0, 0.0, 0.0, 1.0);
  c.def(
      "add_cloth_mesh",
      [](ModelBuilder& b, py::handle pos, py::handle rot, double scale, py::handle vel,
         py::handle vertices, py::handle indices, double density, OptionalFloat tri_ke,
         OptionalFloat tri_ka, OptionalFloat tri_kd, OptionalFloat tri_drag, OptionalFloat tri_lift,
         OptionalFloat edge_ke, OptionalFloat edge_kd, bool add_springs, OptionalFloat spring_ke,
         OptionalFloat spring_kd, OptionalFloat particle_radius) {
        const std::vector<Vec3f> points = to_vec3_list(vertices, "vertices");
        const std::vector<int32_t> corners = flat_indices(indices, "indices", 3);
        b.add_cloth_mesh({placement(pos, rot, vel),
                          scale,
                          points,
                          corners,
                          density,
                          {tri_ke, tri_ka, tri_kd, tri_drag, tri_lift},
                          {edge_ke, edge_kd},
                          add_springs,
                          spring_ke,
                          spring_kd,
                          particle_radius});
      },
      py::kw_only(), "pos"_a = origin, "rot"_a = no_turn, "scale"_a = 1.0, "vel"_a = origin,
      "vertices"_a, "indices"_a, "density"_a, "tri_ke"_a = py::none(), "tri_ka"_a = py::none(),
      "tri_kd"_a = py::none(), "tri_drag"_a = py::none(), "tri_lift"_a = py::none(),
      "edge_ke"_a = py::none(), "edge_kd"_a = py::none(), "add_springs"_a = false,
      "spring_ke"_a = py::none(), "spring_kd"_a = py::none(), "particle_radius"_a = py::none(),
      doc::kAddClothMesh);
}

Vec3f scale_of(py::handle scale) {
  if (scale.is_none()) return {1.0f, 1.0f, 1.0f};
  if (PySequence_Check(scale.ptr())) return to_vec3(scale, "scale");
  const float factor = to_float(scale, "scale");
  return {factor, factor, factor};
}

void bind_mesh_shapes(Builder& c) {
  c.def(
       "add_shape_mesh",
       [](ModelBuilder& b, int32_t body, py::handle xform, const py::object& mesh,
          const py::object& vertices, const py::object& indices, py::handle scale,
          const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
         const py::object v = given_or(mesh, "vertices", vertices);
         const py::object t = given_or(mesh, "indices", indices);
         require(!v.is_none() && !t.is_none(), ErrorKind::Value,
                 "add_shape_mesh: expected `mesh`, or `vertices` and `indices`, got neither");
         return b.add_shape_mesh(body, {.xform = to_transform(xform, "xform"),
                                        .vertices = to_vec3_list(v, "vertices"),
                                        .indices = flat_indices(t, "indices", 3),
                                        .scale = scale_of(scale),
                                        .cfg = shape_config(b, cfg, color),
                                        .label = label.value_or("")});
       },
       "body"_a, py::kw_only(), "xform"_a = py::none(), "mesh"_a = py::none(),
       "vertices"_a = py::none(), "indices"_a = py::none(), "scale"_a = py::none(),
       "cfg"_a = py::none(), "color"_a = py::none(), "label"_a = py::none(), doc::kAddShapeMesh)
      .def(
          "add_shape_convex_hull",
          [](ModelBuilder& b, int32_t body, py::handle xform, const py::object& mesh,
             const py::object& vertices, py::handle scale, int32_t max_vertices,
             const ShapeConfig* cfg, py::handle color, const std::optional<std::string>& label) {
            const py::object v = given_or(mesh, "vertices", vertices);
            require(!v.is_none(), ErrorKind::Value,
                    "add_shape_convex_hull: expected `mesh` or `vertices`, got neither");
            return b.add_shape_convex_hull(body, {.xform = to_transform(xform, "xform"),
                                                  .vertices = to_vec3_list(v, "vertices"),
                                                  .scale = scale_of(scale),
                                                  .max_vertices = max_vertices,
                                                  .cfg = shape_config(b, cfg, color),
                                                  .label = label.value_or("")});
          },
          "body"_a, py::kw_only(), "xform"_a = py::none(), "mesh"_a = py::none(),
          "vertices"_a = py::none(), "scale"_a = py::none(), "max_vertices"_a = kMaxHullVertices,
          "cfg"_a = py::none(), "color"_a = py::none(), "label"_a = py::none(), doc::kAddShapeHull);
}

void bind_coloring(Builder& c) {
  c.def(
       "color",
       [](ModelBuilder& b, std::optional<bool> include_bending, bool balance_colors) {
         b.color({.include_bending = include_bending, .balance_colors = balance_colors});
       },
       "include_bending"_a = py::none(), "balance_colors"_a = true, doc::kColor)
      .def(
          "set_coloring",
          [](ModelBuilder& b, py::handle groups, bool allow_conflicts) {
            std::vector<std::vector<int32_t>> lists;
            for (const py::handle group : py::iter(groups))
              lists.push_back(to_int_list(group, "groups"));
            b.set_coloring(lists, allow_conflicts);
          },
          "groups"_a, "allow_conflicts"_a = false,
          "Sets the colors: `groups` has a list of particles for each color. ValueError: a group "
          "is empty, a particle is in no group or in two, or without allow_conflicts an element "
          "has two corners of one color. IndexError: a particle does not exist.");
}

}  // namespace

void bind_builder_elements(Builder& c) {
#define NOVAPHY_DEFAULT(name, doc) c.def_readwrite(#name, &ModelBuilder::name, doc);
  NOVAPHY_DEFAULT(default_tri_ke, "The membrane stiffness of triangles (N/m).")
  NOVAPHY_DEFAULT(default_tri_ka, "The area stiffness of triangles (N/m).")
  NOVAPHY_DEFAULT(default_tri_kd, "The damping of triangles (N*s/m).")
  NOVAPHY_DEFAULT(default_tri_drag, "The drag of triangles (N*s^2/m^4).")
  NOVAPHY_DEFAULT(default_tri_lift, "The lift of triangles (N*s^2/m^4).")
  NOVAPHY_DEFAULT(default_spring_ke, "The stiffness of the springs of cloth (N/m).")
  NOVAPHY_DEFAULT(default_spring_kd, "The damping of the springs of cloth (N*s/m).")
  NOVAPHY_DEFAULT(default_edge_ke, "The stiffness of bending edges (N/m^2).")
  NOVAPHY_DEFAULT(default_edge_kd, "The damping of bending edges (N*s/m^4).")
  NOVAPHY_DEFAULT(default_tet_k_mu, "k_mu of tetrahedra (Pa), see add_tetrahedron.")
  NOVAPHY_DEFAULT(default_tet_k_lambda, "k_lambda of tetrahedra (Pa), see add_tetrahedron.")
  NOVAPHY_DEFAULT(default_tet_k_damp, "The damping of tetrahedra (Pa*s).")
  NOVAPHY_DEFAULT(default_tet_density, "The density of soft bodies (kg/m^3).")
#undef NOVAPHY_DEFAULT
  c.def_property_readonly("spring_count", &ModelBuilder::spring_count, "The number of springs.")
      .def_property_readonly("tri_count", &ModelBuilder::tri_count, "The number of triangles.")
      .def_property_readonly("edge_count", &ModelBuilder::edge_count,
                             "The number of bending edges.")
      .def_property_readonly("tet_count", &ModelBuilder::tet_count, "The number of tetrahedra.");
  bind_single(c);
  bind_tetrahedra(c);
  bind_grids(c);
  bind_meshes(c);
  bind_soft_bodies(c);
  bind_mesh_shapes(c);
  bind_coloring(c);
}

}  // namespace novaphy::python
