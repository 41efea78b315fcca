// Actuators of a ModelBuilder.
#include <algorithm>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {

int32_t ModelBuilder::add_actuator(int32_t joint, const ActuatorArgs& args) {
  constexpr std::string_view name = "add_actuator";
  require(joint >= 0 && joint < joint_count(), ErrorKind::Index, name, ": joint: expected 0 to ",
          joint_count() - 1, ", got ", joint);
  const Joint& of = joints_[static_cast<size_t>(joint)];
  require(
      of.type == JointType::REVOLUTE || of.type == JointType::PRISMATIC || of.type == JointType::D6,
      ErrorKind::Value, name, ": joint ", joint, " (\"", of.label,
      "\"): expected a REVOLUTE, PRISMATIC or D6 joint, got ", joint_type_name(of.type));
  const int32_t axes = of.linear + of.angular;
  require(args.axis >= 0 && args.axis < axes, ErrorKind::Index, name, ": axis: expected 0 to ",
          axes - 1, " of joint ", joint, " (\"", of.label, "\"), got ", args.axis);
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
  const int32_t index = actuator_count();
  actuators_.push_back({of.qd_start + args.axis, args});
  if (args.label.empty()) actuators_.back().args.label = "actuator_" + std::to_string(index);
  return index;
}

void ModelBuilder::append_actuators(const ModelBuilder& b, int32_t first_dof) {
  for (Actuator actuator : b.actuators_) {
    actuator.dof += first_dof;
    actuators_.push_back(std::move(actuator));
  }
}

int32_t ModelBuilder::actuator_state_count() const {
  return static_cast<int32_t>(
      std::count_if(actuators_.begin(), actuators_.end(),
                    [](const Actuator& a) { return a.args.dynamics != ActuatorDynamics::NONE; }));
}

void ModelBuilder::upload_actuators(Model& m) const {
  const auto upload = [&](auto& array, auto get) {
    std::vector<decltype(get(actuators_[0]))> values;
    for (const Actuator& a : actuators_) values.push_back(get(a));
    array.copy_from_host(std::span(values.data(), values.size()));
  };
  const auto has_state = [](const Actuator& a) {
    return a.args.dynamics != ActuatorDynamics::NONE;
  };
  int32_t states = 0;
  std::vector<float> act;
  for (const Actuator& a : actuators_) {
    m.actuator_label.push_back(a.args.label);
    if (has_state(a)) act.push_back(a.args.act);
  }
  m.act.copy_from_host(std::span<const float>(act));
  upload(m.actuator_dof, [](const Actuator& a) { return a.dof; });
  upload(m.actuator_state, [&](const Actuator& a) { return has_state(a) ? states++ : -1; });
  upload(m.actuator_dynamics,
         [](const Actuator& a) { return static_cast<int32_t>(a.args.dynamics); });
#define NOVAPHY_UPLOAD(array, member) \
  upload(m.array, [](const Actuator& a) { return a.args.member; })
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
