// core's Trajectory under a name in novaphy::diff.
#pragma once

#include "novaphy/core/sim/trajectory.h"

namespace novaphy::diff {

using novaphy::checkpoint_interval_for;
using novaphy::Trajectory;

}  // namespace novaphy::diff
