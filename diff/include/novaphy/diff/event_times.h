// When contacts of a trajectory begin, as values of a tape.
#pragma once

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// {n}, s since the first of the steps that filled the trajectory: the times of the events that
// their solver lists (GradientInfo::event_list), in that order. An event of step k is at
//   t_k + d / |J v|,  with the derivative J / |J v| by the positions of state k,
// d its gap, J the gradient of d, v the rates. Recorded on the active tape, with adjoint and
// tangent. The number of events and their order are those of this run.
// {0} where nothing began.
// ErrorKind::Value: no tape is active, or it has no steps with DerivativeOf::Motion;
// ErrorKind::NotImplemented: not all states are kept.
NOVAPHY_DIFF_API nova::Tensor event_times(const Trajectory& trajectory);

}  // namespace novaphy::diff
