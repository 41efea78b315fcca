// Reads joints of MJCF files.
#include <algorithm>
#include <cmath>

#include "mjcf_bodies.h"

namespace novaphy::detail {
namespace {

constexpr std::string_view kRead[] = {"name",
                                      "class",
                                      "type",
                                      "axis",
                                      "pos",
                                      "range",
                                      "limited",
                                      "damping",
                                      "armature",
                                      "stiffness",
                                      "springref",
                                      "frictionloss",
                                      "ref",
                                      "springdamper",
                                      "actuatorfrcrange",
                                      "actuatorfrclimited"};
constexpr std::string_view kPassedOver[] = {"margin",         "solreflimit",      "solimplimit",
                                            "solreffriction", "solimpfriction",   "group",
                                            "user",           "actuatorgravcomp", "align"};

// Returns whether unit axes are linearly independent, by the volume of three axes or the area of
// two.
bool are_independent(const std::vector<Vec3d>& axes) {
  if (axes.size() < 2) return true;
  const Vec3d n = math::cross(axes[0], axes[1]);
  const double size =
      axes.size() == 2 ? std::sqrt(math::dot(n, n)) : std::abs(math::dot(n, axes[2]));
  return axes.size() <= 3 && size > 1e-2;
}

}  // namespace

BodyJoints::BodyJoints(MjcfContext& context, const Element& body, const BodyPart& outer,
                       std::string childclass, std::string name)
    : context_(context), body_(body), outer_(outer), name_(std::move(name)) {
  collect(body, identity_pose(), childclass);
}

void BodyJoints::collect(const Element& e, const Posed& frame, const std::string& childclass) {
  for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
    const std::string_view kind = c->Name();
    if (kind == "joint" || kind == "freejoint") found_.push_back({c, frame, childclass});
    if (kind != "frame") continue;
    Posed inside = identity_pose();
    double v[3];
    if (context_.file.numbers(*c, "pos", v)) inside.p = {v[0], v[1], v[2]};
    inside.q = context_.defaults.orientation(*c, {}, context_.settings.compiler);
    const char* own = c->Attribute("childclass");
    collect(*c, math::multiply(frame, inside), own == nullptr ? childclass : own);
  }
}

int32_t BodyJoints::add(const Posed& pose, bool is_mocap) {
  pose_ = pose;
  parent_ = outer_.link;
  is_mocap_ = is_mocap;
  if (is_mocap && (parent_ >= 0 || !found_.empty()))
    context_.file.refuse(body_, "mocap: expected a body in the world without joints");
  if (found_.empty()) {
    add_joint(name_ + (is_mocap ? "_mocap" : "_fixed"), body_,
              is_mocap ? JointType::FREE : JointType::FIXED, true);
    return parent_;
  }
  std::vector<Scalar> group;
  const auto end_group = [&] {
    if (!group.empty()) add_group(group);
    group.clear();
  };
  for (size_t k = 0; k < found_.size(); ++k) {
    const Found& found = found_[k];
    const bool is_free_joint = std::string_view(found.element->Name()) == "freejoint";
    if (!is_free_joint)
      context_.defaults.check_known(*found.element, found.childclass, kRead, kPassedOver);
    const std::string type =
        is_free_joint
            ? "free"
            : context_.defaults.text(*found.element, "type", found.childclass).value_or("hinge");
    if (type != "hinge" && type != "slide") {
      end_group();
      add_ball(found, type);
      continue;
    }
    Scalar next = read_scalar(found, type == "hinge");
    std::vector<Vec3d> axes;
    bool fits = true;
    for (const Scalar& s : group) {
      if (s.is_hinge == next.is_hinge) axes.push_back(s.axis);
      fits = fits && !(s.is_hinge && !next.is_hinge) &&
             !(s.is_hinge && (s.ref != 0.0 || !(s.anchor == next.anchor)));
    }
    axes.push_back(next.axis);
    fits = fits && are_independent(axes) && (group.empty() || !next.is_hinge || next.ref == 0.0);
    if (!fits) end_group();
    group.push_back(std::move(next));
  }
  end_group();
  // The link of the last joint becomes the link of the body.
  RobotLink& link = context_.robot.links[static_cast<size_t>(parent_)];
  link.name = name_;
  link.is_between = false;
  return parent_;
}

