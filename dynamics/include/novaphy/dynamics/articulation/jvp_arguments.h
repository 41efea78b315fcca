// The arguments of the kernels for the tangent of a step of articulations, over arguments.h.
#pragma once

#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/dual.h"

namespace novaphy {

using articulation::DualFloat;

// What the results were stays where a step fails. branch: of the step; a row per dof. stride:
// numbers of the workspace for an articulation.
struct ArticulationJvpArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationArgumentsOf<DualFloat>> in; Changed<DualFloat> q_next, qd_next;
                    Changed<Transform<DualFloat>> body_q; Changed<SpatialVector<DualFloat>> body_qd;
                    Given<float> branch; Changed<float> workspace; Number<int64_t> stride;)
};

}  // namespace novaphy
