// Checks of states and contacts, for steps and searches. On other devices than the CPU nothing is
// read. NaN values pass, and show in the resulting state.
#pragma once

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// ErrorKind::Value, naming `function`, unless the quaternions of body_q have length 1, to 1 %.
NOVAPHY_CORE_API void check_rotations(const char* function, const SimState& state);
// Likewise the normals of rigid contacts.
NOVAPHY_CORE_API void check_normals(const char* function, const Contacts& contacts);

}  // namespace novaphy
