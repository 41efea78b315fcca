#include "mjcf_defaults.h"

#include <algorithm>
#include <cmath>

namespace novaphy::detail {
namespace {

constexpr std::string_view kActuators[] = {"general",     "motor",  "position", "velocity",
                                           "intvelocity", "damper", "cylinder", "muscle",
                                           "adhesion",    "plugin", "dcmotor"};

Vec3d unit(const XmlFile& file, const Element& e, const char* attribute, const Vec3d& v) {
  const double length = std::sqrt(math::dot(v, v));
  if (!(length > 1e-10))
    file.refuse(e, std::string(attribute) + ": expected a vector that is not zero");
  return v / length;
}

// Returns the rotation whose matrix has x as its first and z as its last column.
Quatd from_columns(const Vec3d& x, const Vec3d& z) {
  const Quatd first = turn_from_z(z);
  const Vec3d turned_x = math::rotate(first, Vec3d{1.0, 0.0, 0.0});
  const double angle = std::atan2(math::dot(math::cross(turned_x, x), z), math::dot(turned_x, x));
  return math::multiply(turn(z, angle), first);
}

}  // namespace

MjcfDefaults::MjcfDefaults(const XmlFile& file) : file_(file) {
  classes_["main"];
  for (const Element* e = file.root().FirstChildElement("default"); e != nullptr;
       e = e->NextSiblingElement("default"))
    read(*e, "");
}

void MjcfDefaults::read(const Element& e, const std::string& parent) {
  const char* given = e.Attribute("class");
  if (given == nullptr && !parent.empty()) file_.refuse(e, "class: expected a name, got none");
  // The outermost class has the defaults of all elements, whatever its name is.
  const std::string name = parent.empty() ? "main" : given;
  if (!parent.empty() && !classes_.emplace(name, classes_.at(parent)).second)
    file_.refuse(e, "class: expected different names, got \"" + name + "\" twice");
  Class& to = classes_.at(name);
  if (!parent.empty() || to.actuators.empty()) to.actuators.emplace_back();
  for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
    const std::string_view kind = c->Name();
    if (kind == "default") continue;
    if (std::find(std::begin(kActuators), std::end(kActuators), kind) != std::end(kActuators))
      to.actuators.back().push_back(c);
    for (const auto* a = c->FirstAttribute(); a != nullptr; a = a->Next())
      to.elements[c->Name()][a->Name()] = a->Value();
  }
  for (const Element* c = e.FirstChildElement("default"); c != nullptr;
       c = c->NextSiblingElement("default"))
    read(*c, name);
  if (parent.empty() && given != nullptr && name != given)
    classes_.insert_or_assign(given, classes_.at(name));
}

const MjcfDefaults::Class& MjcfDefaults::class_of(const Element& e,
                                                  const std::string& childclass) const {
  const char* own = e.Attribute("class");
  const std::string name = own != nullptr ? own : childclass.empty() ? "main" : childclass;
  const auto found = classes_.find(name);
  if (found == classes_.end()) file_.refuse(e, "class: there is no default class \"" + name + "\"");
  return found->second;
}

const MjcfDefaults::Attributes* MjcfDefaults::of_class(const Element& e,
                                                       const std::string& childclass) const {
  const Class& in = class_of(e, childclass);
  const Element* const around = e.Parent() == nullptr ? nullptr : e.Parent()->ToElement();
  const std::string_view section = around == nullptr ? "" : around->Name();
  if (section == "spatial" || section == "fixed") return nullptr;  // parts of a tendon
  const bool is_of_section = section == "equality" || section == "tendon";
  const auto element = in.elements.find(std::string(is_of_section ? section : e.Name()));
  return element == in.elements.end() ? nullptr : &element->second;
}

const MjcfDefaults::ActuatorClasses& MjcfDefaults::actuators(const Element& e) const {
  return class_of(e, {}).actuators;
}

std::optional<std::string> MjcfDefaults::actuator_text(const Element& e,
                                                       const char* attribute) const {
  if (const char* own = e.Attribute(attribute)) return own;
  std::optional<std::string> value;
  for (const auto& of_class : actuators(e))
    for (const Element* each : of_class)
      if (const char* given = each->Attribute(attribute)) value = given;
  return value;
}

