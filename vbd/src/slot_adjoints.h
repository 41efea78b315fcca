// Derivatives of the blocks of slots and contacts, as code that the build makes from the laws
// (tools/vbd_adjoints).
#pragma once

#include "sweep_slots.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {
#include "slot_adjoints.inc"
}  // namespace novaphy::vbd::NOVAPHY_LEVEL
