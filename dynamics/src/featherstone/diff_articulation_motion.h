// Gradients of the motion: the times at which contacts begin move with the state. Runs on the host.
//
// A contact hits in step k, from the state x = (q, v). The step D_k applies its impulse at the
// start. A displacement dx of the state delays the impact by dt = -J_n dq / (J_n v). During this
// time the state moves on with the rates f- = (v, a-). The state moves back with f+ at the end of
// the event:
//   dx' = D (dx + f- dt) - f+ dt
// a- are the accelerations without the contacts that hit. f+ is taken at the end, under the
// controls of the event's step. An event ends with its step. An event that closes a gap without a
// bounce (a landing) ends one step later, or more steps if others begin then. D is the derivative
// of all steps of the event. Its adjoint, for y = D^T p:
//   s = y . f- - p . f+,  and the gradient by q gets s J_n / |J_n v|.
// A joint limit may begin or end to push, in a tree without contacts. The step then changes from
// the map F_A to the map F_B where a function g(x) changes its sign. A displacement of x changes
// the number of steps of each kind by a fraction:
//   dx + (F_B(x) - F_A(x)) (dg . dx) / (dg . (F_A(x) - x)),  then D of F_B
// A change of the limit itself adds a part to J_n dq and to dg . dx.
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

// A limit that begins or ends to push. Arrays are in the coordinates and rates of its tree (four
// numbers per quaternion).
struct LimitEvent {
  int32_t tree = 0;
  std::vector<float> jump_q, jump_qd;  // F_B(x) - F_A(x)
  std::vector<float> by_q, by_qd;      // dg
  float rate = 0.0f;                   // dg . (F_A(x) - x)
  int32_t dof = 0;
  float side = 1.0f;      // 1: the lower limit, -1: the upper limit
  float by_limit = 0.0f;  // derivative of g by the limit
};

// The data of a step about the events that begin in it, and about events that continue from earlier
// steps.
struct MotionNotes {
  ContactEvents found;
  std::vector<float> smooth;  // {dofs}: accelerations at the start without contacts that hit
  std::vector<LimitEvent> limits;
  std::vector<float> branch;  // {dofs}: branches of the step
  // {dofs}: as `smooth`, under the controls of the event that ends at the start
  std::vector<float> after;
  std::vector<char> inside;  // {trees}: 1 if an event continues at the start; empty: no tree
  // The index of the step in its chain of consecutive steps, and the time at its start.
  int64_t number = 0, chain = 0;
  double time = 0.0;    // s
  MotionEvents listed;  // the MotionEvents of `found` and `limits`
  std::weak_ptr<MotionNotes> next;
  // the step whose controls apply to the continuing event
  std::shared_ptr<const ArticulationStep::Step> controls;
  // {trees}. mismatch: passed from the next step in an adjoint. delay: passed from the previous
  // step in a tangent.
  std::vector<float> mismatch, delay;
  // The AdjointDrift of the solver, and of the tape. Null: not measured.
  std::array<std::shared_ptr<AdjointDrift>, 2> drifts;
  int64_t order = 0;  // index among the steps of the solver
  // The changes of the forces since the step before, in the order of kForces. Empty: no change.
  std::array<std::vector<float>, 4> force_change;
  uint64_t versions[2] = {};  // of the new coordinates and rates, right after the step
  bool breaks = false;        // the state was written before the step, or dt has changed

  bool stands_in_event() const { return !inside.empty(); }
  bool in_contact() const { return stands_in_event() || !found.events.empty(); }
  bool concerned() const { return in_contact() || !limits.empty(); }
  // Returns whether the gradient of the step has a term from moved times, besides that of the code.
  bool moves() const { return !found.events.empty() || !limits.empty(); }
};

// own_gradient makes separate memory for the gradient by an input. give_gradient writes or adds
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

// Adds a value to a row of the gradient by an input, if that gradient is requested.
inline void add_gradient(const nova::InputGradient& to, int32_t row, double value) {
  if (to.grad.defined()) numbers(to.grad)[row] += static_cast<float>(value);
}
// Returns a row of an input's tangent. An undefined tangent is zero.
inline double tangent_at(const nova::Tensor& of, int32_t row) {
  return of.defined() ? double{numbers(of)[row]} : 0.0;
}
// Returns the index of the input with the lower limits (`side` 1) or the upper limits (-1).
size_t limit_input(float side);
// Returns whether any of the requested gradients is changed by moved event times.
bool moves_by(std::span<const nova::InputGradient> gradients);

// Removes and returns the step that ended where `step` starts, and remembers `step`. Null: none.
std::shared_ptr<const ArticulationStep::Step> take_before(
    ArticulationStep::Shared& shared, const std::shared_ptr<const ArticulationStep::Step>& step);

// Returns the first coordinate of a tree and the number of its coordinates.
std::pair<int32_t, int32_t> coordinates_of(const ArticulationStep::Step& step, int32_t tree);
// Calls visit(number, row) for the dofs of an event: the number within the event, and the model's
// row.
template <class F>
void for_dofs(const ArticulationStep::Step& s, const ContactEvent& event, const F& visit) {
  const ArticulationRows* const rows = rows_of_step(s);
  size_t at = 0;
  for (const int32_t tree : event.trees)
    for (int32_t k = 0; k < rows[tree].dof_count; ++k)
      visit(at++, static_cast<size_t>(rows[tree].first_dof + k));
}
// These functions fill the event list of GradientInfo. list_events adds the contacts that begin in
// a step, with their times, and completes the landings of the step before (null: none). list_limit
// adds a dof that reaches its limit. list_mismatch stores H (the adjoint times the rates) of an
// event: `h_before` {trees} before it, and `mismatch`, by which H drops at the event.
void list_events(const ArticulationStep::Step& step, const ArticulationArguments& in,
                 const ArticulationStep::Step* before);
