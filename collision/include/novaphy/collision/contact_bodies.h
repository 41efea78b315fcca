// Tables of the bodies that contacts touch, by which bodies add up the wrenches of their contacts.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// Body of each contact's shape, -1 for the world and for unused rows: `rigid` {rigid_contact_max,
// 2} of shape A and B, `soft` {soft_contact_max}; empty arrays are left out. A launch, which may be
// recorded.
NOVAPHY_COLLISION_API void find_contact_bodies(const Model& model, const Contacts& contacts,
                                               const DeviceArray<int32_t>& rigid,
                                               const DeviceArray<int32_t>& soft);

// Whether particles may meet a shape of a body. Reads the model on the host.
NOVAPHY_COLLISION_API bool particles_may_meet_bodies(const Model& model);

}  // namespace novaphy
