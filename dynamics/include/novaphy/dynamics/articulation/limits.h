// Position limits of one-dof joints as springs, and the branches of a dof.
//
// If q is outside of a limit, the force is t = limit_ke (limit - q) - limit_kd v. The file drives.h
// says at which time t is evaluated, and when the force of a limit is 0. Units: m or rad, N/m or
// N*m/rad, N*s/m or N*m*s/rad.
#pragma once

#include "novaphy/dynamics/articulation/step_arrays.h"

namespace novaphy::articulation {

// The branch of a dof in a step, as bits: which limits and clamps act.
enum Branch : int32_t {
  kBelowLimit = 1,
  kAboveLimit = 2,
  kLimitReleased = 4,     // outside of a limit that would pull, so its force is 0
  kEffortAtUpper = 8,     // the force of the drive is effort_limit
  kEffortAtLower = 16,    // the force of the drive is -effort_limit
  kVelocityAtUpper = 32,  // the rate is at its upper bound (rate_bounds.h)
  kVelocityAtLower = 64,  // the rate is at its lower bound
  kAtStop = 128,          // with a velocity bit: the bound is a position limit as a row
  kStopBounces = 256,     // with kAtStop: the dof bounces off the limit
};
inline constexpr int32_t kOutside = kBelowLimit | kAboveLimit;
inline constexpr int32_t kEffortClamped = kEffortAtUpper | kEffortAtLower;
inline constexpr int32_t kVelocityClamped = kVelocityAtUpper | kVelocityAtLower;

// The law t = stiffness (target - q) + rate (target_rate - v).
template <class T>
struct DriveLaw {
  T stiffness{}, target{}, rate{}, target_rate{};
};
// Returns the law of the limit that q is outside of.
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

// Returns the branch of a coordinate q. A limit with zero stiffness and damping does not count.
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

// The factors of the gradients by the parameters of a DriveLaw. lambda: adjoint of the
// accelerations (step_vjp.h). q_end, v_end: position and rate at the end of the step. by_ke, by_kd:
// the parts of the gradients by stiffness and rate that come from the diagonal of M.
template <class T>
struct DriveGradient {
  T lambda{}, q_end{}, v_end{}, by_ke{}, by_kd{};
};
// Writes the gradients by the parameters of a limit. `stop`: the law of the limit if it acts, else
// 0. `at_upper`, `at_lower`: gradients by limits as constraint rows (AdjointMemory::stops,
// step_vjp.h).
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
