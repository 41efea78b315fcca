// The times at which contacts of a trajectory begin, as values of a tape.
#pragma once

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Returns the times {n} of the events that the trajectory's solver lists
// (GradientInfo::event_list), in that order: s since the first step that filled the trajectory. An
// event of step k is at
//   t_k + d / |J v|,  with the derivative J / |J v| with respect to the positions of state k,
// where d is the gap, J the gradient of d and v the rates. The active tape records the call, with
// adjoint and tangent. The number of events and their order are those of this run. Without events
// the result is {0}.
// ErrorKind::Value: no tape is active, or it has no steps with DerivativeOf::Motion.
// ErrorKind::NotImplemented: the trajectory does not keep all states.
NOVAPHY_DIFF_API nova::Tensor event_times(const Trajectory& trajectory);

}  // namespace novaphy::diff
