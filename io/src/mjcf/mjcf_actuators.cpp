// Reads <actuator> of MJCF files and calls ModelBuilder::add_actuator.
#include <algorithm>
#include <cmath>

#include "mjcf_context.h"
#include "mjcf_start.h"
#include "mjcf_transmissions.h"

namespace novaphy::detail {
namespace {

constexpr std::string_view kRead[] = {
    "name",      "class",      "group",       "joint",      "jointinparent",
    "gear",      "ctrlrange",  "ctrllimited", "forcerange", "forcelimited",
    "kp",        "kv",         "dampratio",   "timeconst",  "inheritrange",
    "gaintype",  "biastype",   "dyntype",     "gainprm",    "biasprm",
    "dynprm",    "tendon",     "site",        "refsite",    "body",
    "cranksite", "slidersite", "actlimited",  "actrange",   "actearly",
    "actdim",    "bias",       "area",        "diameter"};
constexpr std::string_view kPassedOver[] = {"user",    "lengthrange", "cranklength",
                                            "nsample", "interp",      "delay"};

// The parameters of MuJoCo's <general>, to which all other kinds of actuators are converted.
struct Law {
  std::string gain_type = "fixed", bias_type = "none", dynamics = "none";
  double gain[3] = {1.0, 0.0, 0.0}, bias[3] = {0.0, 0.0, 0.0}, time = 1.0;
  double inherit_range = 0.0;
  std::string kind = {};  // tag of the last element that set the law
};

using Range = std::pair<double, double>;
constexpr Range kNoRange = {-kJointUnlimited, kJointUnlimited};

struct Actuator {
  const Element* element;
  std::string name;
  MjcfActuator to;
  Law law;
  double gear[6] = {1.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  Range control = kNoRange, force = kNoRange, activation = kNoRange;
  // Returns whether the law has a spring or damper, which becomes part of the drive of its dof.
  bool is_servo() const {
    return law.gain[1] != 0.0 || law.gain[2] != 0.0 || law.bias[1] != 0.0 || law.bias[2] != 0.0;
  }
};

const std::map<std::string, ActuatorDynamics> kDynamics = {
    {"none", ActuatorDynamics::NONE},
    {"integrator", ActuatorDynamics::INTEGRATOR},
    {"filter", ActuatorDynamics::FILTER},
    {"filterexact", ActuatorDynamics::FILTER_EXACT}};

class ActuatorReader {
 public:
  explicit ActuatorReader(MjcfContext& context)
      : context_(context), file_(context.file), defaults_(context.defaults) {}

  void run() {
    for (const Element* all = file_.root().FirstChildElement("actuator"); all != nullptr;
         all = all->NextSiblingElement("actuator"))
      for (const Element* e = all->FirstChildElement(); e != nullptr; e = e->NextSiblingElement())
        read(*e);
    for (const std::string& joint : context_.joint_order) set_joint(joint);
    // Actuators are added in the order of the file.
    for (const Actuator& a : found_) add(a);
  }

 private:
  // Applies the attributes of an element of the file or of a default class. `outer`: the laws of
  // the enclosing classes, outermost first.
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
      first("dynprm", {&law.time, 1});
      if (e.Attribute("ctrlrange") != nullptr) law.inherit_range = 0.0;
      return;
    }
    if (e.Attribute("inheritrange") != nullptr && kind != "position" && kind != "intvelocity")
      file_.refuse(e, "inheritrange: expected <position> or <intvelocity>");
    // Attributes that are missing continue from the last law of the same kind or of <general>.
    Law from;
    const auto goes_on = [&](const Law& l) { return l.kind == kind || l.kind == "general"; };
    if (goes_on(law)) {
      from = law;
    } else {
      const auto found = std::find_if(outer.rbegin(), outer.rend(), goes_on);
      if (found != outer.rend()) from = *found;
    }
    law = Law{.kind = kind};
    if (kind == "damper") {
      law.gain_type = "affine";
      law.gain[0] = 0.0;
      law.gain[2] = one("kv") ? -*one("kv") : from.gain[2];
      return;
    }
    if (kind == "cylinder") return apply_cylinder(e, law, from);
    if (kind != "position" && kind != "velocity" && kind != "intvelocity") return;
    apply_servo(e, law, from);
  }

