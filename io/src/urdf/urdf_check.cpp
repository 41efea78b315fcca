#include "urdf_check.h"

#include <algorithm>
#include <array>
#include <set>

namespace novaphy::detail {
namespace {

constexpr size_t kMostLinks = 10000;

enum class Sign { Any, NotNegative, Positive, Unit };  // Unit: in [0, 1]

// An attribute of an element, with the number of its values and their allowed signs.
struct Rule {
  const char* element;
  const char* attribute;
  size_t count;
  bool needed;
  Sign sign = Sign::Any;
};
constexpr Rule kRules[] = {
    {"origin", "xyz", 3, false},
    {"origin", "rpy", 3, false},
    {"mass", "value", 1, true, Sign::NotNegative},
    {"inertia", "ixx", 1, true},
    {"inertia", "iyy", 1, true},
    {"inertia", "izz", 1, true},
    {"inertia", "ixy", 1, true},
    {"inertia", "ixz", 1, true},
    {"inertia", "iyz", 1, true},
    {"box", "size", 3, true, Sign::Positive},
    {"cylinder", "radius", 1, true, Sign::Positive},
    {"cylinder", "length", 1, true, Sign::Positive},
    {"sphere", "radius", 1, true, Sign::Positive},
    {"mesh", "scale", 3, false},
    {"color", "rgba", 4, true, Sign::Unit},
    {"axis", "xyz", 3, true},
    {"limit", "lower", 1, false},
    {"limit", "upper", 1, false},
    {"limit", "effort", 1, true, Sign::NotNegative},
    {"limit", "velocity", 1, true, Sign::NotNegative},
    {"dynamics", "damping", 1, false, Sign::NotNegative},
    {"dynamics", "friction", 1, false, Sign::NotNegative},
    {"mimic", "multiplier", 1, false},
    {"mimic", "offset", 1, false},
};

class Checker {
 public:
  Checker(const XmlFile& file, Notes& notes) : file_(file), notes_(notes) {}

  UrdfElements run() {
    const Element& robot = file_.root();
    if (const char* version = robot.Attribute("version"))
      if (std::string_view(version) != "1.0")
        file_.refuse(robot, std::string("version: expected 1.0, got \"") + version + "\"",
                     ErrorKind::NotImplemented);
    name_of(robot);
    for (const Element* e = robot.FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
      const std::string_view kind = e->Name();
      if (kind == "link") {
        add(*e, found_.links, found_.link_order);
        if (found_.links.size() > kMostLinks)
          file_.refuse(*e, "expected at most " + std::to_string(kMostLinks) + " links");
        check_link(*e);
      } else if (kind == "joint") {
        add(*e, found_.joints, found_.joint_order);
        check_joint(*e);
      } else if (kind == "material") {
        check_material(*e);
      } else {
        passed_over(*e);
      }
    }
    if (found_.links.empty()) file_.refuse(robot, "expected a <link>, got none");
    check_tree();
    return std::move(found_);
  }

 private:
  void passed_over(const Element& e) {
    // Each unknown tag is noted once.
    if (seen_.insert(e.Name()).second)
      notes_.ignored(e, std::string("not read: <") + e.Name() + "> is no part of it");
  }

  std::string name_of(const Element& e) const {
    const char* name = e.Attribute("name");
    if (name == nullptr || *name == '\0') file_.refuse(e, "name: expected a name, got none");
    return name;
  }

  void add(const Element& e, std::map<std::string, const Element*>& to,
           std::vector<std::string>& order) {
    const std::string name = name_of(e);
    const auto [at, is_new] = to.emplace(name, &e);
    if (!is_new)
      file_.refuse(e, "expected different names, got one of line " +
                          std::to_string(at->second->GetLineNum()));
    order.push_back(name);
  }

