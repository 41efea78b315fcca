// ContactBranches: counts of the branches (which contacts push, stick or slide) that a gradient
// assumes.
#pragma once

#include <cstdint>

#include "novaphy/dynamics/articulation/gradient_counts.h"

namespace novaphy {

// Counts of branches, and the distances of a step's contacts from other branches, over all steps.
struct ContactBranches {
  int64_t steps = 0;  // steps with contacts or dry friction
  int64_t held = 0;         // contacts that push or shift, with frozen points or normals
  int64_t unconverged = 0;  // steps with an island far from convergence (pgs.h)
  int64_t breaking = 0, sticking = 0, sliding = 0;
  float normal_margin = kNone;  // m/s, smallest impulse or separation speed
  float gap_margin = kNone;     // m, smallest distance of a pushing contact to another branch of
                                // the gap law
  float cone_margin = kNone;    // 1, smallest 1 - |lambda_t| / (mu lambda_n) of sticking contacts
  float slip_margin = kNone;    // m/s, smallest slip of sliding contacts
  GradientCounts all;           // over all steps that may have contacts
  static constexpr float kNone = 3.0e38f;
};

}  // namespace novaphy
