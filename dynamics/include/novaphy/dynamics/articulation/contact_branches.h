// ContactBranches: what a gradient through contacts depends on.
#pragma once

#include <cstdint>

namespace novaphy {

// How near a step's contacts are to another branch; adds up over steps.
struct ContactBranches {
  int64_t steps = 0;  // with contacts or dry friction
  // Those whose gradient is exact, and those where it would be if `held` contacts moved as the
  // search moves them: they push, and their points and normals are frozen.
  int64_t exact = 0, frozen = 0, held = 0;
  int64_t unconverged = 0;  // those that are far from converged (pgs.h)
  int64_t breaking = 0, sticking = 0, sliding = 0;
  float normal_margin = kNone;  // m/s: the least impulse, or speed of opening
  float gap_margin = kNone;     // m: of contacts that push, to where another law of gaps begins
  float cone_margin = kNone;    // 1: the least 1 - |lambda_t| / (mu lambda_n) of those that stick
  float slip_margin = kNone;    // m/s: the least slip of those that slide
  float residual = 0.0f;        // m/s: the largest
  static constexpr float kNone = 3.0e38f;
};

}  // namespace novaphy
