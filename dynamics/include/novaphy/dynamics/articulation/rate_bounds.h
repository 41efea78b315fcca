// The rates that a dof of a joint with one may have at the end of a step, and which it has there.
//
// Velocity limits: |v| <= velocity_limit. With limits of joints as rows (StepOptions::limit_rows)
// also, for each limit, its gap d >= 0, the rate w that closes it and the force r of the row:
//   0 <= r, w' <= d / dt, one of both an equality
//
// A dof that would pass a limit faster than the restitution threshold gets w' = -restitution w.
// A dof outside of its limits comes back with d / dt, at most with kMostReturn. A dof at a bound
// has endless inertia there (step.h). Where a bound begins or ends to hold, and where a dof comes
// back at kMostReturn, the derivative is that of the branch that the step took. Source: the normal
// of a contact (pgs.h).
#pragma once

#include "novaphy/dynamics/articulation/limits.h"
#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

inline constexpr float kMostReturn = 0.1f;  // m/s or rad/s

// The rate d / dt with which a dof reaches a limit; `side` 1: the upper one, -1: the lower one.
template <class T>
struct StopRate {
  T rate{}, by_q{};  // by_q: -1 / dt, or 0 where the dof comes back at kMostReturn
};
template <class T>
StopRate<T> stop_rate(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                      int32_t coord, float side) {
  const T limit = side > 0.0f ? in.limit_upper[row] : in.limit_lower[row];
  const T rate = (limit - in.q[coord]) / options.dt, o = T(0.0f);
  const auto back = T(side) * rate < T(-kMostReturn);
  return {select(back, T(-side * kMostReturn), rate), select(back, o, T(-1.0f) / options.dt)};
}

template <class T>
struct RateBounds {
  T upper{}, lower{};
};
template <class T>
RateBounds<T> rate_bounds(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                          int32_t coord) {
  const T limit = in.velocity_limit[row];
  if (!options.limit_rows) return {limit, -limit};
  const T up = stop_rate(in, options, row, coord, 1.0f).rate;
  const T down = stop_rate(in, options, row, coord, -1.0f).rate;
  const T low = select(down > -limit, down, -limit);
  const T high = select(up < limit, up, limit);
  return {select(high < -limit, -limit, high), select(low > limit, limit, low)};
}

// The rate of a dof that is at a bound, and else v.
template <class T>
T held_rate(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row, int32_t coord,
            const Branches<T>& branch, const T& v) {
  const T limit = in.velocity_limit[row];
  const auto upper = has(branch, kVelocityAtUpper), lower = has(branch, kVelocityAtLower);
  const T held = select(upper, limit, select(lower, -limit, v));
  if (!options.limit_rows) return held;
  const auto stops = has(branch, kAtStop), bounces = has(branch, kStopBounces);
  const T stop = select(upper, stop_rate(in, options, row, coord, 1.0f).rate,
                        stop_rate(in, options, row, coord, -1.0f).rate);
  const T back = -(options.limit_restitution * in.qd[row]);
  return select(bounces, back, select(stops, stop, held));
}

// The branch of a dof that goes to its upper or lower bound, or to none, from another one.
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
  // One that is there already goes on as it began.
  const auto held = has(from, kVelocityClamped);
  const auto bounces = either(has(from, kStopBounces), both(negate(held), both(elastic, fast)));
  return with(to, both(either(at_upper, at_lower), bounces), kStopBounces);
}

// What the gradient `pull` of a held rate gives to the limits and to q and qd of its dof.
template <class T>
struct BoundGradient {
  T velocity_limit{}, upper{}, lower{}, q{}, qd{};
};
template <class T>
BoundGradient<T> bound_gradient(const StepInputs<T>& in, const StepOptions<T>& options, int32_t row,
                                int32_t coord, const Branches<T>& branch, const T& pull) {
  const T o = T(0.0f);
  const auto upper = has(branch, kVelocityAtUpper), held = has(branch, kVelocityClamped);
  BoundGradient<T> to;
  to.velocity_limit = select(upper, pull, select(held, -pull, o));
  if (!options.limit_rows) return to;
  const auto stops = has(branch, kAtStop), bounces = has(branch, kStopBounces);
  to.velocity_limit = select(stops, o, to.velocity_limit);
  to.qd = select(bounces, -(options.limit_restitution * pull), o);
  const auto closes = both(stops, negate(bounces));
  const T by_q = select(upper, stop_rate(in, options, row, coord, 1.0f).by_q,
                        stop_rate(in, options, row, coord, -1.0f).by_q);
  to.q = select(closes, by_q * pull, o);
  to.upper = select(upper, -to.q, o);
  to.lower = select(upper, o, -to.q);
  return to;
}

}  // namespace novaphy::articulation