  // Checks the numbers of an element, and that all its attributes are numbers of kRules or in
  // `texts`.
  void check_numbers(const Element& e, std::initializer_list<std::string_view> texts = {}) {
    for (const Rule& rule : kRules) {
      if (std::string_view(e.Name()) != rule.element) continue;
      std::array<double, 6> values{};
      const auto used = std::span(values).first(rule.count);
      if (!file_.numbers(e, rule.attribute, used)) {
        if (rule.needed) file_.refuse(e, std::string(rule.attribute) + ": missing");
        continue;
      }
      for (const double v : used)
        if ((rule.sign == Sign::Positive && !(static_cast<float>(v) > 0.0f)) ||
            ((rule.sign == Sign::NotNegative || rule.sign == Sign::Unit) && v < 0.0) ||
            (rule.sign == Sign::Unit && v > 1.0))
          file_.refuse(e, std::string(rule.attribute) + ": expected " +
                              (rule.sign == Sign::Positive ? "> 0"
                               : rule.sign == Sign::Unit   ? "0 to 1"
                                                           : ">= 0") +
                              ", got \"" + e.Attribute(rule.attribute) + "\"");
    }
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      const bool known =
          std::find(texts.begin(), texts.end(), name) != texts.end() ||
          std::any_of(std::begin(kRules), std::end(kRules), [&](const Rule& rule) {
            return rule.attribute == name && std::string_view(e.Name()) == rule.element;
          });
      if (!known && seen_.insert(std::string(e.Name()) + "." + a->Name()).second)
        notes_.ignored(e, std::string("not read: the attribute ") + a->Name());
    }
  }

  // Calls visit(child) for each child element. Elements with a name in `single` may occur only
  // once.
  template <class Visit>
  void children(const Element& e, std::initializer_list<const char*> single, Visit&& visit) {
    for (const char* name : single) file_.only(e, name);
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement())
      if (!visit(*c, std::string_view(c->Name()))) passed_over(*c);
  }

  void check_link(const Element& link) {
    children(link, {"inertial"}, [&](const Element& part, std::string_view kind) {
      if (kind == "inertial") {
        check_inertial(part);
      } else if (kind == "visual" || kind == "collision") {
        check_shape(part);
      } else {
        return false;
      }
      return true;
    });
  }

  void check_inertial(const Element& e) {
    for (const char* needed : {"mass", "inertia"})
      if (file_.only(e, needed) == nullptr)
        file_.refuse(e, std::string("expected a <") + needed + ">, got none");
    children(e, {"origin"}, [&](const Element& part, std::string_view kind) {
      if (kind != "origin" && kind != "mass" && kind != "inertia") return false;
      check_numbers(part);
      return true;
    });
  }

  void check_shape(const Element& e) {
    const Element* const geometry = file_.only(e, "geometry");
    if (geometry == nullptr) file_.refuse(e, "expected a <geometry>, got none");
    children(e, {"origin", "material"}, [&](const Element& part, std::string_view kind) {
      if (kind == "origin") check_numbers(part);
      if (kind == "material") check_material(part);
      return kind == "origin" || kind == "geometry" || kind == "material";
    });
    const Element* const shape = geometry->FirstChildElement();
    if (shape == nullptr) file_.refuse(*geometry, "expected a shape, got none");
    if (shape->NextSiblingElement() != nullptr)
      file_.refuse(*shape->NextSiblingElement(), "expected one shape in a <geometry>, got two");
    const std::string_view kind = shape->Name();
    if (kind == "mesh") {
      const char* name = shape->Attribute("filename");
      if (name == nullptr || *name == '\0') file_.refuse(*shape, "filename: missing");
      check_numbers(*shape, {"filename"});
    } else if (kind == "box" || kind == "cylinder" || kind == "sphere") {
      check_numbers(*shape);
    } else {
      file_.refuse(*shape, "expected <box>, <cylinder>, <sphere> or <mesh>",
                   ErrorKind::NotImplemented);
    }
  }

  void check_material(const Element& e) {
    children(e, {"color", "texture"}, [&](const Element& part, std::string_view kind) {
      if (kind == "color") check_numbers(part);
      return kind == "color";
    });
  }

  std::string link_of(const Element& joint, const char* end) {
    const Element* const e = file_.only(joint, end);
    if (e == nullptr) file_.refuse(joint, std::string("expected a <") + end + ">, got none");
    const char* name = e->Attribute("link");
    if (name == nullptr || *name == '\0') file_.refuse(*e, "link: missing");
    return name;
  }

