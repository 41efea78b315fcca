// GradientInfo: what the gradient of a differentiable solver is.
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
// What gradients follow where contacts begin.
enum class DerivativeOf : uint8_t {
  Code,   // the steps as they ran: a contact begins in the same step
  Motion  // its time moves with the state (on the CPU, outside of captures)
};
}  // namespace diff

// Of the steps of a solver since the last clear. "Of the code": the derivative of what each step
// computes, with the contacts that it has. That a contact begins, ends or changes between sticking
// and slipping moves in time with the state is no part of it; `events` counts where that matters.
// "Of the motion": the times of events move too, so that the gradient tends to that of the motion
// as dt goes to 0.
struct GradientInfo {
  // "exact of the motion", "exact of the code", "implicit" (of the solutions of the steps),
  // "frozen" (points or normals of contacts that push are held), "surrogate": the worst of the
  // steps. Where times of events move, but the gradient may be another than that of the motion,
  // "surrogate": it is neither of both.
  std::string label;
  std::string reason;  // one sentence: what makes it so, and what follows
  int64_t steps = 0, exact_steps = 0, frozen_steps = 0, surrogate_steps = 0;
  // Contacts that began or ended, and that changed between sticking and slipping, between two
  // steps that follow each other; the sum of `began`, `ended` and `turned`.
  int64_t events = 0, began = 0, ended = 0, turned = 0;
  // Of MotionCounts.
  int64_t several = 0, one_sided = 0, ramp_steps = 0, landings = 0, phased = 0;
  int64_t lost_events = 0;  // for which a device has no room
  float least_approach = std::numeric_limits<float>::infinity();
  double least_separation = std::numeric_limits<double>::infinity();
  MotionEvents event_list;  // in the order of time
  float residual = 0.0f;    // largest, relative to the impulses
  // AdjointDrift of the last adjoint; NaN: none has measured some.
  double h_drift = std::numeric_limits<double>::quiet_NaN();
  int64_t h_step = -1, h_skipped = 0;
};

// How far an adjoint is from keeping H = p . f in steps without events: each step is compared with
// itself along its own motion. With y_k = D_k^T p_k+1, the rates f_k of the state in step k, and
// the gradient w_k by the forces u_k of step k (which targets and wrenches are too),
//   m_k = y_k . f_k - p_k+1 . f_k+1 + w_k . (u_k+1 - u_k) / dt
// is 0 but for O(dt). Steps that cannot be compared are skipped: the state was written behind them,
// they have not converged, or the next one has another dt.
struct AdjointDrift {
  double most = 0.0;     // |m_k|
  double largest = 0.0;  // |p . f|
  int64_t step = -1;     // of `most`, from the first of its chain
  int64_t steps = 0;     // that were compared
  int64_t skipped = 0;   // without what follows no step
  int64_t next = -1;     // the order of the step that was visited last

  // An adjoint visits steps from the last on; one that is not before the last one begins anew.
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

// Events at one time are in the order of their worlds, shapes, particles and joints.
NOVAPHY_DYNAMICS_API void sort_by_time(MotionEvents& events);

// Of steps whose events move in time.
struct MotionCounts {
  // Steps in which several pairs hit at once; of springs touches of more than one point or pair.
  int64_t several = 0;
  // Limits of joints that begin or end to push in what touches something; of springs touches of
  // what joints, elements or adhesion hold.
  int64_t unmoved = 0;
  // Of springs: touches whose begin or end is not in the steps, or is cut.
  int64_t one_sided = 0;
  int64_t landings = 0;    // events without a bounce that take two steps
  int64_t phased = 0;      // landings whose friction turns: the states depend on the phase
  int64_t stiff = 0;       // of springs: touches of few steps with a lever arm
  int64_t rough = 0;       // of springs: touches whose speed depends on the phase of the steps
  int64_t ramp_steps = 0;  // of springs: steps with contacts within half a step of begin or end
  int64_t moved = 0;       // steps whose gradient has more than that of the code
  bool of_springs = false;
  int64_t inexact = 0;  // with contacts, whose overlaps are of the code: not pgs_slop 0, pgs_erp 1
  float least_approach = std::numeric_limits<float>::infinity();      // m/s, rad/s
  double least_separation = std::numeric_limits<double>::infinity();  // steps, of one tree or body
  MotionEvents events = {};
  std::shared_ptr<AdjointDrift> drift = {};  // null: nobody measures some

  NOVAPHY_DYNAMICS_API void add(const std::shared_ptr<MotionEvent>& event);
};

// `implicit`: steps that are neither frozen nor a surrogate are of the solutions of the steps, and
// `exact_steps` counts them. `motion` (null: of the code): the events of the steps move in time.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const GradientCounts& counts, bool implicit = false,
                                                const MotionCounts* motion = nullptr);

// The worst label with its reason, the largest residual, and the sums of counts. At least one.
NOVAPHY_DYNAMICS_API GradientInfo worst_of(std::span<const GradientInfo> all);

}  // namespace novaphy
