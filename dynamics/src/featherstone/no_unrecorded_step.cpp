// Compiled only into builds without the tensor runtime, which have no tapes.
#include "unrecorded_step.h"

namespace novaphy {
void mark_unrecorded_step(const Model&, const SimState&, const SimState&, const Control*) {}
}  // namespace novaphy
