// Reads geoms of MJCF files.
#include <cmath>

#include "mjcf_context.h"
#include "mjcf_softness.h"

namespace novaphy::detail {
namespace {

constexpr std::string_view kRead[] = {
    "name",   "class",   "type",         "pos",    "quat",   "axisangle", "euler",
    "zaxis",  "xyaxes",  "fromto",       "size",   "mass",   "density",   "friction",
    "margin", "contype", "conaffinity",  "condim", "rgba",   "mesh",      "material",
    "group",  "hfield",  "shellinertia", "solref", "solimp", "solmix",    "priority"};
// Attributes that the reader skips. `fluidcoef` acts on ellipsoids only, and `gap` does not affect
// the motion.
constexpr std::string_view kPassedOver[] = {"user", "fluidshape", "fluidcoef",
                                            "gap",  "fitscale",   "surfacevel"};

struct Kind {
  const char* name;
  GeoType type;
  size_t sizes;  // number of entries in `size`
  bool is_long;  // whether fromto is allowed
};
constexpr Kind kKinds[] = {
    {"sphere", GeoType::SPHERE, 1, false},    {"capsule", GeoType::CAPSULE, 2, true},
    {"cylinder", GeoType::CYLINDER, 2, true}, {"ellipsoid", GeoType::ELLIPSOID, 3, true},
    {"box", GeoType::BOX, 3, true},           {"plane", GeoType::PLANE, 2, false},
    {"mesh", GeoType::MESH, 0, false}};

class GeomReader {
 public:
  GeomReader(MjcfContext& context, const Element& e, const std::string& childclass, bool with_mass)
      : context_(context),
        file_(context.file),
        defaults_(context.defaults),
        e_(e),
        childclass_(childclass),
        with_mass_(with_mass) {}

  std::optional<MjcfGeom> run(const std::string& label) {
    defaults_.check_known(e_, childclass_, kRead, kPassedOver);
    const std::string type = defaults_.text(e_, "type", childclass_).value_or("sphere");
    if (type == "hfield") {
      context_.refuse_at_finalize(e_, "a height field");
      return {};
    }
    if (type == "sdf") {
      context_.notes.left_out(e_, "a signed distance field");
      return {};
    }
    const Kind* kind = nullptr;
    for (const Kind& known : kKinds)
      if (type == known.name) kind = &known;
    if (kind == nullptr)
      file_.refuse(e_,
                   "type: expected sphere, capsule, cylinder, ellipsoid, box, plane or mesh, got "
                   "\"" +
                       type + "\"",
                   ErrorKind::NotImplemented);
    geom_.shape = {.type = kind->type,
                   .pose = identity_pose(),
                   .scale = {},
                   .cfg = context_.builder.default_shape_cfg,
                   .label = label,
                   .where = file_.place(e_)};
    if (context_.settings.option.has_fluid() &&
        defaults_.text(e_, "fluidshape", childclass_).value_or("none") != "none")
      context_.notes.left_out(e_, "fluidshape: the fluid acts on the box of the whole body");
    read_collision();
    if (!read_pose_and_size(*kind, type)) return {};
    read_mass(*kind);
    read_surface();
    read_softness();
    read_color();
    context_.notes.read("geom");
    return std::move(geom_);
  }

 private:
  double number(const char* name, double by_default) const {
    return defaults_.number(e_, name, childclass_, by_default);
  }
  bool is_seen_only() const { return geom_.shape.contype == 0 && geom_.shape.conaffinity == 0; }