std::string BodyJoints::new_name(const Element& e) {
  std::string name = outer_.name_of(e);
  if (name.empty()) name = name_ + "_joint_" + std::to_string(named_);
  ++named_;
  if (context_.joints.contains(name))
    context_.file.refuse(e, "name: expected different names, got \"" + name + "\" twice");
  return name;
}

double BodyJoints::passive(const Element& e, const char* name, const std::string& childclass,
                           bool acts) const {
  const std::vector<double> values = context_.defaults.list(e, name, childclass);
  if (values.empty()) return 0.0;
  if (values[0] < 0.0) context_.file.refuse(e, std::string(name) + ": expected >= 0");
  if (acts && std::any_of(values.begin() + 1, values.end(), [](double v) { return v != 0.0; }))
    context_.notes.left_out(e, std::string(name) + ": the numbers behind the first");
  return acts ? values[0] : 0.0;
}

RobotJoint& BodyJoints::add_joint(std::string name, const Element& e, JointType type,
                                  bool is_last) {
  Robot& robot = context_.robot;
  const auto child = static_cast<int32_t>(robot.links.size());
  robot.links.push_back({.name = is_last ? name_ : name_ + "/" + name,
                         .where = context_.file.place(is_last ? body_ : e),
                         .is_kinematic = is_mocap_,
                         .is_between = !is_last});
  robot.joints.push_back({.name = std::move(name),
                          .where = context_.file.place(e),
                          .type = type,
                          .parent = parent_,
                          .child = child,
                          .parent_pose = pose_,
                          .child_pose = identity_pose()});
  parent_ = child;
  pose_ = identity_pose();
  moves_ = moves_ || type != JointType::FIXED;
  return robot.joints.back();
}

void BodyJoints::note_joint(const std::string& name, MjcfJoint joint, int32_t dof) {
  joint.joint = static_cast<int32_t>(context_.robot.joints.size()) - 1;
  joint.dof = dof;
  context_.joints.emplace(name, joint);
  context_.joint_order.push_back(name);
  context_.notes.read("joint");
}

void BodyJoints::add_ball(const Found& found, const std::string& type) {
  const Element& e = *found.element;
  const XmlFile& file = context_.file;
  if (type != "free" && type != "ball")
    file.refuse(e, "type: expected hinge, slide, ball or free, got \"" + type + "\"");
  const bool is_free = type == "free";
  if (is_free && found_.size() > 1)
    file.refuse(e, "expected a free joint alone, got one with other joints");
  if (is_free && parent_ >= 0)
    file.refuse(e, "expected a free joint of a body in the world, got one below");
  const std::string name = new_name(e);
  const std::string& childclass = found.childclass;
  const MjcfOption& option = context_.settings.option;
  BallForces forces;
  if (std::string_view(e.Name()) != "freejoint") {
    forces.damping = passive(e, "damping", childclass, option.damper);
    forces.friction = passive(e, "frictionloss", childclass, option.friction);
    forces.armature = passive(e, "armature", childclass, true);
    forces.stiffness = passive(e, "stiffness", childclass, option.spring);
    double spring[2] = {0.0, 0.0};
    context_.defaults.numbers(e, "springdamper", childclass, spring);
    if (spring[0] > 0.0 && spring[1] > 0.0)
      context_.notes.left_out(e, "springdamper of a " + type + " joint");
    if (!std::isfinite(static_cast<float>(forces.stiffness)))
      file.refuse(e, "expected a stiffness that float32 can hold");
  }
  if (is_free) return add_free(e, name, forces);
  RobotJoint& joint = add_joint(name, e, JointType::BALL, found.element == found_.back().element);
  note_joint(name, {.element = &e, .is_ball = true}, 0);
  set_forces(joint, forces);
  double v[3];
  if (context_.defaults.numbers(e, "pos", childclass, v)) {
    joint.child_pose.p = math::transform_point(found.frame, Vec3d{v[0], v[1], v[2]});
    joint.parent_pose = math::multiply(joint.parent_pose, joint.child_pose);
  }
  MjcfJoint limits;
  JointDofConfig unused;
  read_range(e, childclass, context_.settings.compiler.angle, true, limits, unused);
  if (!limits.is_limited) return;
  if (limits.range[0] != 0.0 || limits.range[1] < 0.0)
    file.refuse(e, "range: expected 0 and the largest angle of a ball joint");
  constexpr double kLeast = 1e-3;  // rad; below this angle a rotation has no reliable axis
  if (limits.range[1] < kLeast) context_.notes.mended(e, "its range is 0.001 rad");
  if (option.limit) joint.limit_angle = std::max(limits.range[1], kLeast);
}

