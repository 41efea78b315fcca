// The times at which contacts of a trajectory begin, as differentiable values on a tape.
#pragma once

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Returns the times {n} (s, since the first step that filled the trajectory) of the events that the
// solver of the trajectory lists in GradientInfo::event_list, in the same order. The time of an
// event in step k is
//   t_k + d / |J v|,  with the derivative J / |J v| with respect to the positions of state k.
// d is the gap at state k, J the gradient of d with respect to the positions, and v the velocities.
// The active tape records the call, with adjoint and tangent. The number and order of the events
// are those of this run. Without events the result is {0}.
//   ErrorKind::Value: no tape is active, or it has no steps with DerivativeOf::Motion.
//   ErrorKind::NotImplemented: the trajectory does not keep all states.
NOVAPHY_DIFF_API nova::Tensor event_times(const Trajectory& trajectory);

}  // namespace novaphy::diff
