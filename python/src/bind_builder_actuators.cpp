// Actuators of ModelBuilder.
#include "convert.h"
#include "doc_builder_joints.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy::python {
namespace {

using Builder = py::class_<ModelBuilder>;
using Pair = std::array<float, 2>;
using Triple = std::array<float, 3>;

Vec2f range_of(const std::optional<Pair>& range) {
  return range ? Vec2f{(*range)[0], (*range)[1]} : Vec2f{-kJointUnlimited, kJointUnlimited};
}

ActuatorArgs law_of(const Triple& gain, const Triple& bias, int32_t dynamics, float time,
                    const std::optional<Pair>& ctrl_range, const std::optional<Pair>& force_range,
                    const std::optional<Pair>& act_range, float ctrl, float act,
                    const std::optional<std::string>& label) {
  return {.gain = {gain[0], gain[1], gain[2]},
          .bias = {bias[0], bias[1], bias[2]},
          .dynamics = static_cast<ActuatorDynamics>(dynamics),
          .time = time,
          .ctrl_range = range_of(ctrl_range),
          .force_range = range_of(force_range),
          .act_range = range_of(act_range),
          .ctrl = ctrl,
          .act = act,
          .label = label.value_or("")};
}
// Binds a function whose arguments are `first`, then those of law_of.
template <class Function, class... First>
void def(Builder& c, const char* name, Function function, const char* doc, const First&... first) {
  c.def(name, function, first..., "gain"_a = Triple{1.0f, 0.0f, 0.0f}, "bias"_a = Triple{},
        "dynamics"_a = 0, "time"_a = 1.0f, "ctrl_range"_a = py::none(),
        "force_range"_a = py::none(), "act_range"_a = py::none(), "ctrl"_a = 0.0f, "act"_a = 0.0f,
        "label"_a = py::none(), doc);
}

void bind_actuators(Builder& c) {
  def(
      c, "add_actuator",
      [](ModelBuilder& b, int32_t joint, int32_t axis, float gear, const Triple& gain,
         const Triple& bias, int32_t dynamics, float time, const std::optional<Pair>& ctrl_range,
         const std::optional<Pair>& force_range, const std::optional<Pair>& act_range, float ctrl,
         float act, const std::optional<std::string>& label) {
        ActuatorArgs args = law_of(gain, bias, dynamics, time, ctrl_range, force_range, act_range,
                                   ctrl, act, label);
        args.axis = axis;
        args.gear = gear;
        return b.add_actuator(joint, args);
      },
      doc::kAddActuator, "joint"_a, py::kw_only(), "axis"_a = 0, "gear"_a = 1.0f);
}

void bind_body_actuators(Builder& c) {
  def(
      c, "add_body_actuator",
      [](ModelBuilder& b, int32_t body, const std::array<float, 6>& wrench, py::handle frame,
         std::optional<int32_t> reference_body, py::handle reference, const Triple& gain,
         const Triple& bias, int32_t dynamics, float time, const std::optional<Pair>& ctrl_range,
         const std::optional<Pair>& force_range, const std::optional<Pair>& act_range, float ctrl,
         float act, const std::optional<std::string>& label) {
        constexpr auto bits = static_cast<int32_t>(ActuatorAxes::REFERENCE_FORCE) |
                              static_cast<int32_t>(ActuatorAxes::REFERENCE_MOMENT) |
                              static_cast<int32_t>(ActuatorAxes::LENGTH);
        const auto& w = wrench;
        return b.add_body_actuator(
            body, {.frame = to_transform(frame, "add_body_actuator: frame"),
                   .reference_body = reference_body.value_or(-1),
                   .reference = to_transform(reference, "add_body_actuator: reference"),
                   .wrench = {{w[0], w[1], w[2]}, {w[3], w[4], w[5]}},
                   .axes = reference_body ? bits : 0,
                   .law = law_of(gain, bias, dynamics, time, ctrl_range, force_range, act_range,
                                 ctrl, act, label)});
      },
      doc::kAddBodyActuator, "body"_a, py::kw_only(), "wrench"_a, "frame"_a = py::none(),
      "reference_body"_a = py::none(), "reference"_a = py::none());
}

}  // namespace

void bind_builder_actuators(Builder& c) {
  bind_actuators(c);
  bind_body_actuators(c);
  c.def_property_readonly("actuator_count", &ModelBuilder::actuator_count,
                          "The number of actuators.");
}

}  // namespace novaphy::python
