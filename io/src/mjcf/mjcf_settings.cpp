#include "mjcf_settings.h"

#include <algorithm>

namespace novaphy::detail {
namespace {

bool is_one_of(std::string_view name, std::initializer_list<const char*> names) {
  return std::any_of(names.begin(), names.end(), [&](const char* n) { return name == n; });
}

class SettingsReader {
 public:
  SettingsReader(const XmlFile& file, Notes& notes) : file_(file), notes_(notes) {}

  MjcfSettings run() {
    for (const Element* e = file_.root().FirstChildElement(); e != nullptr;
         e = e->NextSiblingElement()) {
      const std::string_view kind = e->Name();
      if (kind == "compiler") read_compiler(*e);
      if (kind == "option") read_option(*e);
    }
    if (!gravity_acts_) settings_.option.gravity = Vec3d{};
    const std::string given = mesh_folder_.empty() ? asset_folder_ : mesh_folder_;
    settings_.compiler.mesh_folder = given;
    return settings_;
  }

 private:
  [[noreturn]] void not_read(const Element& e, const std::string& what) const {
    file_.refuse(e, what + " is not read", ErrorKind::NotImplemented);
  }
  double number(const Element& e, const char* name) const {
    double value[1] = {0.0};
    file_.numbers(e, name, value);
    return value[0];
  }

  void read_compiler(const Element& e) {
    MjcfCompiler& c = settings_.compiler;
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      const std::string value = a->Value();
      const auto only = [&](std::initializer_list<const char*> values) {
        if (!is_one_of(value, values)) not_read(e, std::string(name) + "=\"" + value + "\"");
      };
      const auto flag = [&] { return read_flag(file_, e, a->Name(), value); };
      if (name == "angle") {
        only({"degree", "radian"});
        c.angle = value == "radian" ? 1.0 : MjcfCompiler{}.angle;
      } else if (name == "coordinate") {
        only({"local"});
      } else if (name == "eulerseq") {
        if (value.size() != 3 || value.find_first_not_of("xyzXYZ") != std::string::npos)
          file_.refuse(e, "eulerseq: expected three of x, y, z, X, Y, Z, got \"" + value + "\"");
        c.euler = value;
      } else if (name == "autolimits") {
        c.auto_limits = flag();
      } else if (name == "inertiafromgeom") {
        only({"true", "false", "auto"});
        c.inertia_from_geom = value == "true"    ? MjcfCompiler::Inertia::Always
                              : value == "false" ? MjcfCompiler::Inertia::Never
                                                 : MjcfCompiler::Inertia::Auto;
      } else if (name == "inertiagrouprange") {
        file_.numbers(e, "inertiagrouprange", c.groups);
      } else if (name == "boundmass") {
        c.bound_mass = number(e, "boundmass");
      } else if (name == "boundinertia") {
        c.bound_inertia = number(e, "boundinertia");
      } else if (name == "settotalmass") {
        c.total_mass = number(e, "settotalmass");
      } else if (name == "balanceinertia") {
        c.balance_inertia = flag();
      } else if (name == "fitaabb") {
        c.fit_aabb = flag();
      } else if (name == "strippath") {
        c.strip_path = flag();
      } else if (name == "meshdir") {
        mesh_folder_ = value;
      } else if (name == "assetdir") {
        asset_folder_ = value;
      } else if (name == "alignfree") {
        if (flag()) notes_.ignored(e, "alignfree: bodies keep their frames");
      } else if (name == "fusestatic") {
        if (flag()) notes_.ignored(e, "fusestatic: collapse_fixed_joints merges bodies");
      } else if (!is_one_of(name, {"texturedir", "usethread", "discardvisual", "exactmeshinertia",
                                   "saveinertial", "convexhull"})) {
        not_read(e, "the attribute " + std::string(name));
      } else if (name == "exactmeshinertia" && flag()) {
        notes_.ignored(e, "exactmeshinertia: expected inertia=\"exact\" of the meshes");
      }
    }
  }

  void read_option(const Element& e) {
    MjcfOption& o = settings_.option;
    std::string others;
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      double v[3] = {};
      if (name == "gravity") {
        file_.numbers(e, "gravity", v);
        o.gravity = {v[0], v[1], v[2]};
      } else if (name == "timestep") {
        o.timestep = number(e, "timestep");
        if (!(*o.timestep > 0.0)) file_.refuse(e, "timestep: expected > 0");
      } else if (name == "density" || name == "viscosity") {
        const double value = number(e, a->Name());
        if (!(value >= 0.0)) file_.refuse(e, std::string(name) + ": expected >= 0");
        (name == "density" ? o.fluid.density : o.fluid.viscosity) = static_cast<float>(value);
      } else if (name == "wind") {
        file_.numbers(e, "wind", v);
        o.fluid.wind = to_float(Vec3d{v[0], v[1], v[2]});
      } else if (name == "actuatorgroupdisable") {
        for (const double group : file_.parse(e, "actuatorgroupdisable", a->Value()))
          if (group >= 0.0 && group <= 30.0) o.disabled_groups |= 1u << static_cast<int>(group);
      } else if (name != "magnetic") {
        others += " " + std::string(name);
      }
    }
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      if (std::string_view(c->Name()) != "flag") not_read(*c, "this element");
      read_flags(*c);
    }
    if (!others.empty())
      notes_.ignored(
          e, "the step and the solver are those of the simulation, not of the file:" + others);
  }

  void read_flags(const Element& e) {
    MjcfOption& o = settings_.option;
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name(), value = a->Value();
      if (value != "enable" && value != "disable")
        file_.refuse(e, std::string(name) + ": expected enable or disable, got \"" +
                            std::string(value) + "\"");
      const bool on = value == "enable";
      if (name == "gravity") gravity_acts_ = on;
      if (name == "constraint") o.contact = o.limit = o.friction = o.equality = on;
      if (name == "contact") o.contact = on;
      if (name == "limit") o.limit = on;
      if (name == "frictionloss") o.friction = on;
      if (name == "equality") o.equality = on;
      if (name == "actuation") o.actuation = on;
      if (name == "passive") o.spring = o.damper = on;
      if (name == "spring") o.spring = on;
      if (name == "damper") o.damper = on;
      if (name == "filterparent") o.parent_filter = on;
      if (name == "clampctrl") o.clamp_control = on;
      if (name == "override" && on) notes_.ignored(e, "override: contacts keep their own numbers");
    }
  }

  const XmlFile& file_;
  Notes& notes_;
  MjcfSettings settings_;
  std::string mesh_folder_, asset_folder_;
  bool gravity_acts_ = true;
};

}  // namespace

bool read_flag(const XmlFile& file, const Element& e, const char* name, std::string_view text) {
  if (text != "true" && text != "false")
    file.refuse(e,
                std::string(name) + ": expected true or false, got \"" + std::string(text) + "\"");
  return text == "true";
}

MjcfSettings read_settings(const XmlFile& file, Notes& notes) {
  return SettingsReader(file, notes).run();
}

}  // namespace novaphy::detail
