// Gravity and the fluid of a world, as arguments of builders, and the arrays of a model for the
// fluid.
#pragma once

#include <optional>

#include "novaphy/math/types.h"

namespace novaphy {

// Gravity of a builder (m/s^2): a number along the up axis, usually negative, or a vector.
struct GravitySpec {
  std::optional<float> along_up = -9.81f;
  Vec3f vector{};
  GravitySpec() = default;
  GravitySpec(float value) : along_up(value) {}
  GravitySpec(const Vec3f& value) : along_up(), vector(value) {}
};

// The fluid of a world, which drags the links of articulations. The default exerts no force.
struct Fluid {
  float density = 0.0f;    // kg/m^3, >= 0
  float viscosity = 0.0f;  // Pa s, >= 0
  Vec3f wind{};            // m/s, world frame: the velocity of the fluid
  bool operator==(const Fluid&) const = default;
};

// clang-format off
#define NOVAPHY_MODEL_FLUID_FIELDS(X)                                                             \
  X(body_fluid_box, Vec3f, 1, body_count, "m", "",                                                \
    "side lengths of the box that the fluid acts on; 0: no force")                                \
  X(body_fluid_frame, Quatf, 1, body_count, "1", "body",                                          \
    "rotation of the box, xyzw; its center is the center of mass")                                \
  X(fluid_density, float, 1, world_count, "kg/m^3", "", "density of the fluid of every world")    \
  X(fluid_viscosity, float, 1, world_count, "Pa*s", "", "viscosity of the fluid of every world")  \
  X(fluid_wind, Vec3f, 1, world_count, "m/s", "world", "velocity of the fluid of every world")
// clang-format on

}  // namespace novaphy
