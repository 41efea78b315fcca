// Marks a step of the forward solver on a tape.
#pragma once

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// Inside an active tape, if an input of the step carries a gradient: operations that later read its
// outputs throw an error. Builds without the tensor runtime have no tapes.
void mark_unrecorded_step(const Model& model, const SimState& in, const SimState& out,
                          const Control* control);

}  // namespace novaphy