std::optional<std::string> MjcfDefaults::text(const Element& e, const char* attribute,
                                              const std::string& childclass) const {
  if (const char* own = e.Attribute(attribute)) return own;
  const Attributes* attributes = of_class(e, childclass);
  if (attributes == nullptr) return {};
  const auto found = attributes->find(attribute);
  return found == attributes->end() ? std::nullopt : std::optional(found->second);
}

std::vector<double> MjcfDefaults::list(const Element& e, const char* attribute,
                                       const std::string& childclass) const {
  const auto given = text(e, attribute, childclass);
  return given ? file_.parse(e, attribute, *given) : std::vector<double>{};
}

bool MjcfDefaults::numbers(const Element& e, const char* attribute, const std::string& childclass,
                           std::span<double> out) const {
  const auto given = text(e, attribute, childclass);
  if (!given) return false;
  const std::vector<double> values = file_.parse(e, attribute, *given);
  if (values.size() != out.size())
    file_.refuse(e, std::string(attribute) + ": expected " + std::to_string(out.size()) +
                        " number(s), got \"" + *given + "\"");
  std::copy(values.begin(), values.end(), out.begin());
  return true;
}

double MjcfDefaults::number(const Element& e, const char* attribute, const std::string& childclass,
                            double by_default) const {
  double value[1] = {by_default};
  numbers(e, attribute, childclass, value);
  return value[0];
}

void MjcfDefaults::check_known(const Element& e, const std::string& childclass,
                               std::span<const std::string_view> read,
                               std::span<const std::string_view> passed_over) const {
  const auto check = [&](const std::string& name) {
    for (const auto& known : {read, passed_over})
      if (std::find(known.begin(), known.end(), name) != known.end()) return;
    file_.refuse(e, "the attribute " + name + " is not read", ErrorKind::NotImplemented);
  };
  for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) check(a->Name());
  if (const Attributes* attributes = of_class(e, childclass))
    for (const auto& [name, value] : *attributes) check(name);
}

Quatd MjcfDefaults::orientation(const Element& e, const std::string& childclass,
                                const MjcfCompiler& compiler) const {
  const auto ways = {"axisangle", "euler", "zaxis", "xyaxes"};
  if (std::count_if(ways.begin(), ways.end(), [&](auto* way) { return e.Attribute(way); }) > 1)
    file_.refuse(e, "expected one orientation, got several of axisangle, euler, zaxis, xyaxes");
  double v[6];
  const auto three = std::span(v).first(3), four = std::span(v).first(4);
  if (numbers(e, "axisangle", childclass, four))
    return turn(unit(file_, e, "axisangle", {v[0], v[1], v[2]}), v[3] * compiler.angle);
  if (numbers(e, "euler", childclass, three)) return euler_turn({v[0], v[1], v[2]}, compiler);
  if (numbers(e, "zaxis", childclass, three))
    return turn_from_z(unit(file_, e, "zaxis", {v[0], v[1], v[2]}));
  if (numbers(e, "xyaxes", childclass, v)) {
    const Vec3d x = unit(file_, e, "xyaxes", {v[0], v[1], v[2]});
    const Vec3d given = {v[3], v[4], v[5]};
    const Vec3d y = unit(file_, e, "xyaxes", given - x * math::dot(x, given));
    return from_columns(x, math::cross(x, y));
  }
  if (numbers(e, "quat", childclass, four)) {
    const double norm = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]);
    if (!(norm > 1e-10)) file_.refuse(e, "quat: expected numbers that are not all zero");
    return {v[1] / norm, v[2] / norm, v[3] / norm, v[0] / norm};
  }
  return {0.0, 0.0, 0.0, 1.0};
}

Quatd euler_turn(const Vec3d& angles, const MjcfCompiler& compiler) {
  Quatd q = {0.0, 0.0, 0.0, 1.0};
  const double values[] = {angles.x, angles.y, angles.z};
  for (size_t k = 0; k < 3; ++k) {
    const char letter = compiler.euler[k];
    const bool stays = letter <= 'Z';
    const int axis = letter - (stays ? 'X' : 'x');
    const Quatd one = turn({axis == 0 ? 1.0 : 0.0, axis == 1 ? 1.0 : 0.0, axis == 2 ? 1.0 : 0.0},
                           values[k] * compiler.angle);
    q = stays ? math::multiply(one, q) : math::multiply(q, one);
  }
  return q;
}

}  // namespace novaphy::detail
