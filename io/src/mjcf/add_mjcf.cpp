// MJCF files become a Robot.
#include <algorithm>
#include <cmath>
#include <set>

#include "mjcf_defaults.h"
#include "mjcf_geom.h"

namespace novaphy {
namespace detail {
namespace {

constexpr std::string_view kJointRead[] = {
    "name",    "class",    "type",      "axis",      "pos",          "range", "limited",
    "damping", "armature", "stiffness", "springref", "frictionloss", "ref"};
constexpr std::string_view kJointPassedOver[] = {
    "margin", "solreflimit", "solimplimit", "solreffriction", "solimpfriction", "group", "user"};
constexpr std::string_view kMotorRead[] = {"name", "class",     "joint",
                                           "gear", "ctrlrange", "ctrllimited"};
constexpr std::string_view kMotorPassedOver[] = {"group", "user"};

struct Motor {
  const Element* element;
  std::string name, joint;
  double gear, lower, upper;
};

class Reader {
 public:
  Reader(const ModelBuilder& builder, const XmlFile& file)
      : builder_(builder), file_(file), defaults_(file) {}

  Robot run() {
    const Element& top = file_.root();
    if (const char* model = top.Attribute("model")) robot_.name = model;
    for (const Element* e = top.FirstChildElement(); e != nullptr; e = e->NextSiblingElement())
      read_section(*e);
    for (const Element* e = top.FirstChildElement("worldbody"); e != nullptr;
         e = e->NextSiblingElement("worldbody"))
      read_children(*e, kWorldLink, "", identity_pose());
    if (robot_.links.empty() && robot_.world_shapes.empty())
      file_.refuse(top, "expected a body or a geom in a <worldbody>, got none");
    for (const Element* e = top.FirstChildElement("contact"); e != nullptr;
         e = e->NextSiblingElement("contact"))
      read_contact(*e);
    for (const Element* e = top.FirstChildElement("actuator"); e != nullptr;
         e = e->NextSiblingElement("actuator"))
      read_actuators(*e);
    set_start();
    return std::move(robot_);
  }
  const std::vector<Motor>& motors() const { return motors_; }
  // Of each joint of the file: ours, and which of its degrees of freedom it is.
  const std::map<std::string, std::pair<int32_t, int32_t>>& dofs() const { return dofs_; }

 private:
  [[noreturn]] void not_read(const Element& e, const std::string& what) const {
    file_.refuse(e, what + " is not read", ErrorKind::NotImplemented);
  }
  bool flag(const Element& e, const char* name, const std::string& text) const {
    if (text != "true" && text != "false")
      file_.refuse(e, std::string(name) + ": expected true or false, got \"" + text + "\"");
    return text == "true";
  }

  void read_section(const Element& e) {
    const std::string_view kind = e.Name();
    if (kind == "compiler") return read_compiler(e);
    if (kind == "option") return read_option(e);
    for (const char* known : {"default", "worldbody", "contact", "actuator", "custom", "size",
                              "visual", "statistic", "asset", "sensor", "keyframe"})
      if (kind == known) return;
    not_read(e, "this element");
  }

  void read_compiler(const Element& e) {
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      const std::string value = a->Value();
      const auto only = [&](std::initializer_list<const char*> values) {
        for (const char* v : values)
          if (value == v) return;
        not_read(e, std::string(name) + "=\"" + value + "\"");
      };
      if (name == "angle") {
        only({"degree", "radian"});
        if (value == "radian") compiler_.angle = 1.0;
      } else if (name == "coordinate") {
        only({"local"});
      } else if (name == "eulerseq") {
        only({"xyz"});
      } else if (name == "autolimits") {
        compiler_.auto_limits = flag(e, "autolimits", value);
      } else if (name == "inertiafromgeom") {
        only({"true", "false", "auto"});
        compiler_.inertia_from_geom = value == "true"    ? MjcfCompiler::Inertia::Always
                                      : value == "false" ? MjcfCompiler::Inertia::Never
                                                         : MjcfCompiler::Inertia::Auto;
      } else if (name == "boundmass" || name == "boundinertia") {
        only({"0"});
      } else if (name == "settotalmass") {
        only({"-1"});
      } else if (name == "balanceinertia" || name == "fusestatic" || name == "discardvisual") {
        only({"false"});
      } else if (name != "strippath" && name != "meshdir" && name != "texturedir" &&
                 name != "assetdir" && name != "usethread") {
        not_read(e, std::string("the attribute ") + a->Name());
      }
    }
  }

