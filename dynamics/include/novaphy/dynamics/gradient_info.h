// GradientInfo: a report on how exact the gradient of a differentiable solver is.
#pragma once

#include <limits>
#include <memory>
#include <span>
#include <string>

#include "novaphy/dynamics/articulation/gradient_counts.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/motion_events.h"

namespace novaphy {

namespace diff {
// Selects the derivative that is computed where contacts begin.
enum class DerivativeOf : uint8_t {
  Auto,   // Motion where the solver supports it, else Code
  Code,   // of the steps as they ran: a contact begins in the same step
  Motion  // the time of the begin moves with the state (CPU only, not in captures)
};
}  // namespace diff

// Describes the gradient over the steps of a solver since the last clear.
//
// A derivative "of the code" is that of the computed steps, each with the contacts that it has. The
// times at which contacts begin, end, or change between sticking and slipping stay constant.
// `events` counts these changes. A derivative "of the motion" moves these times with the state, so
// it tends to the derivative of the exact motion as dt goes to 0.
struct GradientInfo {
  // The worst label of the steps: "exact of the motion", "exact of the code", "implicit"
  // (derivative of the solution of a step), "frozen" (points or normals of active contacts are
  // constant), or "surrogate". The label is also "surrogate" if times of events move but the
  // gradient may differ from that of the motion.
  std::string label;
  std::string reason;  // sentences on the cause and the consequence
  int64_t steps = 0, exact_steps = 0, frozen_steps = 0, surrogate_steps = 0;
  // Contacts that began, ended, or changed between sticking and slipping (`turned`) between two
  // consecutive steps. `events` is the sum of all three.
  int64_t events = 0, began = 0, ended = 0, turned = 0;
  // Members of MotionCounts with the same names.
  int64_t several = 0, one_sided = 0, ramp_steps = 0, landings = 0, phased = 0;
  int64_t searched = 0;
  int64_t lost_events = 0;  // events for which a device had no room
  float least_approach = std::numeric_limits<float>::infinity();
  double least_separation = std::numeric_limits<double>::infinity();
  // Duration of a touch of the stiffest penalty contact, in steps: pi / (dt w), with w as in
  // diff_noted_springs.h.
  float steps_per_contact = std::numeric_limits<float>::infinity();
  MotionEvents event_list;  // in the order of time
  float residual = 0.0f;    // the largest residual, relative to the impulses
  // Members of AdjointDrift of the last adjoint. NaN: no adjoint has measured the drift.
  double h_drift = std::numeric_limits<double>::quiet_NaN();
  int64_t h_step = -1, h_skipped = 0;
};

// A check of an adjoint p: H = p . f should stay constant over steps without events. f_k are the
// rates of the state in step k, D_k is the derivative of step k, and y_k = D_k^T p_k+1. w_k is the
// gradient by the forces u_k of step k (targets and wrenches included). A correct adjoint has a
// drift
//   m_k = y_k . f_k - p_k+1 . f_k+1 + w_k . (u_k+1 - u_k) / dt
// of 0 up to O(dt). Steps that cannot be compared are skipped: the state after the step was
// written, the step has not converged, or the next step has another dt.
struct AdjointDrift {
  double most = 0.0;     // the largest |m_k|
  double largest = 0.0;  // the largest |p . f|
  int64_t step = -1;     // the step of `most`, counted from the first step of its chain
  int64_t steps = 0;     // number of compared steps
  int64_t skipped = 0;   // number of skipped steps that have a next step
  int64_t next = -1;     // order of the step that was visited last

  // Adjoints visit steps in reverse order. A step at or after the last visited one begins a new
  // adjoint.
  void visit(int64_t order) {
    if (order >= next) *this = {};
    next = order;
  }
  void add(double m, double h, int64_t at) {
    const auto size = [](double x) { return x < 0.0 ? -x : x; };
    largest = largest < size(h) ? size(h) : largest;
    ++steps;
    if (steps > 1 && !(size(m) > most)) return;
    most = size(m);
    step = at;
  }
};

// Sorts events by time. Events at the same time are ordered by world, shapes, particle and joint.
NOVAPHY_DYNAMICS_API void sort_by_time(MotionEvents& events);

// Counts over steps for which DerivativeOf::Motion moves the times of events. "With springs" means
// with penalty contacts.
struct MotionCounts {
  // Steps in which several pairs, or points of a pair, hit at once. With springs: touches of more
  // than one point or pair.
  int64_t several = 0;
  // Joint limits that begin or end to push, in a tree that also has contacts. With springs: touches
  // of bodies or particles that are also subject to joints, elements or adhesion.
  int64_t unmoved = 0;
  // With springs: touches whose begin or end is not among the steps, or is cut by a written state.
  int64_t one_sided = 0;
  int64_t landings = 0;    // events without a bounce, which take two steps
  int64_t phased = 0;      // landings whose friction turns: the states depend on the phase
  // Steps with a contact that holds or lands, between curved shapes. Its normal comes from a search
  // with an error in each step, which 1 / dt amplifies.
  int64_t searched = 0;
  int64_t stiff = 0;       // with springs: touches of few steps whose force turns a body
  int64_t rough = 0;       // with springs: touches whose speed depends on the phase of the steps
  int64_t ramp_steps = 0;  // with springs: steps with contacts within half a step of begin or end
  int64_t moved = 0;       // steps whose gradient includes a term from moved times
  bool of_springs = false;
  int64_t limits = 0;  // joint limits that begin or end to push; their times stay constant
  // Steps with contacts that correct overlaps, unless pgs_slop = 0 and pgs_erp = 1.
  int64_t inexact = 0;
  float least_approach = std::numeric_limits<float>::infinity();      // m/s or rad/s
  double least_separation = std::numeric_limits<double>::infinity();  // steps, of one tree or body
  // DerivativeOf::Auto: where the solver does not support Motion, as "on a device". The times of
  // such steps stay constant. Null: all times move.
  const char* held = nullptr;
  // The chain of the last step, and the number of its steps.
  int64_t chain = 0, chain_steps = 0;
  MotionEvents events = {};
  std::shared_ptr<AdjointDrift> drift = {};  // null: not measured

  NOVAPHY_DYNAMICS_API void add(const std::shared_ptr<MotionEvent>& event);
};

// Makes the report from counts. `implicit`: a step that is neither frozen nor a surrogate has the
// derivative of its solution; `exact_steps` counts these steps. `motion`: the counts of events
// whose times move; null for DerivativeOf::Code.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const GradientCounts& counts, bool implicit = false,
                                                const MotionCounts* motion = nullptr);

// Returns the worst label with its reason, the largest residual, and the sums of counts. `all` has
// at least one entry.
NOVAPHY_DYNAMICS_API GradientInfo worst_of(std::span<const GradientInfo> all);

}  // namespace novaphy
