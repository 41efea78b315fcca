// Checks of states and contacts before a step or a search. The checks read no data on devices other
// than the CPU. NaN passes the checks and appears in the resulting state.
#pragma once

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// Throws ErrorKind::Value, with `function` in the message, unless the quaternions of body_q have
// length 1 (to 1 %).
NOVAPHY_CORE_API void check_rotations(const char* function, const SimState& state);
// Throws ErrorKind::Value unless the normals of rigid contacts have length 1 (to 1 %).
NOVAPHY_CORE_API void check_normals(const char* function, const Contacts& contacts);

}  // namespace novaphy
