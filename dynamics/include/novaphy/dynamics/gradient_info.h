// GradientInfo: what the gradient of a differentiable solver is.
#pragma once

#include <string>

#include "novaphy/dynamics/articulation/gradient_counts.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Of the steps of a solver since the last clear. "Of the code": the derivative of what each step
// computes, with the contacts that it has. That a contact begins, ends or changes between sticking
// and slipping moves in time with the state is no part of it; `events` counts where that matters.
struct GradientInfo {
  // "exact of the code", "implicit" (of the solutions of the steps), "frozen" (points or normals of
  // contacts that push are held), "surrogate": the worst of the steps.
  std::string label;
  std::string reason;  // one sentence: what makes it so, and what follows
  int64_t steps = 0, exact_steps = 0, frozen_steps = 0, surrogate_steps = 0;
  // Contacts that began or ended, and that changed between sticking and slipping, between two
  // steps that follow each other; the sum of `began`, `ended` and `turned`.
  int64_t events = 0, began = 0, ended = 0, turned = 0;
  float residual = 0.0f;  // largest, relative to the impulses
};

// `implicit`: steps that are neither frozen nor a surrogate are of the solutions of the steps, and
// `exact_steps` counts them. `moves`: the times at which contacts begin move with the state.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const GradientCounts& counts, bool implicit = false,
                                                bool moves = false);

}  // namespace novaphy
