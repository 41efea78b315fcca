// Bounds of the rate of a one-dof joint at the end of a step, and the rate of a dof that is at a
// bound.
//
// Velocity limits: |v| <= velocity_limit (m/s or rad/s). With StepOptions::limit_rows, each
// position limit is a constraint row too:
//
//   r >= 0,  w' <= d / dt,  and one of the two holds with equality
//   d      gap to the limit (m or rad)
//   w, w'  rate that closes the gap, at the start and at the end of the step
//   r      force of the row (N or N*m)
//
// A dof that would hit a limit faster than the restitution threshold gets w' = -restitution w,
// clipped to its other bounds. A dof outside of its limits returns with the rate d / dt, clipped to
// kMostReturn and velocity_limit. A step treats a dof at a bound as one with infinite inertia
// (step.h). Where the active bound changes, the derivative is that of the step's branch. Source:
// the law of a contact along its normal (pgs.h).
#pragma once

#include "novaphy/dynamics/articulation/limits.h"
#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

inline constexpr float kMostReturn = 0.1f;  // largest rate of a return, m/s or rad/s

// The rate of a dof at a bound, and its derivatives by the inputs of the step.
template <class T>
struct HeldRate {
  T rate{}, q{}, qd{}, upper{}, lower{}, velocity_limit{};
};
template <class T, class Mask>
HeldRate<T> select_rate(const Mask& first, const HeldRate<T>& a, const HeldRate<T>& b) {
  return {select(first, a.rate, b.rate),   select(first, a.q, b.q),
          select(first, a.qd, b.qd),       select(first, a.upper, b.upper),
          select(first, a.lower, b.lower), select(first, a.velocity_limit, b.velocity_limit)};
}

// Returns the rate with which a dof just reaches a position limit: the upper limit (`side` 1) or
// the lower limit (-1).
template <class T>
HeldRate<T> stop_rate(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                      int32_t coord, float side) {
  const bool up = side > 0.0f;
  const T o = T(0.0f), s = T(side), most = T(kMostReturn), v = in.velocity_limit[row];
  const T by = T(1.0f) / options.dt;
  const T limit = up ? in.limit_upper[row] : in.limit_lower[row];
  const HeldRate<T> closes = {
      (limit - in.q[coord]) / options.dt, -by, o, up ? by : o, up ? o : by, o};
  const auto slow = v < most;
  const T back = select(slow, v, most);
  return select_rate(s * closes.rate < -back,
                     HeldRate<T>{-(s * back), o, o, o, o, select(slow, -s, o)}, closes);
}

// Returns the largest rate (`side` 1) or the smallest rate (`side` -1) that a dof may have.
template <class T>
HeldRate<T> rate_bound(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                       int32_t coord, float side) {
  const T o = T(0.0f), s = T(side), v = in.velocity_limit[row];
  const HeldRate<T> fastest = {s * v, o, o, o, o, s};
  if (!options.limit_rows) return fastest;
  const HeldRate<T> stop = stop_rate(in, options, row, coord, side);
  return select_rate(s * stop.rate < v, stop, fastest);
}

// Returns the rate of a dof at the bound that `branch` names.
template <class T>
HeldRate<T> held_rate(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                      int32_t coord, const Branches<T>& branch) {
  const HeldRate<T> high = rate_bound(in, options, row, coord, 1.0f),
                    low = rate_bound(in, options, row, coord, -1.0f);
  const HeldRate<T> bound = select_rate(has(branch, kVelocityAtUpper), high, low);
  if (!options.limit_rows) return bound;
  const T o = T(0.0f), e = options.limit_restitution;
  HeldRate<T> back = {-(e * in.qd[row]), o, -e, o, o, o};
  back = select_rate(back.rate < low.rate, low, back);
  back = select_rate(high.rate < back.rate, high, back);
  return select_rate(has(branch, kStopBounces), back, bound);
}

// Returns the branch of a dof that was in the branch `from`, and is now at its upper bound, its
// lower bound or neither. `upper`, `lower`: masks.
template <class T, class Mask>
Branches<T> bound_branch(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                         int32_t coord, const Branches<T>& from, const Mask& upper,
                         const Mask& lower) {
  const Branches<T> free = from & ~(kVelocityClamped | kAtStop | kStopBounces);
  Branches<T> to = with(with(free, upper, kVelocityAtUpper), lower, kVelocityAtLower);
  if (!options.limit_rows) return to;
  const T limit = in.velocity_limit[row], o = T(0.0f), v = in.qd[row];
  const T up = stop_rate(in, options, row, coord, 1.0f).rate;
  const T down = stop_rate(in, options, row, coord, -1.0f).rate;
  const auto at_upper = both(upper, up < limit), at_lower = both(lower, down > -limit);
  to = with(to, either(at_upper, at_lower), kAtStop);
  const auto elastic = options.limit_restitution > o;
  const auto fast = either(both(at_upper, v > options.restitution_threshold),
                           both(at_lower, v < -options.restitution_threshold));
  // A dof that already was at a bound bounces only if it bounced before.
  const auto held = has(from, kVelocityClamped);
  const auto bounces = either(has(from, kStopBounces), both(negate(held), both(elastic, fast)));
  return with(to, both(either(at_upper, at_lower), bounces), kStopBounces);
}

}  // namespace novaphy::articulation
