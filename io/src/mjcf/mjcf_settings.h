// <compiler> and <option> of MJCF files: conventions of the file, and features that are switched
// off.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>

#include "../robot/notes.h"
#include "novaphy/core/sim/world_settings.h"

namespace novaphy::detail {

struct MjcfCompiler {
  double angle = 3.14159265358979323846 / 180.0;  // radians per angle unit of the file
  bool auto_limits = true;
  enum class Inertia { Auto, Always, Never } inertia_from_geom = Inertia::Auto;
  double groups[2] = {0.0, 5.0};  // range of geom groups that have a mass
  std::string euler = "xyz";      // order of Euler angles; capital letters mean axes fixed in space
  std::filesystem::path mesh_folder = {};
  bool strip_path = false, balance_inertia = false, fit_aabb = false;
  double bound_mass = 0.0, bound_inertia = 0.0, total_mass = -1.0;
};

struct MjcfOption {
  std::optional<Vec3d> gravity = {};
  std::optional<double> timestep = {};
  // Features that <flag> may switch off.
  bool contact = true, limit = true, friction = true, equality = true, actuation = true,
       spring = true, damper = true, parent_filter = true, clamp_control = true;
  Fluid fluid = {};
  bool has_fluid() const { return fluid.density != 0.0f || fluid.viscosity != 0.0f; }
  uint32_t disabled_groups = 0;  // disabled actuator groups, as bits
};

struct MjcfSettings {
  MjcfCompiler compiler;
  MjcfOption option;
};

MjcfSettings read_settings(const XmlFile& file, Notes& notes);

// Reads an attribute with the value true or false.
bool read_flag(const XmlFile& file, const Element& e, const char* name, std::string_view text);

}  // namespace novaphy::detail
