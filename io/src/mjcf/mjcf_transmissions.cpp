#include "mjcf_transmissions.h"

namespace novaphy::detail {
namespace {

constexpr auto kOfForce = static_cast<int32_t>(ActuatorAxes::REFERENCE_FORCE),
               kOfMoment = static_cast<int32_t>(ActuatorAxes::REFERENCE_MOMENT),
               kLength = static_cast<int32_t>(ActuatorAxes::LENGTH);

class TransmissionFinder {
 public:
  TransmissionFinder(MjcfContext& context, const Element& e, const double (&gear)[6],
                     MjcfActuator& to)
      : context_(context), e_(e), gear_(gear), to_(to) {}

  std::string run() {
    const auto text = [&](const char* name) { return context_.defaults.actuator_text(e_, name); };
    const char* first = nullptr;
    for (const char* name : {"joint", "jointinparent", "site", "tendon", "body", "slidersite"}) {
      if (e_.Attribute(name) == nullptr) continue;
      if (first != nullptr)
        context_.file.refuse(
            e_, std::string("expected one transmission, got ") + first + " and " + name);
      first = name;
    }
    const bool in_parent = !text("joint") && text("jointinparent");
    if (const auto joint = text(in_parent ? "jointinparent" : "joint"))
      return find_joint(context_.named(*joint), in_parent);
    if (const auto site = text("site")) return find_sites(*site, text("refsite"));
    for (const char* other : {"tendon", "body", "cranksite", "slidersite"})
      if (text(other)) {
        context_.notes.left_out(e_, std::string("an actuator of a ") + other);
        return {};
      }
    context_.file.refuse(e_, "joint: missing");
  }

 private:
  std::string find_joint(const std::string& name, bool in_parent) const {
    const auto found = context_.joints.find(name);
    if (found == context_.joints.end()) {
      if (context_.is_part) return {};
      context_.file.refuse(e_, "there is no joint \"" + name + "\"");
    }
    if (found->second.is_scalar) {
      to_.joint = name;
      return name;
    }
    // The gear of a ball joint is a moment between the two bodies. The gear of a free joint is a
    // force and a moment in world axes.
    const auto* joint = &context_.robot.joints[static_cast<size_t>(found->second.joint)];
    const bool is_ball = found->second.is_ball;
    if (joint->type == JointType::D6) ++joint;  // a free joint may be slides and a ball
    const double* const g = gear_;
    BodyActuatorArgs& args = to_.args;
    args.axes = in_parent ? kOfMoment : 0;
    to_.site = {joint->child, is_ball ? joint->child_pose : identity_pose()};
    to_.reference = {kWorldLink, identity_pose()};
    if (is_ball) {
      to_.reference = {joint->parent, joint->parent_pose};
      args.axes |= kLength;
      args.wrench = {{}, to_float(Vec3d{g[0], g[1], g[2]})};
    } else {
      args.axes |= kOfForce;
      args.wrench = {to_float(Vec3d{g[0], g[1], g[2]}), to_float(Vec3d{g[3], g[4], g[5]})};
    }
    return name;
  }
  std::string find_sites(const std::string& name,
                         const std::optional<std::string>& reference) const {
    bool is_missing = false;
    const auto find = [&](const std::string& site) {
      const auto found = context_.sites.find(context_.named(site));
      if (found != context_.sites.end()) return found->second;
      if (!context_.is_part) context_.file.refuse(e_, "there is no site \"" + site + "\"");
      is_missing = true;
      return std::pair(kWorldLink, identity_pose());
    };
    to_.site = find(name);
    to_.reference = reference ? find(*reference) : std::pair(kWorldLink, identity_pose());
    if (is_missing) return {};
    const double* const g = gear_;
    to_.args.axes = reference ? kOfForce | kOfMoment | kLength : 0;
    to_.args.wrench = {to_float(Vec3d{g[0], g[1], g[2]}), to_float(Vec3d{g[3], g[4], g[5]})};
    const int32_t link = to_.site.first, other = to_.reference.first;
    if (link < 0 && other < 0) {
      context_.notes.ignored(e_, "its sites are those of the world");
      return {};
    }
    if (link >= 0 && other >= 0 && root_of(link) != root_of(other)) {
      context_.notes.left_out(e_, "an actuator between sites of two trees");
      return {};
    }
    return context_.named(name);
  }
  int32_t root_of(int32_t link) const {
    for (bool found = true; found;) {
      found = false;
      for (const RobotJoint& joint : context_.robot.joints)
        if (joint.child == link && joint.parent >= 0) {
          link = joint.parent;
          found = true;
        }
    }
    return link;
  }

  MjcfContext& context_;
  const Element& e_;
  const double (&gear_)[6];
  MjcfActuator& to_;
};

}  // namespace

std::string find_transmission(MjcfContext& context, const Element& e, const double (&gear)[6],
                              MjcfActuator& to) {
  return TransmissionFinder(context, e, gear, to).run();
}

}  // namespace novaphy::detail