  // Applies <position>, <velocity> and <intvelocity>.
  void apply_servo(const Element& e, Law& law, const Law& from) const {
    const std::string& kind = law.kind;
    const auto one = [&](const char* name) {
      double value[1];
      return file_.numbers(e, name, value) ? std::optional(value[0]) : std::nullopt;
    };
    law.bias_type = "affine";
    law.gain[0] = one(kind == "velocity" ? "kv" : "kp").value_or(from.gain[0]);
    if (kind == "velocity") {
      law.bias[2] = -law.gain[0];
      return;
    }
    law.bias[1] = -law.gain[0];
    law.bias[2] = from.bias[2];
    law.dynamics = kind == "intvelocity" ? "integrator" : from.dynamics;
    law.time = from.time;
    const std::string own = kind == "position" ? "ctrlrange" : "actrange";
    const bool has_own = e.Attribute(own.c_str()) != nullptr;
    if (e.Attribute("inheritrange") != nullptr && has_own)
      file_.refuse(e, "inheritrange, " + own + ": expected one of them");
    law.inherit_range = one("inheritrange").value_or(has_own ? 0.0 : from.inherit_range);
    const auto kv = one("kv"), ratio = one("dampratio"), lag = one("timeconst");
    if (kv && ratio) file_.refuse(e, "kv, dampratio: expected one of them");
    if (kv) law.bias[2] = -*kv;
    if (ratio) law.bias[2] = *ratio;
    if (lag && kind == "position") {
      law.dynamics = *lag == 0.0 ? "none" : "filterexact";
      law.time = *lag;
    }
  }

  void apply_cylinder(const Element& e, Law& law, const Law& from) const {
    law.dynamics = "filter";
    law.bias_type = "affine";
    law.gain[0] = from.gain[0];
    law.time = from.time;
    std::copy(std::begin(from.bias), std::end(from.bias), law.bias);
    double value[1];
    if (file_.numbers(e, "timeconst", value)) law.time = value[0];
    if (file_.numbers(e, "area", value)) law.gain[0] = value[0];
    if (file_.numbers(e, "diameter", value)) law.gain[0] = 0.25 * M_PI * value[0] * value[0];
    file_.numbers(e, "bias", law.bias);
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
    constexpr std::string_view covered[] = {"general",     "motor",  "position", "velocity",
                                            "intvelocity", "damper", "cylinder"};
    if (std::find(std::begin(covered), std::end(covered), kind) == std::end(covered))
      return context_.notes.left_out(e, "an actuator of the kind <" + law.kind + ">");
    Actuator a{.element = &e, .name = {}, .to = {}, .law = law};
    const std::vector<double> gear = list(e, "gear");
    std::copy_n(gear.begin(), std::min(gear.size(), std::size(a.gear)), a.gear);
    const std::string of = find_transmission(context_, e, a.gear, a.to);
    if (of.empty() || !check_attributes(e)) return;
    if (!read_law(a, a.to.joint.empty() ? nullptr : &context_.joints.at(a.to.joint))) return;
    const char* const name = e.Attribute("name");
    a.name = name != nullptr ? context_.named(name) : of + "_" + std::string(kind);
    if (name != nullptr && names_.contains(a.name))
      file_.refuse(e, "name: expected different names, got \"" + a.name + "\" twice");
    for (int k = 2; !names_.insert(a.name).second; ++k)
      a.name = of + "_" + std::string(kind) + "_" + std::to_string(k);
    const auto group = number(e, "group").value_or(0.0);
    const auto disabled = context_.settings.option.disabled_groups;
    if (group >= 0.0 && group <= 30.0 && (disabled >> static_cast<int>(group) & 1u) != 0)
      return context_.notes.ignored(e, "its group of actuators is disabled");
    if (!context_.settings.option.actuation)
      return context_.notes.ignored(e, "the flag actuation disables it");
    found_.push_back(std::move(a));
  }

