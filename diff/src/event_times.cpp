#include "novaphy/diff/event_times.h"

#include <algorithm>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/nova/launch_argument.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

constexpr const char* kName = "diff.event_times";
using Run = std::span<const std::shared_ptr<MotionEvent>>;

float* numbers(const nova::Tensor& of) { return static_cast<float*>(of.range()->data()); }

// Returns the array on which an event's time depends: an array of a state or of the model.
nova::Tensor array_of(const SimState& state, const MotionEvent::TimeDerivative& derivative) {
  const auto tensor_of = [](const auto& array) {
    const nova::Operand o = nova::operand_of(array);
    return nova::Tensor(o.range, {o.rows, o.width}, nova::DType::F32);
  };
  switch (derivative.of) {
    case MotionArray::JointQ:
      return tensor_of(state.joint_q);
    case MotionArray::BodyQ:
      return tensor_of(state.body_q);
    case MotionArray::ParticleQ:
      return tensor_of(state.particle_q);
    default:
      return tensor_of(derivative.limit);
  }
}

// The events that begin in one step. each() calls visit(event, input, derivative) for each
// derivative of an event's time with respect to an input.
struct StepEvents {
  MotionEvents events;
  std::vector<const void*> arrays;  // memory of the inputs
  std::vector<size_t> inputs;       // input of each derivative, for the events one after the other

  template <class F>
  void each(const F& visit) const {
    size_t at = 0;
    for (size_t row = 0; row < events.size(); ++row)
      for (const MotionEvent::TimeDerivative& derivative : events[row]->derivatives)
        visit(row, inputs[at++], derivative);
  }
  void gradients(const nova::Tensor& of, std::span<const nova::InputGradient> to) const {
    for (const nova::InputGradient& g : to)
      if (g.wanted() && !g.add) std::fill_n(numbers(g.grad), g.grad.size(), 0.0f);
    if (!of.defined()) return;
    each([&](size_t row, size_t input, const MotionEvent::TimeDerivative& derivative) {
      if (!to[input].wanted()) return;
      float* const grad = numbers(to[input].grad) + derivative.first;
      for (size_t i = 0; i < derivative.by.size(); ++i)
        grad[i] += numbers(of)[row] * derivative.by[i];
    });
  }
  void tangents(std::span<const nova::Tensor> of, const nova::Tensor& to) const {
    std::fill_n(numbers(to), to.size(), 0.0f);
    each([&](size_t row, size_t input, const MotionEvent::TimeDerivative& derivative) {
      if (!of[input].defined()) return;
      const float* const tangent = numbers(of[input]) + derivative.first;
      for (size_t i = 0; i < derivative.by.size(); ++i)
        numbers(to)[row] += tangent[i] * derivative.by[i];
    });
  }
};

// Returns the times of the events of one step, as a function of the state from which the step
// starts and of the limits of joints.
nova::Tensor times_of(const SimState& state, Run run, nova::Tape& tape) {
  const auto step = std::make_shared<StepEvents>();
  step->events.assign(run.begin(), run.end());
  nova::CustomOp op{.name = "event_times", .inputs = {}, .outputs = {}, .vjp = nullptr};
  for (const auto& event : run)
    for (const MotionEvent::TimeDerivative& derivative : event->derivatives) {
      const nova::Tensor array = array_of(state, derivative);
      const auto known = std::ranges::find(step->arrays, array.range()->data());
      step->inputs.push_back(static_cast<size_t>(known - step->arrays.begin()));
      if (known != step->arrays.end()) continue;
      step->arrays.push_back(array.range()->data());
      op.inputs.push_back(array);
    }
  const nova::Tensor times({static_cast<int64_t>(run.size())}, nova::DType::F32, Device::cpu());
  for (size_t row = 0; row < run.size(); ++row)
    numbers(times)[row] = static_cast<float>(run[row]->time);
  op.outputs = {times};
  op.vjp = [step](std::span<const nova::Tensor> of, std::span<const nova::InputGradient> to) {
    step->gradients(of[0], to);
  };
  op.jvp = [step](std::span<const nova::Tensor> of, std::span<const nova::Tensor> to) {
    step->tangents(of, to[0]);
  };
  op.submits_only = false;
  tape.record_custom(std::move(op));
  return times;
}

MotionEvents events_on(const nova::Tape& tape) {
  MotionEvents all;
  bool any = false;
  for (const auto& witness : tape.witnesses())
    if (const auto* of = dynamic_cast<const GradientWitness*>(witness.get())) {
      any = any || of->has_events();
      for (const auto& event : of->events()) all.push_back(event);
    }
  require(any, ErrorKind::Value, kName,
          ": trajectory: expected steps of a solver with contact_gradient=\"motion\" on the active "
          "tape, got none");
  sort_by_time(all);
  return all;
}

// Finds the state from which the step of an event starts. The search begins at index `at` and
// writes the result to `at`. Returns false if the trajectory does not have the state.
bool find_state(const Trajectory& trajectory, const MotionEvent& event, int32_t& at) {
  for (int32_t k = 0; k <= trajectory.steps(); ++k) {
    const int32_t t = (at + k) % (trajectory.steps() + 1);
    const SimState& state = trajectory.state(t);
    const auto is = [&](const auto& array) {
      return array.rows() > 0 && array.range()->data() == event.start &&
             array.range()->version() == event.version;
    };
    if (!is(state.joint_q) && !is(state.body_q) && !is(state.particle_q)) continue;
    at = t;
    return true;
  }
  return false;
}

}  // namespace

nova::Tensor event_times(const Trajectory& trajectory) {
  nova::Tape* const tape = nova::Tape::active();
  require(tape != nullptr, ErrorKind::Value, kName, ": expected an active Tape, got none");
  require(trajectory.checkpoint_interval() == 1, ErrorKind::NotImplemented, kName,
          ": trajectory: expected one that keeps all states, got one with checkpoints");
  nova::flush_deferred();
  const MotionEvents all = events_on(*tape);
  std::vector<nova::Tensor> parts;
  int32_t known = 0;  // index of the state of the last event, because the next state is near
  for (size_t first = 0, end = 0; first < all.size(); first = end) {
    const MotionEvent& of = *all[first];
    while (end < all.size() && all[end]->start == of.start && all[end]->version == of.version)
      ++end;
    if (!find_state(trajectory, of, known)) continue;
    parts.push_back(times_of(trajectory.state(known), Run(all).subspan(first, end - first), *tape));
  }
  if (parts.empty()) return nova::Tensor({0}, nova::DType::F32, Device::cpu());
  return parts.size() == 1 ? parts[0] : nova::concat(parts);
}

}  // namespace novaphy::diff
