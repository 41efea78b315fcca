// The effect of a step of the forward solver on a tape.
#pragma once

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// Inside an active tape: what the step wrote may be no input of it, where what the step read
// carries a gradient. A build without the tensor runtime has no tapes.
void mark_unrecorded_step(const Model& model, const SimState& in, const SimState& out,
                          const Control* control);

}  // namespace novaphy
