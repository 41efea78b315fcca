// The source code of the device kernels for collision, for tools that compile kernels ahead of
// time.
#pragma once

#include <string>
#include <vector>

#include "novaphy/collision/export.h"

namespace novaphy {

// Returns the modules, in the form SOURCE of <novaphy/abi/backend.h>. The list is empty if the
// build has no collision on devices.
NOVAPHY_COLLISION_API std::vector<std::string> collision_device_modules();

}  // namespace novaphy
