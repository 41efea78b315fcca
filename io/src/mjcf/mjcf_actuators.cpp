// <actuator> of MJCF files: forces and drives of hinges and slides.
#include <algorithm>
#include <cmath>

#include "mjcf_context.h"
#include "mjcf_start.h"

namespace novaphy::detail {
namespace {

constexpr std::string_view kRead[] = {
    "name",      "class",     "group",       "joint",      "jointinparent",
    "gear",      "ctrlrange", "ctrllimited", "forcerange", "forcelimited",
    "kp",        "kv",        "dampratio",   "timeconst",  "inheritrange",
    "gaintype",  "biastype",  "dyntype",     "gainprm",    "biasprm",
    "dynprm",    "tendon",    "site",        "body",       "cranksite",
    "slidersite"};
constexpr std::string_view kPassedOver[] = {"user",        "actlimited", "actrange",    "actearly",
                                            "lengthrange", "refsite",    "cranklength", "actdim",
                                            "nsample",     "interp",     "delay"};

// force = gain control + constant + by_length length + by_rate rate, each of the actuator, whose
// length and rate are `gear` times those of the joint. MuJoCo's <general>, which all others are.
struct Law {
  std::string gain_type = "fixed", bias_type = "none", dynamics = "none";
  double gain[3] = {1.0, 0.0, 0.0}, bias[3] = {0.0, 0.0, 0.0};
  double inherit_range = 0.0;
  std::string kind = {};  // of the element that said so last
};

struct Actuator {
  const Element* element;
  std::string name, joint;
  Law law;
  double gear = 1.0;
  double control[2] = {-1e10, 1e10};
  std::optional<std::pair<double, double>> force = {};
};

class ActuatorReader {
 public:
  explicit ActuatorReader(MjcfContext& context)
      : context_(context), file_(context.file), defaults_(context.defaults) {}

  void run() {
    for (const Element* all = file_.root().FirstChildElement("actuator"); all != nullptr;
         all = all->NextSiblingElement("actuator"))
      for (const Element* e = all->FirstChildElement(); e != nullptr; e = e->NextSiblingElement())
        read(*e);
    for (const std::string& joint : context_.joint_order) set_drive(joint);
    // In the order of the file.
    for (const Actuator& a : found_) add(a);
  }

 private:
  // Sets what an element of the file or of a default class says. `outer`: the laws of the classes
  // around that, outermost first.
  void apply(const Element& e, Law& law, std::span<const Law> outer) const {
    const std::string kind = e.Name();
    const auto first = [&](const char* name, std::span<double> to) {
      const char* const given = e.Attribute(name);
      if (given == nullptr) return;
      const std::vector<double> values = file_.parse(e, name, given);
      for (size_t k = 0; k < std::min(values.size(), to.size()); ++k) to[k] = values[k];
    };
    const auto one = [&](const char* name) {
      double value[1];
      return file_.numbers(e, name, value) ? std::optional(value[0]) : std::nullopt;
    };
    if (kind == "general") {
      law.kind = kind;
      if (const char* type = e.Attribute("gaintype")) law.gain_type = type;
      if (const char* type = e.Attribute("biastype")) law.bias_type = type;
      if (const char* type = e.Attribute("dyntype")) law.dynamics = type;
      first("gainprm", law.gain);
      first("biasprm", law.bias);
      return;
    }
    // The others go on from what the same kind, or <general>, said last.
    Law from;
    const auto goes_on = [&](const Law& l) { return l.kind == kind || l.kind == "general"; };
    if (goes_on(law)) {
      from = law;
    } else {
      const auto found = std::find_if(outer.rbegin(), outer.rend(), goes_on);
      if (found != outer.rend()) from = *found;
    }
    law = Law{};
    law.kind = kind;
    if (kind != "position" && kind != "velocity") return;
    law.bias_type = "affine";
    law.gain[0] = one(kind == "position" ? "kp" : "kv").value_or(from.gain[0]);
    if (kind == "velocity") {
      law.bias[2] = -law.gain[0];
      return;
    }
    law.bias[1] = -law.gain[0];
    law.bias[2] = from.bias[2];
    law.dynamics = from.dynamics;
    law.inherit_range = one("inheritrange").value_or(from.inherit_range);
    const auto kv = one("kv"), ratio = one("dampratio"), lag = one("timeconst");
    if (kv && ratio) file_.refuse(e, "kv, dampratio: expected one of them");
    if (kv) law.bias[2] = -*kv;
    if (ratio) law.bias[2] = *ratio;
    if (lag) law.dynamics = *lag == 0.0 ? "none" : "filterexact";
  }

