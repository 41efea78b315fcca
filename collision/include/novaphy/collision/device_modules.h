// The texts of this library's device modules, for whoever compiles them ahead.
#pragma once

#include <string>
#include <vector>

#include "novaphy/collision/export.h"

namespace novaphy {

// SOURCE modules of <novaphy/abi/backend.h>; none where the build has no device collision.
NOVAPHY_COLLISION_API std::vector<std::string> collision_device_modules();

}  // namespace novaphy
