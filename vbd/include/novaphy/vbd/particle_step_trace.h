// Where a particle begins a step: its inertial target, and the guess from which iterations start.
//
//   y = xn + h (vn + h (g + f/m)),  x0 = y, or xn, or xn + h vn + h^2 a g
// a is the part of gravity, 0 to 1, in the acceleration of the step before (Chen et al. 2024).
//
// Freestanding: device code reads it too.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::vbd {

// Of VbdInitialGuess.
constexpr int32_t kGuessPrevious = 1, kGuessAdaptive = 2;

struct Prediction {
  Vec3f target, moved;  // y; x0 - xn
};

inline float gravity_that_acted(const Vec3f& g, const Vec3f& acceleration) {
  const float squared = math::dot(g, g);
  return squared > 0.0f ? math::clamp(math::dot(acceleration, g) / squared, 0.0f, 1.0f) : 0.0f;
}

inline Prediction predict_particle(const Vec3f& q, const Vec3f& qd, const Vec3f& f, float inv_mass,
                                   const Vec3f& g, float h, int32_t guess, bool has_last,
                                   const Vec3f& last_velocity) {
  const Vec3f travel = (qd + (g + f * inv_mass) * h) * h;
  Prediction p = {q + travel, travel};
  if (guess == kGuessPrevious) p.moved = Vec3f{};
  if (guess == kGuessAdaptive && has_last)
    p.moved = qd * h + (g * gravity_that_acted(g, (qd - last_velocity) / h)) * (h * h);
  return p;
}

}  // namespace novaphy::vbd
