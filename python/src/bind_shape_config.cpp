// ShapeConfig.
#include <array>
#include <tuple>

#include "novaphy/core/sim/model_builder.h"
#include "pickle.h"

namespace novaphy::python {
namespace {

void bind_mixing(py::class_<ShapeConfig>& c) {
  c.def_property(
      "mixing",
      [](const ShapeConfig& self) {
        const ShapeMixing& x = self.mixing;
        return std::make_tuple(x.priority, x.weight, x.inverse_mass, x.mu);
      },
      [](ShapeConfig& self, const std::array<float, 4>& x) {
        self.mixing = {x[0], x[1], x[2], x[3]};
      },
      "How the materials of two touching shapes are combined, as in MuJoCo: the tuple (priority, "
      "weight, inverse mass (1/kg), mu that replaces a mu of 0). With the weight 0 the material is "
      "the mean of both shapes.");
}

void bind_members(py::class_<ShapeConfig>& c) {
#define NOVAPHY_MEMBER(name, doc) c.def_readwrite(#name, &ShapeConfig::name, doc);
  NOVAPHY_MEMBER(density, "The density of the mass that the shape adds to its body (kg/m^3).")
  NOVAPHY_MEMBER(ke, "The contact stiffness (N/m).")
  NOVAPHY_MEMBER(kd, "The contact damping (N*s/m).")
  NOVAPHY_MEMBER(kf, "The viscous friction coefficient below the Coulomb limit (N*s/m).")
  NOVAPHY_MEMBER(ka,
                 "The adhesion distance of rigid contacts (m). Models without bodies refuse it.")
  NOVAPHY_MEMBER(mu, "The coefficient of Coulomb friction (1).")
  NOVAPHY_MEMBER(restitution,
                 "The coefficient of restitution (1), for \"pgs\" contacts of SolverFeatherstone. "
                 "Other solvers raise an error unless the value is the default.")
  NOVAPHY_MEMBER(mu_torsional,
                 "The value is stored, and no force uses it. Solvers refuse all values except the "
                 "default.")
  NOVAPHY_MEMBER(mu_rolling,
                 "The value is stored, and no force uses it. Solvers refuse all values except the "
                 "default.")
  NOVAPHY_MEMBER(
      margin,
      "The distance by which the surface is moved outwards for contacts with shapes (m). For "
      "contacts with particles, the margin only increases the detection distance. For a shell, the "
      "margin is the thickness of the wall.")
  NOVAPHY_MEMBER(gap, "The detection distance of rigid contacts (m); None: ModelBuilder.rigid_gap.")
  NOVAPHY_MEMBER(is_solid, "Whether the mass is computed for a solid; False: for a shell.")
  NOVAPHY_MEMBER(
      collision_group,
      "The collision group. A shape of group 0 collides with no shape. A shape of a positive group "
      "collides with the same group and with negative groups. A shape of a negative group collides "
      "with all groups except 0 and its own group.")
  NOVAPHY_MEMBER(collision_filter_parent,
                 "Whether contacts with the parent body of a joint are excluded.")
  NOVAPHY_MEMBER(has_shape_collision, "Whether the shape collides with shapes.")
  NOVAPHY_MEMBER(has_particle_collision, "Whether the shape collides with particles.")
  NOVAPHY_MEMBER(is_visible, "Whether viewers show the shape.")
  NOVAPHY_MEMBER(is_site, "Whether the shape is a site: a frame without contacts and mass.")
#undef NOVAPHY_MEMBER
}

}  // namespace

void bind_shape_config(py::module_& m) {
  const ShapeConfig d;
  py::class_<ShapeConfig> c(m, "ShapeConfig",
                            "The material and collision settings of a shape. All numbers must be "
                            "finite, and >= 0 except margin and collision_group.");
  c.def(py::init([](float density, float ke, float kd, float kf, float ka, float mu,
                    float restitution, float mu_torsional, float mu_rolling, float margin,
                    std::optional<float> gap, bool is_solid, int32_t collision_group,
                    bool collision_filter_parent, bool has_shape_collision,
                    bool has_particle_collision, bool is_visible, bool is_site,
                    const std::array<float, 4>& mixing) {
          return ShapeConfig{density,
                             ke,
                             kd,
                             kf,
                             ka,
                             mu,
                             restitution,
                             mu_torsional,
                             mu_rolling,
                             margin,
                             gap,
                             is_solid,
                             collision_group,
                             collision_filter_parent,
                             has_shape_collision,
                             has_particle_collision,
                             is_visible,
                             is_site,
                             {},
                             {mixing[0], mixing[1], mixing[2], mixing[3]}};
        }),
        "density"_a = d.density, "ke"_a = d.ke, "kd"_a = d.kd, "kf"_a = d.kf, "ka"_a = d.ka,
        "mu"_a = d.mu, "restitution"_a = d.restitution, "mu_torsional"_a = d.mu_torsional,
        "mu_rolling"_a = d.mu_rolling, "margin"_a = d.margin, "gap"_a = py::none(),
        "is_solid"_a = d.is_solid, "collision_group"_a = d.collision_group,
        "collision_filter_parent"_a = d.collision_filter_parent,
        "has_shape_collision"_a = d.has_shape_collision,
        "has_particle_collision"_a = d.has_particle_collision, "is_visible"_a = d.is_visible,
        "is_site"_a = d.is_site, "mixing"_a = py::make_tuple(0.0f, 0.0f, 0.0f, 0.0f));
  bind_members(c);
  bind_mixing(c);
  c.def_property_readonly("flags", &ShapeConfig::flags, "The bits of Model.shape_flags.")
      .def(
          "copy", [](const ShapeConfig& self) { return self; }, "Returns a copy.");
  add_settings_pickle(c);
}

}  // namespace novaphy::python
