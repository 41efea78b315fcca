// ContactBranches: what a gradient through contacts depends on.
#pragma once

#include <cstdint>

#include "novaphy/dynamics/articulation/gradient_counts.h"

namespace novaphy {

// How near a step's contacts are to another branch; adds up over steps.
struct ContactBranches {
  int64_t steps = 0;  // with contacts or dry friction
  int64_t held = 0;         // contacts that push, and whose points and normals are frozen
  int64_t unconverged = 0;  // those that are far from converged (pgs.h)
  int64_t breaking = 0, sticking = 0, sliding = 0;
  float normal_margin = kNone;  // m/s: the least impulse, or speed of opening
  float gap_margin = kNone;     // m: of contacts that push, to where another law of gaps begins
  float cone_margin = kNone;    // 1: the least 1 - |lambda_t| / (mu lambda_n) of those that stick
  float slip_margin = kNone;    // m/s: the least slip of those that slide
  GradientCounts all;           // of all steps that may have contacts
  static constexpr float kNone = 3.0e38f;
};

}  // namespace novaphy
