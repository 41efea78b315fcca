// ShapeConfig: the material and collision settings of a shape.
#pragma once

#include <cstdint>
#include <optional>

#include "novaphy/core/sim/enums.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Rules that combine the materials of two shapes in a contact. If either weight is 0, each
// coefficient is the mean of the two values. Otherwise the rules are MuJoCo's: the shape with the
// higher priority decides mu, ke and kd. With equal priorities, mu is the larger value, and ke and
// kd are means by weight. ke and kd are then per kg of 1 / (sum of the inverse masses). Only the
// pgs contacts of SolverFeatherstone read these settings; other solvers take means.
struct ShapeMixing {
  float priority = 0.0f;
  float weight = 0.0f;        // 1
  float inverse_mass = 0.0f;  // 1/kg
  float mu = 0.0f;            // replaces mu = 0 if the other shape's mu is not 0
};

// All numbers must be finite. All but `margin`, `collision_group` and the priority must be >= 0.
struct ShapeConfig {
  float density = 1000.0f;   // kg/m^3, for the mass that the shape adds to its body
  float ke = 2500.0f;        // N/m, contact stiffness
  float kd = 100.0f;         // N*s/m, contact damping
  float kf = 1000.0f;        // N*s/m, friction below the Coulomb limit
  float ka = 0.0f;           // m, adhesion distance (rigid contacts)
  float mu = 1.0f;           // 1, Coulomb friction
  float restitution = 0.0f;  // 1, only in pgs contacts of SolverFeatherstone
  // Stored in the model. No solver supports these coefficients, and every solver refuses values
  // other than these defaults.
  float mu_torsional = 0.005f, mu_rolling = 1e-4f;
  // m, thickness of the surface against other shapes. For particles the margin only widens the
  // detection; the force of a soft contact ignores the margin. A shell (is_solid false) has walls
  // of this thickness.
  float margin = 0.0f;
  // m, detection distance of rigid contacts. Empty: ModelBuilder::rigid_gap.
  std::optional<float> gap = {};
  bool is_solid = true;  // false: a shell, which only affects the mass
  // Which shapes collide with each other; particles ignore the group. Group 0 collides with
  // nothing. A positive group collides with itself and every negative group. A negative group
  // collides with every group except itself and 0.
  int32_t collision_group = 1;
  bool collision_filter_parent = true;
  bool has_shape_collision = true;
  bool has_particle_collision = true;
  bool is_visible = true;
  // Whether the shape is a site: a frame of its body without mass and without contacts. The values
  // of the other fields then do not matter.
  bool is_site = false;
  // Red, green and blue (0 to 1) in viewers. Empty: the viewer chooses.
  std::optional<Vec3f> color = {};
  ShapeMixing mixing = {};

  // Returns the bits of Model::shape_flags.
  constexpr int32_t flags() const {
    const int32_t seen = is_visible ? static_cast<int32_t>(ShapeFlags::VISIBLE) : 0;
    if (is_site) return seen | static_cast<int32_t>(ShapeFlags::SITE);
    return seen | (has_shape_collision ? static_cast<int32_t>(ShapeFlags::COLLIDE_SHAPES) : 0) |
           (has_particle_collision ? static_cast<int32_t>(ShapeFlags::COLLIDE_PARTICLES) : 0);
  }
};

}  // namespace novaphy