  void read(const Element& e) {
    const std::string_view kind = e.Name();
    constexpr std::string_view others[] = {"general",     "motor",  "position", "velocity",
                                           "intvelocity", "damper", "cylinder", "muscle",
                                           "adhesion",    "plugin", "dcmotor"};
    if (std::find(std::begin(others), std::end(others), kind) == std::end(others))
      context_.not_read(e, "this element");
    context_.notes.read("actuator");
    Law law;
    std::vector<Law> outer;
    for (const auto& of_class : defaults_.actuators(e)) {
      for (const Element* each : of_class) apply(*each, law, outer);
      outer.push_back(law);
    }
    apply(e, law, outer);
    if (kind != "general" && kind != "motor" && kind != "position" && kind != "velocity")
      return context_.notes.left_out(e, "an actuator of the kind <" + law.kind + ">");
    const auto joint = text(e, "joint") ? text(e, "joint") : text(e, "jointinparent");
    for (const char* other : {"tendon", "site", "body", "cranksite", "slidersite"})
      if (!joint && text(e, other))
        return context_.notes.left_out(e, std::string("an actuator of a ") + other);
    if (!joint) file_.refuse(e, "joint: missing");
    const auto found = context_.joints.find(*joint);
    if (found == context_.joints.end()) file_.refuse(e, "there is no joint \"" + *joint + "\"");
    if (!found->second.is_scalar)
      return context_.notes.left_out(e, "an actuator of a ball or free joint");
    Actuator a{.element = &e, .name = {}, .joint = *joint, .law = law};
    if (!check_attributes(e)) return;
    if (!read_law(a, found->second)) return;
    const char* const name = e.Attribute("name");
    a.name = name != nullptr ? name : *joint + "_" + std::string(kind);
    if (!names_.insert(a.name).second && name != nullptr)
      file_.refuse(e, "name: expected different names, got \"" + a.name + "\" twice");
    const auto group = number(e, "group").value_or(0.0);
    const auto disabled = context_.settings.option.disabled_groups;
    if (group >= 0.0 && group <= 30.0 && (disabled >> static_cast<int>(group) & 1u) != 0)
      return context_.notes.ignored(e, "its group of actuators is disabled");
    if (!context_.settings.option.actuation)
      return context_.notes.ignored(e, "the flag actuation disables it");
    found_.push_back(std::move(a));
  }

  // The attribute, or that of the <general>, <position>, ... of the class that comes last.
  std::optional<std::string> text(const Element& e, const char* name) const {
    if (const char* own = e.Attribute(name)) return own;
    std::optional<std::string> value;
    for (const auto& of_class : defaults_.actuators(e))
      for (const Element* each : of_class)
        if (const char* given = each->Attribute(name)) value = given;
    return value;
  }
  std::vector<double> list(const Element& e, const char* name) const {
    const auto given = text(e, name);
    return given ? file_.parse(e, name, *given) : std::vector<double>{};
  }
  std::optional<double> number(const Element& e, const char* name) const {
    const std::vector<double> values = list(e, name);
    return values.empty() ? std::nullopt : std::optional(values[0]);
  }
  bool check_attributes(const Element& e) const {
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next()) {
      bool known = false;
      for (const std::span<const std::string_view> names :
           {std::span<const std::string_view>(kRead),
            std::span<const std::string_view>(kPassedOver)})
        known = known || std::find(names.begin(), names.end(), a->Name()) != names.end();
      if (known) continue;
      context_.notes.left_out(e, std::string("an actuator with the attribute ") + a->Name());
      return false;
    }
    return true;
  }