  void read_option(const Element& e) {
    double v[3];
    if (file_.numbers(e, "gravity", v)) {
      const Vec3f& g = builder_.gravity;
      if (static_cast<float>(v[0]) != g.x || static_cast<float>(v[1]) != g.y ||
          static_cast<float>(v[2]) != g.z)
        file_.refuse(e, std::string("gravity: expected that of the builder (set "
                                    "builder.gravity), got \"") +
                            e.Attribute("gravity") + "\"");
    }
    for (const char* name : {"density", "viscosity"}) {
      double value[1] = {0.0};
      file_.numbers(e, name, value);
      if (value[0] != 0.0) not_read(e, std::string(name));
    }
    if (e.Attribute("wind") != nullptr) not_read(e, "wind");
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement())
      not_read(*c, "this element");
    std::string others;
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      if (name != "gravity" && name != "density" && name != "viscosity")
        others += std::string(" ") + a->Name();
    }
    if (!others.empty())
      robot_.warnings.push_back(file_.place(e) +
                                ": the step and the solver are those of the "
                                "simulation, not of the file:" +
                                others);
  }

  void read_children(const Element& e, int32_t link, const std::string& childclass,
                     const Posed& pose) {
    const bool has_inertial = e.FirstChildElement("inertial") != nullptr;
    const bool with_mass =
        compiler_.inertia_from_geom == MjcfCompiler::Inertia::Always ||
        (compiler_.inertia_from_geom == MjcfCompiler::Inertia::Auto && !has_inertial);
    size_t geoms = 0;
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      const std::string_view kind = c->Name();
      if (kind == "geom") {
        const std::string owner = link < 0 ? "world" : robot_.links[static_cast<size_t>(link)].name;
        const char* name = c->Attribute("name");
        const std::string label = name != nullptr ? name : owner + "/geom_" + std::to_string(geoms);
        ++geoms;
        RobotShape shape = read_geom(file_, defaults_, compiler_, *c, childclass,
                                     builder_.default_shape_cfg, label, with_mass && link >= 0);
        if (link < 0) {
          shape.pose = math::multiply(pose, shape.pose);
          robot_.world_shapes.push_back(std::move(shape));
        } else {
          robot_.links[static_cast<size_t>(link)].shapes.push_back(std::move(shape));
        }
      } else if (kind == "body") {
        read_body(*c, link, childclass);
      } else if (kind == "inertial" && link >= 0) {
        read_inertial(*c, robot_.links[static_cast<size_t>(link)]);
      } else if (kind != "camera" && kind != "light" && kind != "site" &&
                 !((kind == "joint" || kind == "freejoint") && link >= 0)) {
        not_read(*c, "this element");
      }
    }
  }

  void read_inertial(const Element& e, RobotLink& link) {
    if (compiler_.inertia_from_geom == MjcfCompiler::Inertia::Always) return;
    if (link.mass != 0.0) file_.refuse(e, "expected one <inertial>, got two");
    double v[6] = {};
    if (!file_.numbers(e, "pos", std::span(v).first(3))) file_.refuse(e, "pos: missing");
    link.com = {v[0], v[1], v[2]};
    if (!file_.numbers(e, "mass", std::span(v).first(1))) file_.refuse(e, "mass: missing");
    link.mass = v[0];
    if (!(link.mass > 0.0)) file_.refuse(e, "mass: expected > 0");
    Mat33d inertia{};
    if (file_.numbers(e, "diaginertia", std::span(v).first(3))) {
      inertia = {{{v[0], 0.0, 0.0}, {0.0, v[1], 0.0}, {0.0, 0.0, v[2]}}};
    } else if (file_.numbers(e, "fullinertia", v)) {
      inertia = {{{v[0], v[3], v[4]}, {v[3], v[1], v[5]}, {v[4], v[5], v[2]}}};
    } else {
      file_.refuse(e, "diaginertia, fullinertia: missing");
    }
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next())
      if (std::string_view name = a->Name(); name != "pos" && name != "mass" &&
                                             name != "diaginertia" && name != "fullinertia" &&
                                             name != "quat")
        not_read(e, std::string("the attribute ") + a->Name());
    Quatd q = {0.0, 0.0, 0.0, 1.0};
    if (file_.numbers(e, "quat", std::span(v).first(4))) {
      const double norm = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]);
      if (!(norm > 1e-10)) file_.refuse(e, "quat: expected numbers that are not all zero");
      q = {v[1] / norm, v[2] / norm, v[3] / norm, v[0] / norm};
    }
    link.inertia = turned(q, inertia);
  }

  std::string new_name(const Element& e, const std::string& by_default,
                       std::set<std::string>& taken) {
    const char* given = e.Attribute("name");
    std::string name = given != nullptr ? given : by_default;
    if (!taken.insert(name).second)
      file_.refuse(e, "name: expected different names, got \"" + name + "\" twice");
    return name;
  }

  void read_body(const Element& e, int32_t parent, const std::string& outer) {
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string_view name = a->Name();
      bool known = false;
      for (const std::string_view each :
           {"name", "pos", "quat", "axisangle", "euler", "zaxis", "xyaxes", "childclass", "user"})
        known = known || each == name;
      if (!known && !(name == "mocap" && std::string_view(a->Value()) == "false") &&
          !(name == "gravcomp" && std::string_view(a->Value()) == "0"))
        not_read(e, std::string("the attribute ") + a->Name());
    }
    const char* own = e.Attribute("childclass");
    const std::string childclass = own != nullptr ? own : outer;
    const auto index = static_cast<int32_t>(robot_.links.size());
    if (index >= 10000) file_.refuse(e, "expected at most 10000 bodies");
    const std::string name = new_name(e, "body_" + std::to_string(index), bodies_);
    robot_.links.push_back({.name = name, .where = file_.place(e)});
    Posed pose = identity_pose();
    double v[3];
    if (file_.numbers(e, "pos", v)) pose.p = {v[0], v[1], v[2]};
    pose.q = defaults_.orientation(e, "", compiler_);
    read_joints(e, parent, index, childclass, pose);
    read_children(e, index, childclass, identity_pose());
    const RobotLink& link = robot_.links[static_cast<size_t>(index)];
    const bool has_mass =
        link.mass > 0.0 || std::any_of(link.shapes.begin(), link.shapes.end(),
                                       [](const RobotShape& s) { return s.cfg.density > 0.0f; });
    const bool moves =
        robot_.joints[static_cast<size_t>(mover_.at(index))].type != JointType::FIXED;
    if (!has_mass && moves && e.FirstChildElement("body") == nullptr)
      file_.refuse(e, "expected a mass: an <inertial>, or a geom with a density");
  }

  void read_joints(const Element& e, int32_t parent, int32_t child, const std::string& childclass,
                   const Posed& pose) {
    std::vector<const Element*> found;
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement())
      if (std::string_view(c->Name()) == "joint" || std::string_view(c->Name()) == "freejoint")
        found.push_back(c);
    const std::string body = robot_.links[static_cast<size_t>(child)].name;
    RobotJoint joint{.name = body + "_fixed",
                     .where = file_.place(e),
                     .type = JointType::FIXED,
                     .parent = parent,
                     .child = child,
                     .parent_pose = pose,
                     .child_pose = identity_pose()};
    std::vector<std::string> names;
    std::optional<Vec3d> anchor;
    for (const Element* c : found)
      read_joint(*c, e, childclass, found.size(), joint, names, anchor);
    if (joint.linear.size() + joint.angular.size() == 1)
      joint.type = joint.linear.empty() ? JointType::REVOLUTE : JointType::PRISMATIC;
    else if (!joint.linear.empty() || !joint.angular.empty())
      joint.type = JointType::D6;
    if (joint.linear.size() > 3 || joint.angular.size() > 3)
      not_read(e, "a body with more than three slides or three hinges");
    if (anchor) {
      const Posed at = {*anchor, {0.0, 0.0, 0.0, 1.0}};
      joint.parent_pose = math::multiply(pose, at);
      joint.child_pose = at;
    }
    if (found.empty() && !joints_.insert(joint.name).second)
      file_.refuse(e, "name: a joint has the name \"" + joint.name + "\"");
    if (!names.empty()) {
      joint.name = names.front();
      for (size_t k = 1; k < names.size(); ++k) joint.name += "+" + names[k];
    }
    const auto index = static_cast<int32_t>(robot_.joints.size());
    for (size_t k = 0; k < names.size(); ++k) dofs_[names[k]] = {index, static_cast<int32_t>(k)};
    mover_[child] = index;
    joint.start.assign(joint.linear.size() + joint.angular.size(), 0.0);
    robot_.joints.push_back(std::move(joint));
  }

  void read_joint(const Element& e, const Element& body, const std::string& childclass,
                  size_t count, RobotJoint& to, std::vector<std::string>& names,
                  std::optional<Vec3d>& anchor) {
    const bool is_free_joint = std::string_view(e.Name()) == "freejoint";
    const std::string name = new_name(
        e, to.name.substr(0, to.name.size() - 6) + "_joint_" + std::to_string(names.size()),
        joints_);
    names.push_back(name);
    std::string type = "free";
    if (!is_free_joint) {
      defaults_.check_known(e, childclass, kJointRead, kJointPassedOver);
      type = defaults_.text(e, "type", childclass).value_or("hinge");
    }
    if (type == "free" || type == "ball") {
      if (count > 1) not_read(body, "a " + type + " joint with other joints");
      to.type = type == "free" ? JointType::FREE : JointType::BALL;
      if (type == "free" && to.parent >= 0)
        file_.refuse(e, "expected a free joint of a body in the world, got one below");
      if (is_free_joint) return;
      // The defaults of hinges do not apply to what has no such numbers: those are its own only.
      for (const char* each : {"damping", "stiffness", "frictionloss", "armature"})
        if (defaults_.number(e, each, childclass, 0.0) != 0.0)
          not_read(e, std::string(each) + " of a " + type + " joint");
      const auto limited = defaults_.text(e, "limited", childclass).value_or("false");
      if (type == "ball" && (limited == "true" || e.Attribute("range") != nullptr))
        not_read(e, "range of a ball joint");
      double v[3];
      if (type == "ball" && defaults_.numbers(e, "pos", childclass, v))
        anchor = Vec3d{v[0], v[1], v[2]};
      return;
    }
    if (type != "hinge" && type != "slide")
      file_.refuse(e, "type: expected hinge, slide, ball or free, got \"" + type + "\"");
    const bool is_hinge = type == "hinge";
    if (!is_hinge && !to.angular.empty()) not_read(e, "a slide after a hinge of one body");
    const double unit = is_hinge ? compiler_.angle : 1.0;
    double v[3] = {0.0, 0.0, 0.0};
    defaults_.numbers(e, "pos", childclass, v);
    const Vec3d at = {v[0], v[1], v[2]};
    if (anchor && (anchor->x != at.x || anchor->y != at.y || anchor->z != at.z))
      not_read(e, "a second joint of one body at another pos");
    anchor = at;
    double axis[3] = {0.0, 0.0, 1.0};
    defaults_.numbers(e, "axis", childclass, axis);
    const double length = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    if (!(length > 1e-6)) file_.refuse(e, "axis: expected a vector that is not zero");
    JointDofConfig dof = builder_.default_joint_cfg;
    dof.axis = to_float(Vec3d{axis[0] / length, axis[1] / length, axis[2] / length});
    double range[2] = {0.0, 0.0};
    const bool has_range = defaults_.numbers(e, "range", childclass, range);
    const std::string limited = defaults_.text(e, "limited", childclass).value_or("auto");
    const bool is_limited =
        limited == "auto" ? compiler_.auto_limits && has_range : flag(e, "limited", limited);
    if (limited == "auto" && has_range && !compiler_.auto_limits)
      file_.refuse(e,
                   "limited: expected true or false, where the compiler has autolimits=\"false\"");
    if (is_limited) {
      if (!has_range || !(range[0] < range[1]))
        file_.refuse(e, "range: expected two numbers, the lower one first");
      dof.limit_lower = static_cast<float>(range[0] * unit);
      dof.limit_upper = static_cast<float>(range[1] * unit);
    }
    const auto not_negative = [&](const char* attribute, double by_default) {
      const double value = defaults_.number(e, attribute, childclass, by_default);
      if (value < 0.0) file_.refuse(e, std::string(attribute) + ": expected >= 0");
      return static_cast<float>(value);
    };
    dof.damping = not_negative("damping", 0.0);
    dof.armature = not_negative("armature", 0.0);
    dof.friction = not_negative("frictionloss", 0.0);
    const float stiffness = not_negative("stiffness", 0.0);
    if (stiffness > 0.0f) {
      dof.target_ke = stiffness;
      dof.target_q = static_cast<float>(defaults_.number(e, "springref", childclass, 0.0) * unit);
    }
    if (defaults_.number(e, "ref", childclass, 0.0) != 0.0) not_read(e, "ref");
    (is_hinge ? to.angular : to.linear).push_back(dof);
  }

  void read_contact(const Element& e) {
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      if (std::string_view(c->Name()) != "exclude") not_read(*c, "this element");
      int32_t ends[2];
      const char* const names[] = {c->Attribute("body1"), c->Attribute("body2")};
      for (int k = 0; k < 2; ++k) {
        if (names[k] == nullptr) file_.refuse(*c, "body1, body2: missing");
        const std::string name = names[k];
        const auto found = std::find_if(robot_.links.begin(), robot_.links.end(),
                                        [&](const RobotLink& link) { return link.name == name; });
        if (found == robot_.links.end() && name != "world")
          file_.refuse(*c, "there is no body \"" + name + "\"");
        ends[k] = name == "world" ? kWorldLink : static_cast<int32_t>(found - robot_.links.begin());
      }
      robot_.excluded.emplace_back(ends[0], ends[1]);
    }
  }

  void read_actuators(const Element& e) {
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      if (std::string_view(c->Name()) != "motor") not_read(*c, "this element (<motor> is)");
      defaults_.check_known(*c, "", kMotorRead, kMotorPassedOver);
      const auto joint = defaults_.text(*c, "joint", "");
      if (!joint) file_.refuse(*c, "joint: missing");
      if (!dofs_.contains(*joint)) file_.refuse(*c, "there is no joint \"" + *joint + "\"");
      const RobotJoint& moved = robot_.joints[static_cast<size_t>(dofs_.at(*joint).first)];
      if (moved.linear.empty() && moved.angular.empty()) not_read(*c, "a motor of such a joint");
      std::vector<double> gear = defaults_.list(*c, "gear", "");
      if (gear.empty()) gear = {1.0};
      for (size_t k = 1; k < gear.size(); ++k)
        if (gear[k] != 0.0) not_read(*c, "gear with more than one number");
      double range[2] = {-1e10, 1e10};
      const bool has_range = defaults_.numbers(*c, "ctrlrange", "", range);
      const auto limited = defaults_.text(*c, "ctrllimited", "").value_or("auto");
      const bool is_limited =
          limited == "auto" ? compiler_.auto_limits && has_range : flag(*c, "ctrllimited", limited);
      if (is_limited && !(has_range && range[0] < range[1]))
        file_.refuse(*c, "ctrlrange: expected two numbers, the lower one first");
      if (!is_limited) range[0] = -1e10, range[1] = 1e10;
      motors_.push_back(
          {c, new_name(*c, *joint + "_motor", motor_names_), *joint, gear[0], range[0], range[1]});
    }
  }

  // <custom><numeric name="init_qpos">: the start of the joints, a free root first, in the order
  // of the file: position, quaternion w x y z.
  void set_start() {
    const Element* custom = file_.root().FirstChildElement("custom");
    for (; custom != nullptr; custom = custom->NextSiblingElement("custom"))
      for (const Element* e = custom->FirstChildElement("numeric"); e != nullptr;
           e = e->NextSiblingElement("numeric")) {
        const char* name = e->Attribute("name");
        if (name == nullptr || std::string_view(name) != "init_qpos") continue;
        const char* data = e->Attribute("data");
        if (data == nullptr) file_.refuse(*e, "data: missing");
        set_start(*e, file_.parse(*e, "data", data));
      }
  }
  void set_start(const Element& e, const std::vector<double>& q) {
    size_t at = 0;
    const auto next = [&] { return at < q.size() ? q[at++] : (++at, 0.0); };
    for (RobotJoint& joint : robot_.joints) {
      if (joint.type == JointType::BALL)
        file_.refuse(e, "init_qpos with a ball joint is not read", ErrorKind::NotImplemented);
      if (joint.type == JointType::FREE) {
        Vec3d p;
        p.x = next(), p.y = next(), p.z = next();
        Quatd turned_by;
        turned_by.w = next(), turned_by.x = next(), turned_by.y = next(), turned_by.z = next();
        const double norm = std::sqrt(turned_by.w * turned_by.w + turned_by.x * turned_by.x +
                                      turned_by.y * turned_by.y + turned_by.z * turned_by.z);
        if (!(norm > 1e-10)) file_.refuse(e, "data: expected a quaternion of the free joint");
        joint.parent_pose = {
            p, {turned_by.x / norm, turned_by.y / norm, turned_by.z / norm, turned_by.w / norm}};
      }
      for (double& start : joint.start) start = next();
    }
    if (at != q.size())
      file_.refuse(
          e, "data: expected " + std::to_string(at) + " numbers, got " + std::to_string(q.size()));
  }

  const ModelBuilder& builder_;
  const XmlFile& file_;
  MjcfDefaults defaults_;
  MjcfCompiler compiler_;
  Robot robot_;
  std::set<std::string> bodies_, joints_, motor_names_;
  std::map<int32_t, int32_t> mover_;  // of each link: its joint
  std::map<std::string, std::pair<int32_t, int32_t>> dofs_;
  std::vector<Motor> motors_;
};

}  // namespace
}  // namespace detail

