// The sources of this library's device modules, for compilation ahead of time.
#pragma once

#include <string>
#include <vector>

#include "novaphy/collision/export.h"

namespace novaphy {

// Returns SOURCE modules of <novaphy/abi/backend.h>. The list is empty if the build has no device
// collision.
NOVAPHY_COLLISION_API std::vector<std::string> collision_device_modules();

}  // namespace novaphy