  std::optional<std::pair<double, double>> range(const Element& e, const char* name,
                                                 const char* flag) const {
    const std::vector<double> values = list(e, name);
    if (!values.empty() && values.size() != 2)
      file_.refuse(e, std::string(name) + ": expected 2 numbers");
    const bool has_range = values.size() == 2 && values[0] != values[1];
    const std::string limited = text(e, flag).value_or("auto");
    const bool is_limited = limited == "auto" ? context_.settings.compiler.auto_limits && has_range
                                              : read_flag(file_, e, flag, limited);
    if (!is_limited) return {};
    if (!(has_range && values[0] < values[1]))
      file_.refuse(e, std::string(name) + ": expected two numbers, the lower one first");
    return std::pair(values[0], values[1]);
  }

  // False: there is no such law here.
  bool read_law(Actuator& a, const MjcfJoint& joint) {
    const Element& e = *a.element;
    Law& law = a.law;
    const auto refuse = [&](const std::string& what) {
      context_.notes.left_out(e, "an actuator with " + what);
      return false;
    };
    if (law.dynamics != "none") return refuse("dyntype " + law.dynamics);
    if (law.gain_type == "affine" && law.gain[1] == 0.0 && law.gain[2] == 0.0)
      law.gain_type = "fixed";
    if (law.gain_type != "fixed") return refuse("gaintype " + law.gain_type);
    if (law.bias_type == "none")
      std::fill(std::begin(law.bias), std::end(law.bias), 0.0);
    else if (law.bias_type != "affine")
      return refuse("biastype " + law.bias_type);
    const std::vector<double> gear = list(e, "gear");
    if (!gear.empty()) a.gear = gear[0];
    // A damping ratio, of the inertia at the start.
    if (law.bias[2] > 0.0 && law.gain[0] == -law.bias[1]) {
      const double inertia = dof_inertia(joint) / (a.gear * a.gear);
      law.bias[2] *= -2.0 * std::sqrt(law.gain[0] * inertia);
    }
    if (law.bias[1] > 0.0 || law.bias[2] > 0.0) return refuse("a spring or damper that pushes");
    auto control = range(e, "ctrlrange", "ctrllimited");
    if (law.inherit_range > 0.0 && joint.is_limited) {
      const double middle = 0.5 * (joint.range[0] + joint.range[1]);
      const double radius = 0.5 * (joint.range[1] - joint.range[0]) * law.inherit_range;
      control = {middle - radius, middle + radius};
    }
    if (control && context_.settings.option.clamp_control) {
      a.control[0] = control->first;
      a.control[1] = control->second;
    }
    a.force = range(e, "forcerange", "forcelimited");
    return true;
  }

  JointDofConfig& dof_of(const MjcfJoint& joint) const {
    RobotJoint& in = context_.robot.joints[static_cast<size_t>(joint.joint)];
    const auto k = static_cast<size_t>(joint.dof);
    return k < in.linear.size() ? in.linear[k] : in.angular[k - in.linear.size()];
  }

  // What the dof moves at the start, where all others may move.
  double dof_inertia(const MjcfJoint& joint) {
    if (inertias_.empty()) inertias_ = free_inertias(context_.robot);
    return inertias_[static_cast<size_t>(joint.joint)][static_cast<size_t>(joint.dof)];
  }

  // What a control does: a target of a drive, or a force.
  static ActuatorTarget target_of(const Law& law) {
    if (law.bias[1] < 0.0) return ActuatorTarget::Position;
    return law.bias[2] < 0.0 ? ActuatorTarget::Velocity : ActuatorTarget::Force;
  }

  // The drive of a dof: its spring and all actuators that have gains.
  void set_drive(const std::string& name) {
    const MjcfJoint& joint = context_.joints.at(name);
    if (!joint.is_scalar) return;
    JointDofConfig& dof = dof_of(joint);
    Gains gains{joint.stiffness, 0.0};
    double pull = joint.stiffness * joint.spring_ref;
    std::vector<Actuator*> all;
    for (Actuator& a : found_) {
      if (a.joint != name) continue;
      all.push_back(&a);
      gains.ke -= a.gear * a.gear * a.law.bias[1];
      gains.kd -= a.gear * a.gear * a.law.bias[2];
    }
    limit_forces(all, joint, dof);
    gains_[name] = gains;
    if (gains.ke == 0.0 && gains.kd == 0.0) return;
    dof.target_ke = static_cast<float>(gains.ke);
    dof.target_kd = static_cast<float>(gains.kd);
    dof.target_qd = 0.0f;
    for (const Actuator* a : all)
      if (target_of(a->law) == ActuatorTarget::Position)
        pull += a->gear *
                (a->law.gain[0] * std::clamp(0.0, a->control[0], a->control[1]) + a->law.bias[0]);
    if (gains.ke > 0.0) dof.target_q = static_cast<float>(pull / gains.ke);
  }

