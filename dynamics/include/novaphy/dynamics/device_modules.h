// The code of articulations for devices, for tools that compile it ahead.
#pragma once

#include <string>
#include <vector>

#include "novaphy/dynamics/export.h"

namespace novaphy {

// SOURCE modules of <novaphy/abi/backend.h>; none where the build has no devices.
NOVAPHY_DYNAMICS_API std::vector<std::string> dynamics_device_modules();

}  // namespace novaphy
