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
      "Priority, weight, inverse mass (1/kg) and mu in place of 0, of the material of a pair. "
      "With the weight 0 it is the mean of both shapes.");
}

void bind_members(py::class_<ShapeConfig>& c) {
#define NOVAPHY_MEMBER(name, doc) c.def_readwrite(#name, &ShapeConfig::name, doc);
  NOVAPHY_MEMBER(density, "kg/m^3, of the mass that the shape adds to its body.")
  NOVAPHY_MEMBER(ke, "N/m, contact stiffness.")
  NOVAPHY_MEMBER(kd, "N*s/m, contact damping.")
  NOVAPHY_MEMBER(kf, "N*s/m, friction below the Coulomb limit.")
  NOVAPHY_MEMBER(ka, "m, adhesion distance of rigid contacts; refused where there are no bodies.")
  NOVAPHY_MEMBER(mu, "Coulomb friction.")
  NOVAPHY_MEMBER(
      restitution,
      "1, of bounces; read by pgs contacts of SolverFeatherstone. The other solvers refuse "
      "all but the default.")
  NOVAPHY_MEMBER(mu_torsional, "Stored; solvers refuse all but the default, as no force uses it.")
  NOVAPHY_MEMBER(mu_rolling, "Stored; solvers refuse all but the default, as no force uses it.")
  NOVAPHY_MEMBER(margin,
                 "m, moves the surface outwards for other shapes; for particles it only widens the "
                 "detection. The wall of a shell.")
  NOVAPHY_MEMBER(gap, "m, detection distance of rigid contacts; None: ModelBuilder.rigid_gap.")
  NOVAPHY_MEMBER(is_solid, "False: a shell, for the mass.")
  NOVAPHY_MEMBER(collision_group,
                 "0 collides with no shape; a positive group meets itself and negative ones; a "
                 "negative group meets all "
                 "but itself.")
  NOVAPHY_MEMBER(collision_filter_parent,
                 "Whether contacts with the parent body of a joint are excluded.")
  NOVAPHY_MEMBER(has_shape_collision, "Whether shapes meet it.")
  NOVAPHY_MEMBER(has_particle_collision, "Whether particles meet it.")
  NOVAPHY_MEMBER(is_visible, "Whether viewers show it.")
  NOVAPHY_MEMBER(is_site, "Whether the shape is a frame that meets nothing and has no mass.")
#undef NOVAPHY_MEMBER
}

}  // namespace

void bind_shape_config(py::module_& m) {
  const ShapeConfig d;
  py::class_<ShapeConfig> c(
      m, "ShapeConfig",
      "Material and collision settings of a shape. All numbers finite; all but margin and "
      "collision_group >= 0.");
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
        "is_site"_a = d.is_site,
        "mixing"_a = py::make_tuple(0.0f, 0.0f, 0.0f, 0.0f));
  bind_members(c);
  bind_mixing(c);
  c.def_property_readonly("flags", &ShapeConfig::flags, "The bits of Model.shape_flags.")
      .def(
          "copy", [](const ShapeConfig& self) { return self; }, "A copy.");
  add_settings_pickle(c);
}

}  // namespace novaphy::python