  // Limits of forces, as far as a drive or a force of the joint has them.
  void limit_forces(const std::vector<Actuator*>& all, const MjcfJoint& joint,
                    JointDofConfig& dof) {
    const bool is_alone = all.size() == 1 && joint.stiffness == 0.0;
    for (Actuator* a : all) {
      if (!a->force) continue;
      const double f = std::abs(a->gear);
      if (target_of(a->law) == ActuatorTarget::Force)
        limit_control(*a, a->force->first, a->force->second);
      else if (is_alone && a->force->first == -a->force->second)
        dof.effort_limit =
            static_cast<float>(std::min(1.0 * dof.effort_limit, f * a->force->second));
      else
        context_.notes.left_out(*a->element,
                                is_alone ? "forcerange: expected a symmetric one of a drive"
                                         : "forcerange: the drive of the joint has other parts");
    }
    if (!joint.force_range || all.empty()) return;
    const auto [lower, upper] = *joint.force_range;
    Actuator& a = *all.front();
    const double gear = a.gear;
    if (all.size() == 1 && target_of(a.law) == ActuatorTarget::Force && gear != 0.0)
      limit_control(a, std::min(lower / gear, upper / gear), std::max(lower / gear, upper / gear));
    else if (is_alone && lower == -upper)
      dof.effort_limit = static_cast<float>(std::min(1.0 * dof.effort_limit, upper));
    else
      context_.notes.left_out(*joint.element,
                              "actuatorfrcrange of a joint with several forces, or that is not "
                              "symmetric");
  }

  // The controls that keep a force within its range.
  void limit_control(Actuator& a, double lower, double upper) {
    const double gain = a.law.gain[0];
    if (gain == 0.0) return;
    double low = (lower - a.law.bias[0]) / gain, high = (upper - a.law.bias[0]) / gain;
    if (low > high) std::swap(low, high);
    a.control[0] = std::clamp(a.control[0], low, high);
    a.control[1] = std::clamp(a.control[1], low, high);
  }

  void add(const Actuator& a) {
    const MjcfJoint& joint = context_.joints.at(a.joint);
    const Gains& gains = gains_.at(a.joint);
    MjcfActuator out{.element = a.element,
                     .name = a.name,
                     .joint = a.joint,
                     .target = target_of(a.law),
                     .gear = a.gear * a.law.gain[0],
                     .offset = a.gear * a.law.bias[0],
                     .lower = a.control[0],
                     .upper = a.control[1]};
    const double by = out.target == ActuatorTarget::Position   ? gains.ke
                      : out.target == ActuatorTarget::Velocity ? gains.kd
                                                               : 1.0;
    out.gear /= by;
    out.offset /= by;
    // The spring of the joint has its part of the target, once.
    if (out.target == ActuatorTarget::Position && springs_.insert(a.joint).second)
      out.offset += joint.stiffness * joint.spring_ref / by;
    for (const double number : {out.gear, out.offset})
      if (!std::isfinite(static_cast<float>(number)))
        file_.refuse(*a.element, "expected a force that float32 can hold");
    context_.actuators.push_back(std::move(out));
  }

  struct Gains {
    double ke, kd;
  };
  MjcfContext& context_;
  const XmlFile& file_;
  const MjcfDefaults& defaults_;
  std::vector<Actuator> found_;
  std::set<std::string> names_, springs_;
  std::map<std::string, Gains> gains_;         // of joints
  std::vector<std::vector<double>> inertias_;  // of dofs, when they are needed
};

}  // namespace

void read_actuators(MjcfContext& context) { ActuatorReader(context).run(); }

}  // namespace novaphy::detail