void list_limit(const ArticulationStep::Step& step, int32_t tree, int32_t dof);
void list_mismatch(const ContactEvent& event, std::span<const double> h_before, double mismatch);
// Returns whether a contact of curved shapes, with a normal from a search, pushes without a bounce.
bool holds_searched(const ArticulationStep::Step& step, const ArticulationArguments& in);
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
// Adds the limits that are hit as constraint rows (rate_bounds.h) in a step to the step's events.
// `last`: notes of the step before, or null. smooth(limits): the accelerations without contacts
// that hit and without the limits of these dofs.
using Smooth = std::function<std::vector<float>(std::span<const int32_t>)>;
void find_stops(const ArticulationStep::Step& step, const MotionNotes* last, const Smooth& smooth);
// Finds the limits (as springs) that push in the step but not in the step before, or the reverse.
// `before`: null: none.
void note_limits(const ArticulationStep::Step& step, const MotionNotes* before);
// Adds the effect of these limits to the gradients by the state at the start of the step and by the
// limits.
void limits_vjp(const ArticulationStep::Step& step, const ArticulationArguments& in, float* of_q,
                float* of_qd, std::span<const nova::InputGradient> gradients);
// Adds the effect of these limits to the tangents `moved` of the inputs.
void limits_jvp(const ArticulationStep::Step& step, const ArticulationArguments& in,
                std::span<const nova::Tensor> moved);
// Adds the effect of the delays of a step's events to the gradients by its coordinates (as
// tangents) and by limits. mismatch, h_before {trees}: the drop of H at an event, and H before the
// step. p_q {dofs}: the gradient by the new coordinates.
void delays_vjp(const ArticulationStep::Step& step, std::span<const float> mismatch,
                std::span<const double> h_before, std::span<const float> p_q,
                std::span<float> correction, std::span<const nova::InputGradient> gradients);
// Adds the delays {trees} that the tangents of the inputs cause. `jump` {dofs} gets the
// displacement between groups of one event that have different delays.
void delays_jvp(const ArticulationStep::Step& step, const ArticulationArguments& in,
                std::span<const nova::Tensor> moved, std::span<float> delay, std::span<float> jump);
// Finds the events of a step. Call this after the step has run, before the solver's contacts are
// used again. `before`: the step that ended where this step starts; null: none.
void note_motion(const std::shared_ptr<const ArticulationStep::Step>& step,
                 const std::shared_ptr<const ArticulationStep::Step>& before);

// Stores the values that AdjointDrift compares, after a step has run. `before`: as for note_motion.
inline constexpr std::array<size_t, 4> kForces = {kAt.joint_f, kAt.body_f, kAt.target_q,
                                                  kAt.target_qd};
void note_drift(const ArticulationStep::Step& step, const ArticulationStep::Step* before);

// The gradients by the coordinates (as tangents) and by the rates after a step, {dofs} each.
struct Costate {
  std::vector<float> of_q, of_qd;
};
Costate costate_behind(const ArticulationStep::Step& step, const ArticulationArguments& in,
                       std::span<const nova::Tensor> outputs);

// Returns whether an adjoint or a tangent of a step holds the times of events, because a capture
// records it. ErrorKind::NotImplemented: with DerivativeOf::Motion.
bool holds_times(const ArticulationStep::Step& step);
// Runs the adjoint of a step with moved event times. `run`: the adjoint of the code.
using Adjoint = std::function<void(std::span<const nova::InputGradient>)>;
void motion_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run);
// Runs the adjoint of a step without events, and adds the step to AdjointDrift.
void drift_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
               std::span<const nova::InputGradient> gradients, const Adjoint& run);
// Runs the adjoint of any step, and fills an entry of the AdjointRecord. ErrorKind::NotImplemented:
// on a device, or in a capture.
void record_vjp(const ArticulationStep::Step& step, std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run,
                AdjointRecord& record);
// Stores in an AdjointRecord how much of the loss's tangent is due to the delays of bounces,
// besides the changes of their impulses: p . (f without the bounce - f after it) delay, with the
// gradient p by the state after the step. delay {trees}, jump {dofs}: as in delays_jvp. qdd {dofs}:
// the accelerations in f after the step. inside {trees}: 1 if an event continues; landings have no
// part.
void record_delays(const ArticulationStep::Step& step, const ArticulationArguments& in,
                   std::span<const float> delay, std::span<const float> jump,
                   std::span<const float> qdd, std::span<const char> inside);
// Runs the tangent of a step with moved event times. `run`: the tangent of the code.
using Tangent = std::function<void(std::span<const nova::Tensor>)>;
void motion_jvp(const ArticulationStep::Step& step, std::span<const nova::Tensor> inputs,
                std::span<const nova::Tensor> outputs, const Tangent& run);

}  // namespace novaphy::diff::detail