  std::optional<std::string> text(const Element& e, const char* name) const {
    return defaults_.actuator_text(e, name);
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

  // Returns a range. If `always`, the flag that enables the range is not needed.
  std::optional<Range> range(const Element& e, const char* name, const char* flag,
                             bool always = false) const {
    const std::vector<double> values = list(e, name);
    if (!values.empty() && values.size() != 2)
      file_.refuse(e, std::string(name) + ": expected 2 numbers");
    const bool has_range = values.size() == 2 && values[0] != values[1];
    const std::string limited = text(e, flag).value_or("auto");
    const bool is_limited = always ? true
                            : limited == "auto"
                                ? context_.settings.compiler.auto_limits && has_range
                                : read_flag(file_, e, flag, limited);
    if (!is_limited) return {};
    if (!(has_range && values[0] < values[1]))
      file_.refuse(e, std::string(name) + ": expected two numbers, the lower one first");
    return std::pair(values[0], values[1]);
  }

  // Reads the law. Returns false if NovaPhy lacks it. If `joint` is null, it acts on bodies.
  bool read_law(Actuator& a, const MjcfJoint* joint) {
    const Element& e = *a.element;
    Law& law = a.law;
    const auto refuse = [&](const std::string& what) {
      context_.notes.left_out(e, "an actuator with " + what);
      return false;
    };
    if (!kDynamics.contains(law.dynamics)) return refuse("dyntype " + law.dynamics);
    const bool has_state = law.dynamics != "none";
    if (law.gain_type == "fixed")
      law.gain[1] = law.gain[2] = 0.0;
    else if (law.gain_type != "affine")
      return refuse("gaintype " + law.gain_type);
    if (law.bias_type == "none")
      std::fill(std::begin(law.bias), std::end(law.bias), 0.0);
    else if (law.bias_type != "affine")
      return refuse("biastype " + law.bias_type);
    const auto early = text(e, "actearly");
    if (has_state && early && read_flag(file_, e, "actearly", *early)) return refuse("actearly");
    if (number(e, "actdim").value_or(1.0) > 1.0) return refuse("actdim above 1");
    // A damping ratio is relative to the inertia at the initial pose.
    if (law.bias[2] > 0.0 && law.gain[0] == -law.bias[1]) {
      if (joint == nullptr) return refuse("a dampratio, of no hinge or slide");
      const double inertia = dof_inertia(*joint) / (a.gear[0] * a.gear[0]);
      law.bias[2] *= -2.0 * std::sqrt(law.gain[0] * inertia);
    }
    const std::string kind = e.Name();
    const bool is_integrated = kind == "intvelocity";
    auto control = range(e, "ctrlrange", "ctrllimited", kind == "damper");
    a.activation = range(e, "actrange", "actlimited", is_integrated && law.inherit_range <= 0.0)
                       .value_or(kNoRange);
    if (law.inherit_range > 0.0) {
      if (joint == nullptr || !joint->is_scalar || !joint->is_limited)
        file_.refuse(e, "inheritrange: expected a hinge or slide with limits");
      const double middle = 0.5 * (joint->range[0] + joint->range[1]);
      const double radius = 0.5 * (joint->range[1] - joint->range[0]) * law.inherit_range;
      const Range inherited = {middle - radius, middle + radius};
      if (is_integrated)
        a.activation = inherited;
      else if (text(e, "ctrllimited").value_or("auto") != "false")
        control = inherited;
    }
    if (control && context_.settings.option.clamp_control) a.control = *control;
    a.force = range(e, "forcerange", "forcelimited").value_or(kNoRange);
    if (joint == nullptr) return true;
    // A drive must pull towards its target and against the velocity for every control.
    const Range& input = has_state ? a.activation : a.control;
    for (const int k : {1, 2})
      for (const double c : {input.first, input.second})
        if (law.bias[k] + law.gain[k] * c > 0.0) return refuse("a spring or damper that pushes");
    return true;
  }

  JointDofConfig& dof_of(const MjcfJoint& joint) const {
    RobotJoint& in = context_.robot.joints[static_cast<size_t>(joint.joint)];
    const auto k = static_cast<size_t>(joint.dof);
    return k < in.linear.size() ? in.linear[k] : in.angular[k - in.linear.size()];
  }

  // Returns the inertia of a dof at the initial pose, where all other dofs may move.
  double dof_inertia(const MjcfJoint& joint) {
    if (inertias_.empty()) inertias_ = free_inertias(context_.robot);
    return inertias_[static_cast<size_t>(joint.joint)][static_cast<size_t>(joint.dof)];
  }

  // Converts a time constant and a damping ratio to a spring and damper, with the inertia at the
  // initial pose.
  void set_spring_damper(MjcfJoint& joint) {
    const auto [time, ratio] = joint.spring_damper;
    if (time == 0.0) return;
    const double inertia = dof_inertia(joint), damping = 2.0 * inertia / time;
    joint.stiffness = context_.settings.option.spring ? inertia / std::pow(time * ratio, 2) : 0.0;
    dof_of(joint).damping = context_.settings.option.damper ? static_cast<float>(damping) : 0.0f;
  }

  // Sets the spring of a joint and its force limit.
  void set_joint(const std::string& name) {
    MjcfJoint& joint = context_.joints.at(name);
    if (!joint.is_scalar) return;
    set_spring_damper(joint);
    if (joint.stiffness > 0.0) {
      JointDofConfig& dof = dof_of(joint);
      dof.target_ke = static_cast<float>(joint.stiffness);
      dof.target_q = static_cast<float>(joint.spring_ref);
      if (!std::isfinite(dof.target_ke) || !std::isfinite(dof.damping))
        file_.refuse(*joint.element, "expected a stiffness that float32 can hold");
    }
    std::vector<Actuator*> all;
    for (Actuator& a : found_)
      if (a.to.joint == name) all.push_back(&a);
    if (joint.force_range && !all.empty()) {
      auto [lower, upper] = *joint.force_range;
      Actuator& a = *all.front();
      lower /= a.gear[0];
      upper /= a.gear[0];
      if (all.size() == 1 && a.gear[0] != 0.0)
        a.force = {std::max(a.force.first, std::min(lower, upper)),
                   std::min(a.force.second, std::max(lower, upper))};
      else
        context_.notes.left_out(*joint.element, "actuatorfrcrange of a joint with several forces");
    }
    const auto servos =
        std::count_if(all.begin(), all.end(), [](const Actuator* a) { return a->is_servo(); });
    for (Actuator* a : all) {
      if (a->force == kNoRange || !a->is_servo()) continue;
      if (servos == 1 && joint.stiffness == 0.0) continue;
      context_.notes.left_out(*a->element, "forcerange: the drive of the joint has other parts");
      a->force = kNoRange;
    }
  }

  void add(const Actuator& a) {
    const auto vector = [](const double(&v)[3]) {
      return Vec3f{static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
    };
    const auto to_range = [](const Range& r) {
      return Vec2f{static_cast<float>(r.first), static_cast<float>(r.second)};
    };
    ActuatorArgs args{.axis = a.to.joint.empty() ? 0 : context_.joints.at(a.to.joint).dof,
                      .gear = a.to.joint.empty() ? 1.0f : static_cast<float>(a.gear[0]),
                      .gain = vector(a.law.gain),
                      .bias = vector(a.law.bias),
                      .dynamics = kDynamics.at(a.law.dynamics),
                      .time = static_cast<float>(std::max(a.law.time, 1e-15)),
                      .ctrl_range = to_range(a.control),
                      .force_range = to_range(a.force),
                      .act_range = to_range(a.activation),
                      .label = a.name};
    const SpatialVectorf& wrench = a.to.args.wrench;
    // clang-format off
    for (const float v : {args.gear, args.gain.x, args.gain.y, args.gain.z, args.bias.x, args.bias.y,
                          args.bias.z, args.ctrl_range.x, args.ctrl_range.y, args.force_range.x,
                          args.force_range.y, args.act_range.x, args.act_range.y, args.time,
                          wrench.linear.x, wrench.linear.y, wrench.linear.z, wrench.angular.x,
                          wrench.angular.y, wrench.angular.z})
      // clang-format on
      if (!std::isfinite(v)) file_.refuse(*a.element, "expected numbers that float32 can hold");
    MjcfActuator to = a.to;
    to.args.law = std::move(args);
    context_.actuators.push_back(std::move(to));
  }

  MjcfContext& context_;
  const XmlFile& file_;
  const MjcfDefaults& defaults_;
  std::vector<Actuator> found_;
  std::set<std::string> names_;
  std::vector<std::vector<double>> inertias_;  // inertia of each joint and dof, computed on demand
};

}  // namespace

void read_actuators(MjcfContext& context) { ActuatorReader(context).run(); }

}  // namespace novaphy::detail
