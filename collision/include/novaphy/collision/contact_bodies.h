// Tables of the bodies that contacts act on. Solvers use the tables to sum the wrenches of the
// contacts of each body.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Writes the bodies of contacts. `rigid` {rigid_contact_max, 2} gets the bodies of shapes A and B,
// and `soft` {soft_contact_max} the body of the shape. The value is -1 for the world and for unused
// rows. Arrays without rows are skipped. The function is a launch, which a capture may record.
NOVAPHY_COLLISION_API void find_contact_bodies(const Model& model, const Contacts& contacts,
                                               const DeviceArray<int32_t>& rigid,
                                               const DeviceArray<int32_t>& soft);

// Returns whether particles may touch a shape of a body. The function reads the model on the host.
NOVAPHY_COLLISION_API bool particles_may_meet_bodies(const Model& model);

}  // namespace novaphy
