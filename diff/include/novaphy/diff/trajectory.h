// novaphy::diff::Trajectory, an alias of core's Trajectory.
#pragma once

#include "novaphy/core/sim/trajectory.h"

namespace novaphy::diff {

using novaphy::checkpoint_interval_for;
using novaphy::Trajectory;

}  // namespace novaphy::diff