void BodyJoints::set_forces(RobotJoint& joint, const BallForces& forces) {
  joint.damping = forces.damping;
  joint.friction = forces.friction;
  joint.armature = forces.armature;
  joint.stiffness = forces.stiffness;
}

// Adds a free joint. If it has passive forces or an armature, it becomes three slides and a ball
// joint, which support them and have the same coordinates.
void BodyJoints::add_free(const Element& e, const std::string& name, const BallForces& forces) {
  if (forces == BallForces{}) {
    add_joint(name, e, JointType::FREE, true);
    return note_joint(name, {.element = &e}, 0);
  }
  const Posed start = pose_;
  pose_ = identity_pose();
  RobotJoint& slides = add_joint(name, e, JointType::D6, false);
  note_joint(name, {.element = &e}, 0);
  for (const Axis axis : {Axis::X, Axis::Y, Axis::Z}) {
    JointDofConfig dof;
    dof.axis = axis_vector(axis);
    dof.damping = static_cast<float>(forces.damping);
    dof.friction = static_cast<float>(forces.friction);
    dof.armature = static_cast<float>(forces.armature);
    dof.target_ke = static_cast<float>(forces.stiffness);
    const double rest[] = {start.p.x, start.p.y, start.p.z};
    dof.target_q = static_cast<float>(rest[slides.linear.size()]);
    slides.linear.push_back(dof);
  }
  slides.start = {start.p.x, start.p.y, start.p.z};
  RobotJoint& ball = add_joint(name + "_ball", e, JointType::BALL, true);
  ball.start = {start.q.x, start.q.y, start.q.z, start.q.w};
  ball.rest = start.q;
  set_forces(ball, forces);
}

void BodyJoints::read_range(const Element& e, const std::string& childclass, double unit,
                            bool is_ball, MjcfJoint& to, JointDofConfig& dof) const {
  const XmlFile& file = context_.file;
  const MjcfDefaults& defaults = context_.defaults;
  const bool automatic = context_.settings.compiler.auto_limits;
  const auto read = [&](const char* name, const char* flag, double(&range)[2]) {
    const bool has_range = defaults.numbers(e, name, childclass, range);
    const std::string limited = defaults.text(e, flag, childclass).value_or("auto");
    const bool has_limits = has_range && range[0] != range[1];
    if (limited == "auto" && has_limits && !automatic)
      file.refuse(e, std::string(flag) +
                         ": expected true or false, where the compiler has autolimits=\"false\"");
    const bool is_limited = limited == "auto" ? has_limits : read_flag(file, e, flag, limited);
    if (is_limited && !(has_range && range[0] < range[1]) && !is_ball)
      file.refuse(e, std::string(name) + ": expected two numbers, the lower one first");
    return is_limited;
  };
  to.is_limited = read("range", "limited", to.range);
  for (double& bound : to.range) bound *= unit;
  if (to.is_limited && context_.settings.option.limit) {
    dof.limit_lower = static_cast<float>(to.range[0]);
    dof.limit_upper = static_cast<float>(to.range[1]);
  }
  double forces[2] = {0.0, 0.0};
  if (read("actuatorfrcrange", "actuatorfrclimited", forces))
    to.force_range = {forces[0], forces[1]};
}