  // Reads pose, size and mesh. Returns false if the geom is left out.
  bool read_pose_and_size(const Kind& kind, const std::string& type) {
    RobotShape& shape = geom_.shape;
    double v[6] = {};
    if (defaults_.numbers(e_, "pos", childclass_, std::span(v).first(3)))
      shape.pose.p = {v[0], v[1], v[2]};
    shape.pose.q = defaults_.orientation(e_, childclass_, context_.settings.compiler);
    const auto mesh = defaults_.text(e_, "mesh", childclass_);
    if (kind.type == GeoType::MESH) {
      if (!mesh) file_.refuse(e_, "mesh: missing");
      return read_mesh(*mesh);
    }
    if (e_.Attribute("mesh") != nullptr) {
      context_.notes.left_out(e_, "a " + type + " that is fitted to a mesh");
      return false;
    }
    std::vector<double> size = defaults_.list(e_, "size", childclass_);
    if (kind.is_long && defaults_.numbers(e_, "fromto", childclass_, v)) {
      const Vec3d from = {v[0], v[1], v[2]}, to = {v[3], v[4], v[5]}, way = from - to;
      const double length = std::sqrt(math::dot(way, way));
      if (!(length > 1e-9)) file_.refuse(e_, "fromto: expected two different points");
      if (size.empty()) file_.refuse(e_, "size: missing");
      shape.pose = {(from + to) * 0.5, turn_from_z(way)};
      if (kind.sizes == 3)
        size = {size[0], size[0], 0.5 * length};
      else
        size = {size[0], 0.5 * length};
    } else if (e_.Attribute("fromto") != nullptr) {
      file_.refuse(e_, "fromto: expected none of a " + type);
    }
    // In MuJoCo, the size of a plane only affects rendering. The plane collides everywhere.
    if (kind.type == GeoType::PLANE) size.resize(2);
    if (size.size() < kind.sizes)
      file_.refuse(e_, "size: expected " + std::to_string(kind.sizes) + " numbers of a " + type +
                           ", got " + std::to_string(size.size()));
    for (size_t k = 0; k < kind.sizes; ++k)
      if (kind.type == GeoType::PLANE ? size[k] < 0.0 : !(static_cast<float>(size[k]) > 0.0f))
        file_.refuse(e_, "size: expected numbers > 0");
    size.resize(3);
    if (kind.type != GeoType::PLANE)
      shape.scale = {size[0], kind.sizes > 1 ? size[1] : 0.0, kind.sizes > 2 ? size[2] : 0.0};
    return true;
  }

  bool read_mesh(const std::string& name) {
    RobotShape& shape = geom_.shape;
    if (!context_.assets.is_there(name)) {
      const std::string text = "the file of the mesh \"" + name + "\" does not exist";
      if (is_seen_only()) {
        context_.notes.missing(e_, text);
        return false;
      }
    }
    mesh_ = &context_.assets.mesh(e_, name);
    shape.surface = mesh_->surface;
    shape.scale = {1.0, 1.0, 1.0};
    if (!is_seen_only()) shape.hull_vertices = mesh_->hull_vertices;
    return true;
  }

  void read_mass(const Kind& kind) {
    if (kind.type == GeoType::PLANE) return;
    double mass[1] = {};
    const bool has_mass = defaults_.numbers(e_, "mass", childclass_, mass);
    const double density = number("density", 1000.0);
    if (mass[0] < 0.0 || density < 0.0) file_.refuse(e_, "mass, density: expected >= 0");
    const double group = number("group", 0.0);
    const auto& groups = context_.settings.compiler.groups;
    if (group < groups[0] || group > groups[1]) return;
    if (has_mass ? mass[0] == 0.0 : density == 0.0) return;
    const auto shell = defaults_.text(e_, "shellinertia", childclass_).value_or("false");
    const bool is_shell = read_flag(file_, e_, "shellinertia", shell);
    if (is_shell && mesh_ == nullptr) {
      context_.notes.left_out(e_, "shellinertia of a geom without a mesh");
      return;
    }
    if (!with_mass_) return;
    const SolidMass solid =
        mesh_ != nullptr ? mesh_->mass(is_shell) : primitive_mass(kind.type, geom_.shape.scale);
    if (!(solid.volume > 1e-15)) file_.refuse(e_, "expected a mesh that encloses a volume");
    geom_.mass = has_mass ? mass[0] : density * solid.volume;
    geom_.com = solid.com;
    geom_.inertia = solid.inertia;
    for (auto& row : geom_.inertia.m)
      for (double& value : row) value *= geom_.mass / solid.volume;
  }

  void read_collision() {
    ShapeConfig& cfg = geom_.shape.cfg;
    cfg.density = 0.0f;  // read_mass computes the masses of bodies
    const double bits[] = {number("contype", 1.0), number("conaffinity", 1.0)};
    for (const double value : bits)
      if (value < 0.0 || value > 2147483647.0 || value != std::floor(value))
        file_.refuse(e_, "contype, conaffinity: expected whole numbers from 0");
    geom_.shape.contype = static_cast<uint32_t>(bits[0]);
    geom_.shape.conaffinity = static_cast<uint32_t>(bits[1]);
    if (is_seen_only() || !context_.settings.option.contact)
      cfg.has_shape_collision = cfg.has_particle_collision = false;
    cfg.is_visible = number("group", 0.0) <= 2.0;  // groups that MuJoCo's viewers show by default
    const double margin = number("margin", 0.0);
    if (margin < 0.0) file_.refuse(e_, "margin: expected >= 0");
    cfg.margin = static_cast<float>(margin);
    if (margin > 0.0) cfg.gap = static_cast<float>(margin);
  }

