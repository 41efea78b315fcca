// ModelBuilder's soft bodies: grids and meshes.
#include "doc_builder_elements.h"
#include "element_arguments.h"

namespace novaphy::python {
namespace {

using Builder = py::class_<ModelBuilder>;

void bind_soft_grid(Builder& c) {
  const py::tuple origin = py::make_tuple(0.0, 0.0, 0.0);
  const py::tuple no_turn = py::make_tuple(0.0, 0.0, 0.0, 1.0);
  c.def(
      "add_soft_grid",
      [](ModelBuilder& b, py::handle pos, py::handle rot, py::handle vel, int32_t dim_x,
         int32_t dim_y, int32_t dim_z, double cell_x, double cell_y, double cell_z, double density,
         OptionalFloat k_mu, OptionalFloat k_lambda, OptionalFloat k_damp,
         OptionalFloat youngs_modulus, OptionalFloat poisson_ratio, bool fix_left, bool fix_right,
         bool fix_top, bool fix_bottom, OptionalFloat tri_ke, OptionalFloat tri_ka,
         OptionalFloat tri_kd, OptionalFloat tri_drag, OptionalFloat tri_lift,
         bool add_surface_mesh_edges, OptionalFloat edge_ke, OptionalFloat edge_kd,
         OptionalFloat particle_radius) {
        b.add_soft_grid({placement(pos, rot, vel),
                         dim_x,
                         dim_y,
                         dim_z,
                         cell_x,
                         cell_y,
                         cell_z,
                         density,
                         k_mu,
                         k_lambda,
                         k_damp,
                         youngs_modulus,
                         poisson_ratio,
                         fix_left,
                         fix_right,
                         fix_top,
                         fix_bottom,
                         {tri_ke, tri_ka, tri_kd, tri_drag, tri_lift},
                         add_surface_mesh_edges,
                         {edge_ke, edge_kd},
                         particle_radius});
      },
      py::kw_only(), "pos"_a = origin, "rot"_a = no_turn, "vel"_a = origin, "dim_x"_a, "dim_y"_a,
      "dim_z"_a, "cell_x"_a, "cell_y"_a, "cell_z"_a, "density"_a, "k_mu"_a = py::none(),
      "k_lambda"_a = py::none(), "k_damp"_a = py::none(), "youngs_modulus"_a = py::none(),
      "poisson_ratio"_a = py::none(), "fix_left"_a = false, "fix_right"_a = false,
      "fix_top"_a = false, "fix_bottom"_a = false, "tri_ke"_a = 0.0f, "tri_ka"_a = 0.0f,
      "tri_kd"_a = 0.0f, "tri_drag"_a = 0.0f, "tri_lift"_a = 0.0f,
      "add_surface_mesh_edges"_a = true, "edge_ke"_a = 0.0f, "edge_kd"_a = 0.0f,
      "particle_radius"_a = py::none(), doc::kAddSoftGrid);
}

void bind_soft_mesh(Builder& c) {
  const py::tuple origin = py::make_tuple(0.0, 0.0, 0.0);
  const py::tuple no_turn = py::make_tuple(0.0, 0.0, 0.0, 1.0);
  c.def(
      "add_soft_mesh",
      [](ModelBuilder& b, py::handle pos, py::handle rot, double scale, py::handle vel,
         const py::object& mesh, const py::object& vertices, const py::object& indices,
         const py::object& density, const py::object& k_mu, const py::object& k_lambda,
         const py::object& k_damp, const py::object& youngs_modulus,
         const py::object& poisson_ratio, OptionalFloat tri_ke, OptionalFloat tri_ka,
         OptionalFloat tri_kd, OptionalFloat tri_drag, OptionalFloat tri_lift,
         bool add_surface_mesh_edges, OptionalFloat edge_ke, OptionalFloat edge_kd,
         OptionalFloat particle_radius) {
        const py::object v = given_or(mesh, "vertices", vertices);
        const py::object t = given_or(mesh, "indices", indices);
        require(!v.is_none() && !t.is_none(), ErrorKind::Value,
                "add_soft_mesh: expected `mesh`, or `vertices` and `indices`, got neither");
        const std::vector<Vec3f> points = to_vec3_list(v, "vertices");
        const std::vector<int32_t> corners = flat_indices(t, "indices", 4);
        // Young's modulus and Poisson's ratio replace the elasticity of the mesh.
        const py::object none = py::none();
        const py::object& lame = youngs_modulus.is_none() && poisson_ratio.is_none() ? mesh : none;
        const TetMaterialLists materials(
            given_or(lame, "k_mu", k_mu), given_or(lame, "k_lambda", k_lambda),
            given_or(mesh, "k_damp", k_damp), youngs_modulus, poisson_ratio);
        b.add_soft_mesh({placement(pos, rot, vel),
                         scale,
                         points,
                         corners,
                         given_or(mesh, "density", density).cast<std::optional<double>>(),
                         materials.view(),
                         {tri_ke, tri_ka, tri_kd, tri_drag, tri_lift},
                         add_surface_mesh_edges,
                         {edge_ke, edge_kd},
                         particle_radius});
      },
      py::kw_only(), "pos"_a = origin, "rot"_a = no_turn, "scale"_a = 1.0, "vel"_a = origin,
      "mesh"_a = py::none(), "vertices"_a = py::none(), "indices"_a = py::none(),
      "density"_a = py::none(), "k_mu"_a = py::none(), "k_lambda"_a = py::none(),
      "k_damp"_a = py::none(), "youngs_modulus"_a = py::none(), "poisson_ratio"_a = py::none(),
      "tri_ke"_a = 0.0f, "tri_ka"_a = 0.0f, "tri_kd"_a = 0.0f, "tri_drag"_a = 0.0f,
      "tri_lift"_a = 0.0f, "add_surface_mesh_edges"_a = true, "edge_ke"_a = 0.0f,
      "edge_kd"_a = 0.0f, "particle_radius"_a = py::none(), doc::kAddSoftMesh);
}

}  // namespace

void bind_soft_bodies(Builder& c) {
  bind_soft_grid(c);
  bind_soft_mesh(c);
}

}  // namespace novaphy::python
