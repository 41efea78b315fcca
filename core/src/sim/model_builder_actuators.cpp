// Actuators of a ModelBuilder.
#include <algorithm>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"

namespace novaphy {

int32_t ModelBuilder::add_actuator(int32_t joint, const ActuatorArgs& args) {
  constexpr std::string_view name = "add_actuator";
  require(joint >= 0 && joint < joint_count(), ErrorKind::Index, name, ": joint: expected 0 to ",
          joint_count() - 1, ", got ", joint);
  const Joint& of = joints_[static_cast<size_t>(joint)];
  require(has_axes(of.type), ErrorKind::Value, name, ": joint ", joint, " (\"", of.label,
          "\"): expected a joint with axes, such as REVOLUTE or D6, got ",
          joint_type_name(of.type));
  const int32_t axes = of.linear + of.angular;
  require(args.axis >= 0 && args.axis < axes, ErrorKind::Index, name, ": axis: expected 0 to ",
          axes - 1, " of joint ", joint, " (\"", of.label, "\"), got ", args.axis);
  return actuators_.add(name, {.dof = of.qd_start + args.axis, .body = -1, .args = {.law = args}});
}

int32_t ModelBuilder::add_body_actuator(int32_t body, const BodyActuatorArgs& given) {
  constexpr std::string_view name = "add_body_actuator";
  BodyActuatorArgs args = given;
  for (const auto& [which, index] :
       {std::pair{"body", body}, std::pair{"reference_body", args.reference_body}})
    require(index >= -1 && index < body_count(), ErrorKind::Index, name, ": ", which,
            ": expected -1 to ", body_count() - 1, ", got ", index);
  require(body >= 0 || args.reference_body >= 0, ErrorKind::Value, name,
          ": body, reference_body: expected at least one body, got the world twice");
  args.frame = detail::checked_pose({name, "frame"}, args.frame);
  args.reference = detail::checked_pose({name, "reference"}, args.reference);
  detail::check_finite({name, "wrench"}, args.wrench.linear);
  detail::check_finite({name, "wrench"}, args.wrench.angular);
  require(args.axes >= 0 && args.axes < 8, ErrorKind::Value, name,
          ": axes: expected bits of ActuatorAxes, got ", args.axes);
  return actuators_.add(name, {.dof = -1, .body = body, .args = args});
}

int32_t ActuatorList::add(std::string_view name, const Actuator& actuator) {
  const ActuatorArgs& args = actuator.args.law;
  detail::check_finite({name, "gear"}, args.gear);
  detail::check_finite({name, "gain"}, args.gain);
  detail::check_finite({name, "bias"}, args.bias);
  detail::check_finite({name, "ctrl"}, args.ctrl);
  detail::check_finite({name, "act"}, args.act);
  detail::check_positive({name, "time"}, args.time);
  const auto dynamics = static_cast<int32_t>(args.dynamics);
  require(dynamics >= 0 && dynamics <= static_cast<int32_t>(ActuatorDynamics::FILTER_EXACT),
          ErrorKind::Value, name, ": dynamics: expected an ActuatorDynamics, got ", dynamics);
  for (const auto& [which, range] :
       {std::pair{"ctrl_range", args.ctrl_range}, std::pair{"force_range", args.force_range},
        std::pair{"act_range", args.act_range}}) {
    detail::check_finite({name, which}, range.x);
    detail::check_finite({name, which}, range.y);
    require(range.x <= range.y, ErrorKind::Value, name, ": ", which,
            ": expected the lower one first, got ", range.x, " and ", range.y);
  }
  const int32_t index = count();
  all_.push_back(actuator);
  if (args.label.empty()) all_.back().args.law.label = "actuator_" + std::to_string(index);
  return index;
}

void ActuatorList::append(const ActuatorList& other, int32_t first_dof, int32_t first_body,
                          const Transformf& xform) {
  ActuatorList added = other;
  added.move_bodies([&](int32_t& body, Transformf& frame) {
    if (body < 0)
      frame = math::multiply(xform, frame);
    else
      body += first_body;
  });
  for (Actuator& a : added.all_) {
    if (a.dof >= 0) a.dof += first_dof;
    all_.push_back(std::move(a));
  }
}

int32_t ActuatorList::state_count() const {
  return static_cast<int32_t>(std::count_if(all_.begin(), all_.end(), [](const Actuator& a) {
    return a.args.law.dynamics != ActuatorDynamics::NONE;
  }));
}

void ActuatorList::upload(Model& m) const {
  const auto upload = [&](auto& array, auto get) {
    std::vector<decltype(get(all_[0]))> values;
    for (const Actuator& a : all_) values.push_back(get(a));
    array.copy_from_host(std::span(values.data(), values.size()));
  };
  const auto has_state = [](const Actuator& a) {
    return a.args.law.dynamics != ActuatorDynamics::NONE;
  };
  int32_t states = 0;
  std::vector<float> act;
  for (const Actuator& a : all_) {
    m.actuator_label.push_back(a.args.law.label);
    if (has_state(a)) act.push_back(a.args.law.act);
  }
  m.act.copy_from_host(std::span<const float>(act));
  upload(m.actuator_dof, [](const Actuator& a) { return a.dof; });
  upload(m.actuator_body, [](const Actuator& a) { return Vec2i{a.body, a.args.reference_body}; });
  upload(m.actuator_axes, [](const Actuator& a) { return a.args.axes; });
  upload(m.actuator_frame, [](const Actuator& a) { return a.args.frame; });
  upload(m.actuator_reference, [](const Actuator& a) { return a.args.reference; });
  upload(m.actuator_wrench, [](const Actuator& a) { return a.args.wrench; });
  upload(m.actuator_state, [&](const Actuator& a) { return has_state(a) ? states++ : -1; });
  upload(m.actuator_dynamics,
         [](const Actuator& a) { return static_cast<int32_t>(a.args.law.dynamics); });
#define NOVAPHY_UPLOAD(array, member) \
  upload(m.array, [](const Actuator& a) { return a.args.law.member; })
  NOVAPHY_UPLOAD(actuator_gear, gear);
  NOVAPHY_UPLOAD(actuator_gain, gain);
  NOVAPHY_UPLOAD(actuator_bias, bias);
  NOVAPHY_UPLOAD(actuator_time, time);
  NOVAPHY_UPLOAD(actuator_ctrl_range, ctrl_range);
  NOVAPHY_UPLOAD(actuator_force_range, force_range);
  NOVAPHY_UPLOAD(actuator_act_range, act_range);
  NOVAPHY_UPLOAD(ctrl, ctrl);
#undef NOVAPHY_UPLOAD
}

}  // namespace novaphy
