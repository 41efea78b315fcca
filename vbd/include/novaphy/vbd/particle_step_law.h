// The start of a particle's step: the inertial position y, and the initial guess x0 of the
// iterations.
//   y = xn + h (vn + h (g + f/m)),  x0 = y, or xn, or xn + h vn + h^2 a g
// The three guesses are those of VbdInitialGuess. The last one is the adaptive guess. Its factor a
// is the part of gravity that acted in the previous step (Chen et al. 2024):
//   a = s clamped to 0 to 1,  s = (vn - vl).g / (h |g|^2)
// vl is the velocity at the start of the previous step. Without a previous step x0 = y. The
// derivatives are exact. The derivative of the clamp is 0 at and beyond its ends. If g is 0, all
// derivatives of a are 0.
//
// Symbols: xn (m) and vn (m/s) at the start of the step; step size h (s), gravity g (m/s^2),
// external force f (N), mass m (kg).
// Freestanding (no standard headers), because device code includes this header.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::vbd {

// The values of VbdInitialGuess.
constexpr int32_t kGuessPrevious = 1, kGuessAdaptive = 2;

inline bool is_finite(const Vec3f& v) {
  const float sum = (v.x - v.x) + (v.y - v.y) + (v.z - v.z);  // NaN or 0
  return sum == 0.0f;
}

// The faults of a particle: an input that is not finite; an inertial position that is not finite
// although all inputs are finite; a result of the step that is not finite.
constexpr int32_t kNoFault = 0, kFaultPosition = 1, kFaultVelocity = 2, kFaultForce = 3,
                  kFaultTarget = 4, kFaultResult = 5;

struct Prediction {
  Vec3f target, moved;  // y, and x0 - xn (m)
};

// Returns s of the adaptive guess, before the clamp.
inline float gravity_that_acted(const Vec3f& g, const Vec3f& acceleration) {
  const float squared = math::dot(g, g);
  return squared > 0.0f ? math::dot(acceleration, g) / squared : 0.0f;
}

inline Prediction predict_particle(const Vec3f& q, const Vec3f& qd, const Vec3f& f, float inv_mass,
                                   const Vec3f& g, float h, int32_t guess, bool has_last,
                                   const Vec3f& last_velocity) {
  const Vec3f travel = (qd + (g + f * inv_mass) * h) * h;
  Prediction p = {q + travel, travel};
  if (guess == kGuessPrevious) p.moved = Vec3f{};
  if (guess == kGuessAdaptive && has_last)
    p.moved =
        qd * h +
        (g * math::clamp(gravity_that_acted(g, (qd - last_velocity) / h), 0.0f, 1.0f)) * (h * h);
  return p;
}

// Returns the fault of a moving particle: of its inputs, or of the inertial position `target`.
inline int32_t input_fault(const Vec3f& q, const Vec3f& qd, const Vec3f& f, const Vec3f& target) {
  if (!is_finite(q)) return kFaultPosition;
  if (is_finite(target)) return kNoFault;
  if (!is_finite(qd)) return kFaultVelocity;
  return is_finite(f) ? kFaultTarget : kFaultForce;
}

// The adjoints of vn, vl and g, from the adjoint of the adaptive guess x0.
struct GuessAdjoints {
  Vec3f by_velocity, by_last, by_gravity;
};
inline GuessAdjoints adaptive_guess_adjoints(const Vec3f& adjoint, const Vec3f& qd, const Vec3f& g,
                                             float h, const Vec3f& last_velocity) {
  const Vec3f acceleration = (qd - last_velocity) / h;
  const float s = gravity_that_acted(g, acceleration), a = math::clamp(s, 0.0f, 1.0f);
  const float by_s =
      s > 0.0f && s < 1.0f ? (math::dot(g, adjoint) * (h * h)) / math::dot(g, g) : 0.0f;
  const Vec3f by_speed = (g * by_s) / h;
  return {adjoint * h + by_speed, by_speed * -1.0f,
          adjoint * (a * (h * h)) + (acceleration - g * (2.0f * s)) * by_s};
}

// Returns the tangent of x0 - xn for the adaptive guess, along tangents of vn, g and vl.
inline Vec3f adaptive_guess_tangent(const Vec3f& qd, const Vec3f& g, float h,
                                    const Vec3f& last_velocity, const Vec3f& qd_tangent,
                                    const Vec3f& g_tangent, const Vec3f& last_tangent) {
  const Vec3f acceleration = (qd - last_velocity) / h;
  const float s = gravity_that_acted(g, acceleration), a = math::clamp(s, 0.0f, 1.0f);
  const float a_tangent = s > 0.0f && s < 1.0f
                              ? (math::dot((qd_tangent - last_tangent) / h, g) +
                                 math::dot(acceleration - g * (2.0f * s), g_tangent)) /
                                    math::dot(g, g)
                              : 0.0f;
  return qd_tangent * h + (g_tangent * a + g * a_tangent) * (h * h);
}

}  // namespace novaphy::vbd
