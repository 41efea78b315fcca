// The trajectory of core under the name that it has among the differentiable operators.
#pragma once

#include "novaphy/core/sim/trajectory.h"

namespace novaphy::diff {

using novaphy::checkpoint_interval_for;
using novaphy::Trajectory;

}  // namespace novaphy::diff
