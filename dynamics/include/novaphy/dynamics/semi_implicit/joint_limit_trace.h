// The force of the limits of a degree of freedom of a penalty joint, and of the limits of a
// DISTANCE joint.
//
//   force at q with the rate qd:
//     ke (lower - q) - kd qd below lower, ke (upper - q) - kd qd above upper, else 0
//
// Symbols: lower, upper: m or rad; ke: N/m or N*m/rad; kd: N*s/m or N*m*s/rad. At a limit the
// gradient is that of the side on which q is. Source: Newton 1.8.0, SolverSemiImplicit.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real can be traced.
#pragma once

#include "novaphy/math/functions.h"

namespace novaphy {

template <class T>
struct JointLimit {
  T lower{}, upper{}, ke{}, kd{};
};

// Calls visit(member of d, field of each of `a`...) for each parameter of a limit. `a`: structs
// with the fields of StepArrays (articulation/step_arrays.h).
template <class Visit, class T, class... Arrays>
void for_each_limit_number(const Visit& visit, JointLimit<T>& d, Arrays&... a) {
  visit(d.lower, a.limit_lower...);
  visit(d.upper, a.limit_upper...);
  visit(d.ke, a.limit_ke...);
  visit(d.kd, a.limit_kd...);
}

template <class T>
T limit_force(const JointLimit<T>& d, const T& q, const T& qd) {
  using math::select;
  const T zero = T(0.0f);
  const auto below = q<d.lower, above = q> d.upper;
  const T limit = select(below, d.ke * (d.lower - q), select(above, d.ke * (d.upper - q), zero));
  const T stop = select(below, -d.kd * qd, select(above, -d.kd * qd, zero));
  return limit + stop;
}
// Returns x if q is within the limits, else 0.
template <class T>
T within_limits(const JointLimit<T>& d, const T& q, const T& x) {
  using math::select;
  const T zero = T(0.0f);
  return select(q < d.lower, zero, select(q > d.upper, zero, x));
}

// Returns the force along a distance l (m) with the rate l_rate (m/s). kd acts only if ke does.
template <class T>
T distance_force(const JointLimit<T>& d, const T& l, const T& l_rate) {
  using math::select;
  const T zero = T(0.0f);
  const T error = select(l > d.upper, l - d.upper, select(l < d.lower, l - d.lower, zero));
  return select(error == zero, zero, d.ke * error + d.kd * l_rate);
}

}  // namespace novaphy
