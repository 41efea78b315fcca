#include "mjcf_geom.h"

#include <cmath>
#include <numbers>

namespace novaphy::detail {
namespace {

constexpr std::string_view kRead[] = {"name",      "class",       "type",    "pos",      "quat",
                                      "axisangle", "euler",       "zaxis",   "xyaxes",   "fromto",
                                      "size",      "mass",        "density", "friction", "margin",
                                      "contype",   "conaffinity", "condim",  "rgba"};
// Pictures, and numbers of MuJoCo's contact solver.
constexpr std::string_view kPassedOver[] = {"material", "group",    "solref", "solimp",
                                            "solmix",   "priority", "user"};

double volume(GeoType type, const Vec3d& s) {
  constexpr double pi = std::numbers::pi;
  switch (type) {
    case GeoType::SPHERE:
      return 4.0 / 3.0 * pi * s.x * s.x * s.x;
    case GeoType::CAPSULE:
      return pi * s.x * s.x * (2.0 * s.y + 4.0 / 3.0 * s.x);
    case GeoType::CYLINDER:
      return pi * s.x * s.x * 2.0 * s.y;
    case GeoType::ELLIPSOID:
      return 4.0 / 3.0 * pi * s.x * s.y * s.z;
    case GeoType::BOX:
      return 8.0 * s.x * s.y * s.z;
    default:
      return 0.0;
  }
}

struct Kind {
  const char* name;
  GeoType type;
  size_t sizes;  // numbers of `size`
  bool is_long;  // may have fromto
};
constexpr Kind kKinds[] = {
    {"sphere", GeoType::SPHERE, 1, false},    {"capsule", GeoType::CAPSULE, 2, true},
    {"cylinder", GeoType::CYLINDER, 2, true}, {"ellipsoid", GeoType::ELLIPSOID, 3, true},
    {"box", GeoType::BOX, 3, true},           {"plane", GeoType::PLANE, 2, false}};

}  // namespace

RobotShape read_geom(const XmlFile& file, const MjcfDefaults& defaults,
                     const MjcfCompiler& compiler, const Element& e, const std::string& childclass,
                     const ShapeConfig& base, const std::string& label, bool with_mass) {
  defaults.check_known(e, childclass, kRead, kPassedOver);
  const std::string type = defaults.text(e, "type", childclass).value_or("sphere");
  const Kind* kind = nullptr;
  for (const Kind& known : kKinds)
    if (type == known.name) kind = &known;
  if (kind == nullptr)
    file.refuse(
        e,
        "type: expected sphere, capsule, cylinder, ellipsoid, box or plane, got \"" + type + "\"",
        ErrorKind::NotImplemented);
  RobotShape shape{.type = kind->type,
                   .pose = identity_pose(),
                   .scale = {},
                   .cfg = base,
                   .label = label,
                   .where = file.place(e)};
  double v[6] = {};
  if (defaults.numbers(e, "pos", childclass, std::span(v).first(3)))
    shape.pose.p = {v[0], v[1], v[2]};
  shape.pose.q = defaults.orientation(e, childclass, compiler);
  std::vector<double> size = defaults.list(e, "size", childclass);
  if (defaults.numbers(e, "fromto", childclass, v)) {
    if (!kind->is_long) file.refuse(e, "fromto: expected none of a " + type);
    const Vec3d from = {v[0], v[1], v[2]}, to = {v[3], v[4], v[5]}, way = from - to;
    const double length = std::sqrt(math::dot(way, way));
    if (!(length > 1e-9)) file.refuse(e, "fromto: expected two different points");
    if (size.empty()) file.refuse(e, "size: missing");
    shape.pose = {(from + to) * 0.5, turn_from_z(way)};
    if (kind->sizes == 3) {
      const double width = size[0];
      size = {width, width, 0.5 * length};
    } else {
      size = {size[0], 0.5 * length};
    }
  }
  if (size.size() < kind->sizes)
    file.refuse(e, "size: expected " + std::to_string(kind->sizes) + " numbers of a " + type +
                       ", got " + std::to_string(size.size()));
  for (size_t k = 0; k < kind->sizes; ++k)
    if (kind->type == GeoType::PLANE ? size[k] < 0.0 : !(static_cast<float>(size[k]) > 0.0f))
      file.refuse(e, "size: expected numbers > 0");
  if (kind->type == GeoType::PLANE) {
    // MuJoCo's planes end only in pictures: they collide everywhere.
    shape.scale = {};
  } else {
    shape.scale = {size[0], kind->sizes > 1 ? size[1] : 0.0, kind->sizes > 2 ? size[2] : 0.0};
  }

  ShapeConfig& cfg = shape.cfg;
  double density = defaults.number(e, "density", childclass, 1000.0);
  double mass[1];
  if (defaults.numbers(e, "mass", childclass, mass)) {
    if (mass[0] < 0.0) file.refuse(e, "mass: expected >= 0");
    if (kind->type != GeoType::PLANE) density = mass[0] / volume(kind->type, shape.scale);
  }
  if (density < 0.0) file.refuse(e, "density: expected >= 0");
  cfg.density = with_mass ? static_cast<float>(density) : 0.0f;
  const std::vector<double> friction = defaults.list(e, "friction", childclass);
  if (friction.size() > 3) file.refuse(e, "friction: expected up to 3 numbers");
  float* const coefficients[] = {&cfg.mu, &cfg.mu_torsional, &cfg.mu_rolling};
  constexpr double kMujoco[] = {1.0, 0.005, 0.0001};
  for (size_t k = 0; k < 3; ++k) {
    const double value = k < friction.size() ? friction[k] : kMujoco[k];
    if (value < 0.0) file.refuse(e, "friction: expected numbers >= 0");
    *coefficients[k] = static_cast<float>(value);
  }
  const double condim = defaults.number(e, "condim", childclass, 3.0);
  if (condim != 1.0 && condim != 3.0 && condim != 4.0 && condim != 6.0)
    file.refuse(e, "condim: expected 1, 3, 4 or 6");
  if (condim == 1.0) cfg.mu = 0.0f;
  // As in MuJoCo, contacts of fewer than 4 dimensions have no torsional and rolling friction, and
  // those of 4 no rolling.
  if (condim < 4.0) cfg.mu_torsional = 0.0f;
  if (condim < 6.0) cfg.mu_rolling = 0.0f;
  const double margin = defaults.number(e, "margin", childclass, 0.0);
  if (margin < 0.0) file.refuse(e, "margin: expected >= 0");
  if (margin > 0.0) cfg.gap = static_cast<float>(margin);
  const double bits[] = {defaults.number(e, "contype", childclass, 1.0),
                         defaults.number(e, "conaffinity", childclass, 1.0)};
  for (const double value : bits)
    if (value < 0.0 || value > 2147483647.0 || value != std::floor(value))
      file.refuse(e, "contype, conaffinity: expected whole numbers from 0");
  shape.contype = static_cast<uint32_t>(bits[0]);
  shape.conaffinity = static_cast<uint32_t>(bits[1]);
  if (shape.contype == 0 && shape.conaffinity == 0)
    cfg.has_shape_collision = cfg.has_particle_collision = false;
  double rgba[4];
  if (defaults.numbers(e, "rgba", childclass, rgba))
    shape.color = Vec4f{static_cast<float>(rgba[0]), static_cast<float>(rgba[1]),
                        static_cast<float>(rgba[2]), static_cast<float>(rgba[3])};
  return shape;
}

}  // namespace novaphy::detail