RobotImport add_mjcf(ModelBuilder& builder, std::string_view source, const MjcfOptions& options) {
  constexpr std::string_view name = "add_mjcf";
  require(builder.up_axis() == Axis::Z, ErrorKind::Value, name,
          ": expected a builder whose up axis is z, as that of MJCF files");
  const detail::XmlFile file(name, detail::read_source(name, source, {}), "mujoco");
  detail::Reader reader(builder, file);
  detail::Robot robot = reader.run();
  std::vector<std::string> joints;
  for (const detail::RobotJoint& joint : robot.joints) joints.push_back(joint.name);
  RobotImport result = detail::emit_robot(builder, std::move(robot),
                                          {.function = name,
                                           .xform = detail::to_double(options.xform),
                                           .parent_body = -1,
                                           .collapse = options.collapse_fixed_joints,
                                           .self_collisions = options.enable_self_collisions,
                                           .bodies_follow = true,
                                           .ordering = JointOrdering::DepthFirst,
                                           .pairs_of_mujoco = true,
                                           .filter_overlaps = options.filter_overlaps});
  // Hinges and slides of one body are one joint of several degrees of freedom.
  for (const auto& [joint, place] : reader.dofs()) {
    const std::string& whole = joints[static_cast<size_t>(place.first)];
    result.joints[joint] = result.joints.at(whole);
    result.joint_dofs[joint] = result.joint_dofs.at(whole) + place.second;
    result.joint_coords[joint] = result.joint_coords.at(whole) + place.second;
  }
  for (const detail::Motor& motor : reader.motors())
    result.actuators.push_back({motor.name, motor.joint, result.joint_dofs.at(motor.joint),
                                static_cast<float>(motor.gear), static_cast<float>(motor.lower),
                                static_cast<float>(motor.upper)});
  return result;
}

}  // namespace novaphy
