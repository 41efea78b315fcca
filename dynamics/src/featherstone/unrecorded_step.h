// Marks a step of the forward solver that runs inside an active tape and is not recorded.
#pragma once

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// If an input of the step carries a gradient of the active tape: makes operations that later read
// the step's outputs throw an error. Builds without the tensor runtime have no tapes.
void mark_unrecorded_step(const Model& model, const SimState& in, const SimState& out,
                          const Control* control);

}  // namespace novaphy
