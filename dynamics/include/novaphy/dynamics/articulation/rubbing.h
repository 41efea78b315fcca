// Step sizes of PGS for a contact normal whose friction pushes against it, so that sweeps converge.
//
// Let friction lambda_t = mu lambda_n d slide along the direction d. A sweep then multiplies the
// error of the normal impulse by -mu (J_n Y_t d) / (J_n Y_n). At the foot of a leg that leans
// backward the factor is below -1, and sweeps never converge. Sweeps converge with the divisor J_n
// Y_n + mu J_n Y_t d of both rows together.
#pragma once

#include "novaphy/dynamics/articulation/pgs.h"

namespace novaphy::articulation {

inline constexpr int32_t kRubbingSweeps = 16;  // sweeps before the first rubbing_step

// Returns the step of the normal (inverse divisor), which includes friction that acts against the
// normal. The friction may stick in one sweep and slide in the next one. A contact without an
// impulse keeps its step, because its friction has no direction. t1, t2: J_n Y of the tangents.
template <class T>
T rubbing_step(const PgsNumbers<T>& c, const T& t1, const T& t2) {
  const T o = T(0.0f), whole = c.normal + c.cfm;
  const auto rubs = both(c.friction * c.impulse[0] > o, c.normal_step > o);
  const T against = (t1 * c.impulse[1] + t2 * c.impulse[2]) / select(rubs, c.impulse[0], T(1.0f));
  const T divisor = select(against > o, whole + against, whole);
  return select(rubs, T(1.0f) / select(rubs, divisor, T(1.0f)), c.normal_step);
}
// Returns whether the steps of normals are computed again after `sweeps` sweeps. A contact may push
// in every second sweep only, so two consecutive sweeps recompute.
constexpr bool renews_rubbing(int32_t sweeps) {
  return sweeps >= kRubbingSweeps && sweeps % kRubbingSweeps < 2;
}

template <class T>
void set_rubbing_step(PgsContact<T>& c) {
  c.normal_step = rubbing_step<T>(c, row_product(c, 0, 1), row_product(c, 0, 2));
}

}  // namespace novaphy::articulation
