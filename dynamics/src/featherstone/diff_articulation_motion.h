// Gradients of the motion: the times at which contacts begin move with the state. On the host.
//
// A contact hits in step k, from the state x = (q, v). The step D_k has its impulse at the start. A
// displacement dx of the state delays the impact by dt = -J_n dq / (J_n v). The state moves on with
// f- = (v, a-) for this time, and moves back with f+ at the end of the event:
//   dx' = D (dx + f- dt) - f+ dt
// a- are the accelerations without the contacts that hit. f+ is taken at the end, under the
// controls of the event's step.
// An event ends with its step. An event that closes a gap without a bounce ends one step later, or
// more steps if others begin then. D is the derivative of all its steps. Its transpose, for y = D^T
// p:
//   s = y . f- - p . f+,  and the gradient of q gets s J_n / |J_n v|.
// A limit of a joint may begin or end to push, in a tree that touches nothing. The step then
// changes from F_A to F_B where a number g(x) changes its sign. A displacement of x changes the
// number of steps of each kind by a fraction:
//   dx + (F_B(x) - F_A(x)) (dg . dx) / (dg . (F_A(x) - x)),  then D of F_B
// A move of the limit itself adds its part to J_n dq and to dg . dx.
// Source: the saltation matrix of hybrid systems; Kong, Payne, Zhu, Johnson, Saltation Matrices
// (2024).
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "contact_events.h"
#include "diff_articulation_parts.h"
#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/dynamics/featherstone/diff_articulation_step.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff::detail {

// A change of a limit's branch, in raw coordinates and rates of its tree.
struct LimitEvent {
  int32_t tree = 0;
  std::vector<float> jump_q, jump_qd;  // F_B(x) - F_A(x)
  std::vector<float> by_q, by_qd;      // dg
  float rate = 0.0f;                   // dg . (F_A(x) - x)
  int32_t dof = 0;
  float side = 1.0f;      // of its limit: 1 the lower one, -1 the upper one
  float by_limit = 0.0f;  // of g
};

// The record of a step about the events that begin in it, and about those that go on in it.
struct MotionNotes {
  ContactEvents found;
  std::vector<float> smooth;  // {dofs}: accelerations at the start without contacts that hit
  std::vector<LimitEvent> limits;
  std::vector<float> branch;  // {dofs}: of the step
  // {dofs}: smooth under the controls of the event that ends at the start
  std::vector<float> after;
  std::vector<char> inside;  // {trees}: 1 if the start is inside of an event; empty: no tree
  // The index of the step in its chain of consecutive steps, and the time at its start.
  int64_t number = 0, chain = 0;
  double time = 0.0;  // s
  MotionEvents told;  // the reported events of `found` and `limits` that begin here
  std::weak_ptr<MotionNotes> next;
  // the step whose controls the ongoing event has
  std::shared_ptr<const ArticulationStep::Step> controls;
  // {trees}: mismatch comes from the next step in an adjoint, delay from the previous step in a
  // tangent.
  std::vector<float> mismatch, delay;
  // The AdjointDrift of the solver and of the tape. Null: not measured.
  std::array<std::shared_ptr<AdjointDrift>, 2> drifts;
  int64_t order = 0;  // order among the steps of the solver
  // The changes of the forces since the step before, by kForces. Empty: no change.
  std::array<std::vector<float>, 4> force_change;
  uint64_t versions[2] = {};  // of the new coordinates and rates, after the step
  bool breaks = false;        // the state was written before the step, or dt has changed

  bool stands_in_event() const { return !inside.empty(); }
  bool in_contact() const { return stands_in_event() || !found.events.empty(); }
  bool concerned() const { return in_contact() || !limits.empty(); }
  // Returns whether the gradient of the step has more than that of the code.
  bool moves() const { return !found.events.empty() || !limits.empty(); }
};

// own_gradient makes separate memory for the gradient of an input. give_gradient writes or adds
// this memory to the destination.
inline nova::InputGradient own_gradient(const ArticulationStep::Step& s, size_t input) {
  return {nova::Tensor(s.in(input).shape(), nova::DType::F32, Device::cpu()), false};
}
inline void give_gradient(const nova::InputGradient& from, const nova::InputGradient& to) {
  if (!to.grad.defined()) return;
  const float* const own = numbers(from.grad);
  float* const x = numbers(to.grad);
  for (int64_t i = 0; i < to.grad.size(); ++i) x[i] = to.add ? x[i] + own[i] : own[i];
}

// Adds a value to a row of an input's gradient, if that gradient is wanted.
inline void add_gradient(const nova::InputGradient& to, int32_t row, double value) {
  if (to.grad.defined()) numbers(to.grad)[row] += static_cast<float>(value);
}
// Returns a row of an input's tangent. An undefined tangent is zero.
inline double tangent_at(const nova::Tensor& of, int32_t row) {
  return of.defined() ? double{numbers(of)[row]} : 0.0;
}
// Returns the input that holds the lower limits (`side` 1) or the upper limits (-1).
size_t limit_input(float side);
// Returns whether an adjoint has a gradient that the times of events change.
bool moves_by(std::span<const nova::InputGradient> gradients);

