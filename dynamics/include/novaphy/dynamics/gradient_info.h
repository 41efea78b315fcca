// GradientInfo: what the gradient of a differentiable solver is.
#pragma once

#include <string>

#include "novaphy/dynamics/articulation/gradient_counts.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Of the steps of a solver since the last clear. "Of the code": the derivative of what each step
// computes, with the contacts that it has. That a contact begins, ends or changes between sticking
// and slipping moves in time with the state is no part of it; `events` counts where that matters.
// "Of the motion": the times of events move too, so that the gradient tends to that of the motion
// as dt goes to 0.
struct GradientInfo {
  // "exact of the motion", "exact of the code", "implicit" (of the solutions of the steps),
  // "frozen" (points or normals of contacts that push are held), "surrogate": the worst of the
  // steps.
  std::string label;
  std::string reason;  // one sentence: what makes it so, and what follows
  int64_t steps = 0, exact_steps = 0, frozen_steps = 0, surrogate_steps = 0;
  // Contacts that began or ended, and that changed between sticking and slipping, between two
  // steps that follow each other; the sum of `began`, `ended` and `turned`.
  int64_t events = 0, began = 0, ended = 0, turned = 0;
  float residual = 0.0f;  // largest, relative to the impulses
};

// Of steps whose events move in time.
struct MotionCounts {
  int64_t several = 0;  // steps in which several pairs hit at once
  int64_t unmoved = 0;  // limits of joints that begin or end to push in what touches something
  bool rows_are_exact = true;  // of gaps and overlaps: pgs_slop 0, pgs_erp 1
};

// `implicit`: steps that are neither frozen nor a surrogate are of the solutions of the steps, and
// `exact_steps` counts them. `motion` (null: of the code): the events of the steps move in time.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const GradientCounts& counts, bool implicit = false,
                                                const MotionCounts* motion = nullptr);

}  // namespace novaphy
