// The arguments of the kernels for the tangent of a step of articulations. The file extends
// arguments.h.
#pragma once

#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/dual.h"

namespace novaphy {

using articulation::DualFloat;

// If a step fails, its results stay unchanged. branch: the branches of the step, per dof. stride:
// size of an articulation's workspace in numbers.
struct ArticulationJvpArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationArgumentsOf<DualFloat>> in; Changed<DualFloat> q_next, qd_next;
                    Changed<Transform<DualFloat>> body_q; Changed<SpatialVector<DualFloat>> body_qd;
                    Given<float> branch; Changed<float> workspace; Number<int64_t> stride;)
};

}  // namespace novaphy