  void check_joint(const Element& joint) {
    const char* given = joint.Attribute("type");
    const std::string_view type = given == nullptr ? "" : given;
    const bool has_limits = type == "revolute" || type == "prismatic";
    if (!has_limits && type != "continuous" && type != "fixed" && type != "floating" &&
        type != "planar")
      file_.refuse(joint,
                   "type: expected revolute, prismatic, continuous, fixed, floating or "
                   "planar, got \"" +
                       std::string(type) + "\"");
    children(joint, {"origin", "axis", "limit", "dynamics", "mimic"},
             [&](const Element& part, std::string_view kind) {
               if (kind == "parent" || kind == "child") return true;
               if (kind == "mimic") {
                 if (part.Attribute("joint") == nullptr) file_.refuse(part, "joint: missing");
                 check_numbers(part, {"joint"});
                 return true;
               }
               if (kind != "origin" && kind != "axis" && kind != "limit" && kind != "dynamics")
                 return false;
               check_numbers(part);
               return true;
             });
    if (const Element* axis = joint.FirstChildElement("axis")) {
      double v[3];
      file_.numbers(*axis, "xyz", v);
      const double length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
      if (!(length > 1e-6) && type != "fixed" && type != "floating")
        file_.refuse(*axis, "xyz: expected a vector that is not zero");
    }
    const Element* const limit = joint.FirstChildElement("limit");
    if (has_limits && limit == nullptr) file_.refuse(joint, "expected a <limit>, got none");
    if (limit != nullptr) {
      double lower[1] = {0.0}, upper[1] = {0.0};
      file_.numbers(*limit, "lower", lower);
      file_.numbers(*limit, "upper", upper);
      if (lower[0] > upper[0])
        file_.refuse(*limit, "lower, upper: expected the lower one first, got \"" +
                                 std::to_string(lower[0]) + "\" and \"" + std::to_string(upper[0]) +
                                 "\"");
    }
  }

  void check_tree() {
    std::map<std::string, const Element*> parent;  // joint whose child is the link
    std::map<std::string, std::vector<std::string>> below;
    for (const std::string& name : found_.joint_order) {
      const Element& joint = *found_.joints.at(name);
      const std::string from = link_of(joint, "parent"), to = link_of(joint, "child");
      for (const std::string& link : {from, to})
        if (!found_.links.contains(link)) file_.refuse(joint, "there is no link \"" + link + "\"");
      const auto [at, is_new] = parent.emplace(to, &joint);
      if (!is_new)
        file_.refuse(joint, "expected one parent of the link \"" + to +
                                "\", which has one already: " + file_.place(*at->second));
      below[from].push_back(to);
      if (const Element* mimic = joint.FirstChildElement("mimic"))
        if (!found_.joints.contains(mimic->Attribute("joint")))
          file_.refuse(*mimic,
                       std::string("there is no joint \"") + mimic->Attribute("joint") + "\"");
    }
    for (const std::string& link : found_.link_order) {
      if (parent.contains(link)) continue;
      if (!found_.root.empty())
        file_.refuse(*found_.links.at(link),
                     "expected one root, a link that is the child of no "
                     "joint, got \"" +
                         found_.root + "\" and \"" + link + "\"");
      found_.root = link;
    }
    if (found_.root.empty())
      file_.refuse(file_.root(),
                   "expected a link that is the child of no joint: the joints are a "
                   "cycle");
    std::vector<std::string> waiting = {found_.root};
    std::set<std::string> reached;
    while (!waiting.empty()) {
      const std::string link = waiting.back();
      waiting.pop_back();
      reached.insert(link);
      for (const std::string& next : below[link]) waiting.push_back(next);
    }
    for (const std::string& link : found_.link_order)
      if (!reached.contains(link))
        file_.refuse(*found_.links.at(link),
                     "expected a link that joints connect with the root "
                     "\"" +
                         found_.root + "\": it is in a cycle");
  }

  const XmlFile& file_;
  Notes& notes_;
  UrdfElements found_;
  std::set<std::string> seen_;
};

}  // namespace

UrdfElements check_urdf(const XmlFile& file, Notes& notes) { return Checker(file, notes).run(); }

}  // namespace novaphy::detail
