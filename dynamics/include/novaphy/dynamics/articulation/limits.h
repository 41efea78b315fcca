// Limits of joints with one dof, and the branches of a dof.
//
// Where q is outside of a limit, the force is t = limit_ke (limit - q) - limit_kd v, at the time
// and with the branches of drives.h.
#pragma once

#include "novaphy/dynamics/articulation/step_arrays.h"

namespace novaphy::articulation {

// What a dof did in a step.
enum Branch : int32_t {
  kBelowLimit = 1,
  kAboveLimit = 2,
  kLimitReleased = 4,   // with one of these two
  kEffortAtUpper = 8,   // the drive gave + effort_limit
  kEffortAtLower = 16,  // and - effort_limit
  kVelocityAtUpper = 32,
  kVelocityAtLower = 64,
  kAtStop = 128,       // with one of these two: the rate is that of a limit as a row
  kStopBounces = 256,  // with that: of its restitution
};
inline constexpr int32_t kOutside = kBelowLimit | kAboveLimit;
inline constexpr int32_t kEffortClamped = kEffortAtUpper | kEffortAtLower;
inline constexpr int32_t kVelocityClamped = kVelocityAtUpper | kVelocityAtLower;

// t = stiffness (target - q) + rate (target_rate - v).
template <class T>
struct DriveLaw {
  T stiffness{}, target{}, rate{}, target_rate{};
};
// Of the limit that q is outside of.
template <class T>
DriveLaw<T> limit_law(const StepInputs<T>& in, int32_t row, const Branches<T>& branch) {
  return {in.limit_ke[row],
          select(has(branch, kBelowLimit), in.limit_lower[row], in.limit_upper[row]),
          in.limit_kd[row], T(0.0f)};
}
template <class T>
auto limit_acts(const Branches<T>& branch) {
  return both(has(branch, kOutside), negate(has(branch, kLimitReleased)));
}

// The branch that q is in. A limit without stiffness and damping is none.
template <class T>
Branches<T> limit_branch(const StepInputs<T>& in, int32_t row, const T& q) {
  const T o = T(0.0f);
  const auto acts = either(in.limit_ke[row] > o, in.limit_kd[row] > o);
  const auto below = both(acts, q < in.limit_lower[row]);
  const auto above = both(both(acts, negate(below)), q > in.limit_upper[row]);
  return with(with(Branches<T>{}, below, kBelowLimit), above, kAboveLimit);
}

template <class T>
auto limit_pulls(const Branches<T>& branch, const T& stop) {
  const T o = T(0.0f);
  return either(both(has(branch, kBelowLimit), stop < o), both(has(branch, kAboveLimit), stop > o));
}

// What the gradients of the numbers of a law t = stiffness (target - q) + ... are made of: lambda
// of step_vjp.h, q and v at the end of the step, and what the diagonal of M takes from those of the
// stiffness and the rate.
template <class T>
struct DriveGradient {
  T lambda{}, q_end{}, v_end{}, by_ke{}, by_kd{};
};
// Those of a limit. `stop`: its law where it acts, and else 0; `at_upper`, `at_lower`:
// AdjointMemory stops (step_vjp.h).
template <class T>
void limit_gradient(const DriveLaw<T>& stop, int32_t row, const Branches<T>& branch,
                    const DriveGradient<T>& d, const T& at_upper, const T& at_lower,
                    const StepGradient<T>& g) {
  using G = StepGradient<T>;
  const T o = T(0.0f);
  const auto limits = limit_acts<T>(branch);
  const T by_limit = select(limits, stop.stiffness * d.lambda, o);
  put(g, &G::limit_lower, row, select(has(branch, kBelowLimit), by_limit, o) + at_lower);
  put(g, &G::limit_upper, row, select(has(branch, kAboveLimit), by_limit, o) + at_upper);
  put(g, &G::limit_ke, row, select(limits, (stop.target - d.q_end) * d.lambda - d.by_ke, o));
  put(g, &G::limit_kd, row, select(limits, -(d.v_end * d.lambda) - d.by_kd, o));
}

}  // namespace novaphy::articulation
