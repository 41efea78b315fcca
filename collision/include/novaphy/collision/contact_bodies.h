// Tables of the bodies that contacts act on. Bodies sum the wrenches of their contacts by these
// tables.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Finds the bodies of contacts, -1 for the world and for unused rows: `rigid` {rigid_contact_max,
// 2} for shapes A and B, `soft` {soft_contact_max}. Arrays without rows are skipped. The function
// is a launch and may be recorded.
NOVAPHY_COLLISION_API void find_contact_bodies(const Model& model, const Contacts& contacts,
                                               const DeviceArray<int32_t>& rigid,
                                               const DeviceArray<int32_t>& soft);

// Returns whether particles may touch a shape of a body. Reads the model on the host.
NOVAPHY_COLLISION_API bool particles_may_meet_bodies(const Model& model);

}  // namespace novaphy
