// ShapeConfig: material and collision settings of a shape.
#pragma once

#include <cstdint>
#include <optional>

#include "novaphy/core/sim/enums.h"
#include "novaphy/math/types.h"

namespace novaphy {

// How materials of two shapes combine. Where one of both has the weight 0, each coefficient is the
// mean of both. Else, as in MuJoCo, the shape of the higher priority decides about mu, ke and kd;
// of shapes of one priority mu is the larger one, and ke and kd are means by weight. ke and kd are
// then per kg of 1 / (sum of the inverse masses). SolverFeatherstone's pgs contacts only; other
// solvers take means.
struct ShapeMixing {
  float priority = 0.0f;
  float weight = 0.0f;        // 1
  float inverse_mass = 0.0f;  // 1/kg
  float mu = 0.0f;            // in place of a mu of 0, where the mu of the other shape is not 0
};

// All numbers must be finite, and all but `margin`, `collision_group` and the priority must be >=
// 0.
struct ShapeConfig {
  float density = 1000.0f;   // kg/m^3, of the mass that the shape adds to its body
  float ke = 2500.0f;        // N/m, contact stiffness
  float kd = 100.0f;         // N*s/m, contact damping
  float kf = 1000.0f;        // N*s/m, friction below the Coulomb limit
  float ka = 0.0f;           // m, adhesion distance (rigid contacts)
  float mu = 1.0f;           // 1, Coulomb friction
  float restitution = 0.0f;  // 1, of bounces; SolverFeatherstone's pgs contacts only
  // Kept in the model; no solver reads them, and each refuses other values than these.
  float mu_torsional = 0.005f, mu_rolling = 1e-4f;
  // m, moves the surface outwards for other shapes. For particles it only widens the detection: the
  // soft contact force does not use it. A shell (is_solid false) has walls of this thickness.
  float margin = 0.0f;
  // m, detection distance of rigid contacts; ModelBuilder::rigid_gap when empty.
  std::optional<float> gap = {};
  bool is_solid = true;  // false: a shell, for the mass
  // 1 by default; 0 collides with nothing; a positive group meets itself and every negative group;
  // a negative group meets everything but the same negative number. For shapes among each other;
  // particles do not look at it.
  int32_t collision_group = 1;
  bool collision_filter_parent = true;
  bool has_shape_collision = true;
  bool has_particle_collision = true;
  bool is_visible = true;
  // A frame of its body, which meets nothing and has no mass, whatever the fields above say.
  bool is_site = false;
  // Red, green, blue, 0 to 1, in which viewers show it; they choose one when empty.
  std::optional<Vec3f> color = {};
  ShapeMixing mixing = {};

  // The bits of Model::shape_flags.
  constexpr int32_t flags() const {
    const int32_t seen = is_visible ? static_cast<int32_t>(ShapeFlags::VISIBLE) : 0;
    if (is_site) return seen | static_cast<int32_t>(ShapeFlags::SITE);
    return seen | (has_shape_collision ? static_cast<int32_t>(ShapeFlags::COLLIDE_SHAPES) : 0) |
           (has_particle_collision ? static_cast<int32_t>(ShapeFlags::COLLIDE_PARTICLES) : 0);
  }
};

}  // namespace novaphy