BodyJoints::Scalar BodyJoints::read_scalar(const Found& found, bool is_hinge) {
  const Element& e = *found.element;
  const std::string& childclass = found.childclass;
  const MjcfDefaults& defaults = context_.defaults;
  const MjcfOption& option = context_.settings.option;
  Scalar s{.joint = {.element = &e, .is_scalar = true},
           .name = new_name(e),
           .dof = context_.builder.default_joint_cfg,
           .axis = {},
           .anchor = {},
           .ref = 0.0,
           .is_hinge = is_hinge};
  const double unit = is_hinge ? context_.settings.compiler.angle : 1.0;
  double pos[3] = {0.0, 0.0, 0.0}, axis[3] = {0.0, 0.0, 1.0};
  defaults.numbers(e, "pos", childclass, pos);
  defaults.numbers(e, "axis", childclass, axis);
  s.anchor = math::transform_point(found.frame, Vec3d{pos[0], pos[1], pos[2]});
  const double length = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
  if (!(length > 1e-6)) context_.file.refuse(e, "axis: expected a vector that is not zero");
  s.axis = math::rotate(found.frame.q, Vec3d{axis[0], axis[1], axis[2]} / length);
  s.dof.axis = to_float(s.axis);
  s.ref = defaults.number(e, "ref", childclass, 0.0) * unit;
  read_range(e, childclass, unit, false, s.joint, s.dof);
  s.dof.damping = static_cast<float>(passive(e, "damping", childclass, option.damper));
  s.dof.armature = static_cast<float>(passive(e, "armature", childclass, true));
  s.dof.friction = static_cast<float>(passive(e, "frictionloss", childclass, option.friction));
  s.joint.stiffness = passive(e, "stiffness", childclass, option.spring);
  s.joint.spring_ref = defaults.number(e, "springref", childclass, 0.0) * unit;
  double spring[2] = {0.0, 0.0};
  if (defaults.numbers(e, "springdamper", childclass, spring) && spring[0] > 0.0 && spring[1] > 0.0)
    std::copy_n(spring, 2, s.joint.spring_damper);
  return s;
}

void BodyJoints::add_group(std::span<const Scalar> group) {
  const bool is_last = group.back().joint.element == found_.back().element;
  std::string name = group.front().name;
  for (const Scalar& s : group.subspan(1)) name += "+" + s.name;
  JointType type = JointType::D6;
  if (group.size() == 1) type = group[0].is_hinge ? JointType::REVOLUTE : JointType::PRISMATIC;
  RobotJoint& joint = add_joint(name, *group.front().joint.element, type, is_last);
  Posed place = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}};
  for (const Scalar& s : group) {
    if (s.is_hinge) place.p = s.anchor;
    (s.is_hinge ? joint.angular : joint.linear).push_back(s.dof);
    joint.start.push_back(s.ref);
  }
  joint.child_pose = place;
  // Coordinates of the joint are those of the file: at `ref` the body has its pose in the file.
  Posed back = place;
  for (const Scalar& s : group) {
    if (s.is_hinge)
      back.q = turn(s.axis, -s.ref);  // a hinge with a ref is not combined with others
    else
      back.p = back.p - s.axis * s.ref;
  }
  joint.parent_pose = math::multiply(joint.parent_pose, back);
  for (size_t k = 0; k < group.size(); ++k)
    note_joint(group[k].name, group[k].joint, static_cast<int32_t>(k));
}

}  // namespace novaphy::detail