// Returns the first coordinate of a tree and the number of its coordinates.
std::pair<int32_t, int32_t> coordinates_of(const ArticulationStep::Step& step, int32_t tree);
// Calls visit(number, row) for the dofs of an event.
template <class F>
void for_dofs(const ArticulationStep::Step& s, const ContactEvent& event, const F& visit) {
  const ArticulationRows* const rows = rows_of_step(s);
  size_t at = 0;
  for (const int32_t tree : event.trees)
    for (int32_t k = 0; k < rows[tree].dof_count; ++k)
      visit(at++, static_cast<size_t>(rows[tree].first_dof + k));
}
// Three functions that fill the event list of GradientInfo. tell_events adds the contacts that
// begin in a step, with their times, and completes the landings of the step before (null: none).
// tell_limit adds a dof that reaches its limit. tell_mismatch sets H (the adjoint times the rates)
// of an event: `h_before` for each tree, and the mismatch, by which H drops at the event.
void tell_events(const ArticulationStep::Step& step, const ArticulationArguments& in,
                 const ArticulationStep::Step* before);
void tell_limit(const ArticulationStep::Step& step, int32_t tree, int32_t dof);
void tell_mismatch(const ContactEvent& event, std::span<const double> h_before, double mismatch);
// Memory for the limits of a step without those of some dofs, which `in` then reads. Trees do not
// share lanes meanwhile: lanes read the limits of the model.
struct LiftedLimits {
  LiftedLimits(const ArticulationStep::Step& step, std::span<const int32_t> dofs,
               ArticulationArguments& in);
  LiftedLimits(const LiftedLimits&) = delete;
  LiftedLimits& operator=(const LiftedLimits&) = delete;
  ~LiftedLimits();
  std::vector<float> lower, upper;
  TreeSteps* trees = nullptr;
};
// Adds the limits as rows that hit in a step to the events of its contacts. `last` as below;
// `smooth(limits)`: the accelerations without contacts that hit and the limits of these dofs.
using Smooth = std::function<std::vector<float>(std::span<const int32_t>)>;
void find_stops(const ArticulationStep::Step& step, const MotionNotes* last, const Smooth& smooth);
// Notes the limits of a step that pushed otherwise in the one before (null: none).
void note_limits(const ArticulationStep::Step& step, const MotionNotes* before);
// Adds the effect of the limits to the gradients of the state at the start of the step and of the
// limits.
void limits_vjp(const ArticulationStep::Step& step, const ArticulationArguments& in, float* of_q,
                float* of_qd, std::span<const nova::InputGradient> gradients);
// Adds the effect of the limits to the tangents `moved` of the inputs.
void limits_jvp(const ArticulationStep::Step& step, const ArticulationArguments& in,
                std::span<const nova::Tensor> moved);
// Adds the effect of the delays of a step's events to the gradients of its coordinates, as
// tangents, and of limits. mismatch, h_before: {trees}; h_before is H before the step. p_q: {dofs},
// of the new coordinates.
void delays_vjp(const ArticulationStep::Step& step, std::span<const float> mismatch,
                std::span<const double> h_before, std::span<const float> p_q,
                std::span<float> correction, std::span<const nova::InputGradient> gradients);
// Adds the delays {trees} that the tangents of the inputs cause, and the jumps {dofs} by which
// groups of one event move apart.
void delays_jvp(const ArticulationStep::Step& step, const ArticulationArguments& in,
                std::span<const nova::Tensor> moved, std::span<float> delay,
                std::span<float> jump);
// Call this after a step has run, before the contacts of the solver are used again. `before`: the
// step that ended where this one starts; null: none.
void note_motion(const std::shared_ptr<const ArticulationStep::Step>& step,
                 const std::shared_ptr<const ArticulationStep::Step>& before);

// Notes the values that AdjointDrift compares, after a step has run. `before`: as above.
inline constexpr std::array<size_t, 4> kForces = {kAt.joint_f, kAt.body_f, kAt.target_q,
                                                  kAt.target_qd};
void note_drift(const ArticulationStep::Step& step, const ArticulationStep::Step* before);

// The gradients with respect to the coordinates after a step, as tangents, and with respect to its
// rates; {dofs} each.
struct Costate {
  std::vector<float> of_q, of_qd;
};
Costate costate_behind(const ArticulationStep::Step& step, const ArticulationArguments& in,
                       std::span<const nova::Tensor> outputs);

// Runs the adjoint of a step with the times of its events. `run` is the adjoint of the code.
using Adjoint = std::function<void(std::span<const nova::InputGradient>)>;
void motion_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run);
// Runs the adjoint of a step without events, and adds the step to AdjointDrift.
void drift_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
               std::span<const nova::InputGradient> gradients, const Adjoint& run);
// Runs the adjoint of any step, and fills an entry of the record. ErrorKind::NotImplemented: on a
// device, or in a capture.
void record_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run,
                AdjointRecord& record);
// Runs the tangent of a step with the times of its events. `run` is the tangent of the code.
using Tangent = std::function<void(std::span<const nova::Tensor>)>;
void motion_jvp(const ArticulationStep::Step& step, std::span<const nova::Tensor> inputs,
                std::span<const nova::Tensor> outputs, const Tangent& run);

}  // namespace novaphy::diff::detail