  void read_surface() {
    ShapeConfig& cfg = geom_.shape.cfg;
    const std::vector<double> friction = defaults_.list(e_, "friction", childclass_);
    if (friction.size() > 3) file_.refuse(e_, "friction: expected up to 3 numbers");
    float* const coefficients[] = {&cfg.mu, &cfg.mu_torsional, &cfg.mu_rolling};
    constexpr double kMujoco[] = {1.0, 0.005, 0.0001};
    for (size_t k = 0; k < 3; ++k) {
      const double value = k < friction.size() ? friction[k] : kMujoco[k];
      if (value < 0.0) file_.refuse(e_, "friction: expected numbers >= 0");
      *coefficients[k] = static_cast<float>(value);
    }
    const double condim = number("condim", 3.0);
    if (condim != 1.0 && condim != 3.0 && condim != 4.0 && condim != 6.0)
      file_.refuse(e_, "condim: expected 1, 3, 4 or 6");
    if (condim == 1.0) cfg.mixing.mu = std::exchange(cfg.mu, 0.0f);
    // As in MuJoCo, contacts with condim < 4 have no torsional friction, and contacts with condim <
    // 6 have no rolling friction.
    if (condim < 4.0) cfg.mu_torsional = 0.0f;
    if (condim < 6.0) cfg.mu_rolling = 0.0f;
    if (condim >= 4.0 && !is_seen_only())
      context_.notes.ignored(e_, condim < 6.0
                                     ? "condim 4: no solver has torsional friction"
                                     : "condim 6: no solver has torsional and rolling friction");
  }

  void read_softness() {
    ShapeConfig& cfg = geom_.shape.cfg;
    MjcfSoftness of;
    const auto first = [&](const char* name, std::span<double> to) {
      const std::vector<double> values = defaults_.list(e_, name, childclass_);
      if (values.size() > to.size())
        file_.refuse(
            e_, std::string(name) + ": expected up to " + std::to_string(to.size()) + " numbers");
      std::copy(values.begin(), values.end(), to.begin());
    };
    first("solref", of.solref);
    first("solimp", of.solimp);
    if (!is_seen_only() &&
        (defaults_.text(e_, "solref", childclass_) || defaults_.text(e_, "solimp", childclass_)))
      context_.notes.ignored(e_,
                             "solref, solimp: the softness of contacts acts with "
                             "SolverFeatherstone(compliant_contacts=True) only");
    if ((of.solref[0] > 0.0) != (of.solref[1] > 0.0)) {
      context_.notes.ignored(e_, "a solref of which one number is > 0, as in MuJoCo");
      std::copy_n(MjcfSoftness{}.solref, 2, of.solref);
    }
    const MjcfOption& option = context_.settings.option;
    const Vec3d g = option.gravity.value_or(Vec3d{0.0, 0.0, -9.81});
    const SpringPerMass spring =
        spring_per_mass(of, std::sqrt(math::dot(g, g)), 2.0 * option.timestep.value_or(0.002));
    cfg.ke = static_cast<float>(spring.ke);
    cfg.kd = static_cast<float>(spring.kd);
    cfg.mixing.priority = static_cast<float>(number("priority", 0.0));
    cfg.mixing.weight = static_cast<float>(std::max(number("solmix", 1.0), 1e-6));
    if (!std::isfinite(cfg.ke) || !std::isfinite(cfg.kd))
      file_.refuse(e_, "solref, solimp: expected a stiffness that float32 can hold");
  }

  void read_color() {
    double rgba[4];
    if (defaults_.numbers(e_, "rgba", childclass_, rgba))
      geom_.shape.color = Vec4f{static_cast<float>(rgba[0]), static_cast<float>(rgba[1]),
                                static_cast<float>(rgba[2]), static_cast<float>(rgba[3])};
    else if (const auto material = defaults_.text(e_, "material", childclass_))
      geom_.shape.color = context_.assets.color(*material);
  }

  MjcfContext& context_;
  const XmlFile& file_;
  const MjcfDefaults& defaults_;
  const Element& e_;
  const std::string& childclass_;
  const bool with_mass_;
  const MjcfMesh* mesh_ = nullptr;
  MjcfGeom geom_{};
};

}  // namespace

std::optional<MjcfGeom> read_geom(MjcfContext& context, const Element& e,
                                  const std::string& childclass, const std::string& label,
                                  bool with_mass) {
  return GeomReader(context, e, childclass, with_mass).run(label);
}

}  // namespace novaphy::detail
