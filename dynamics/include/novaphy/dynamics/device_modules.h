// The source code of this library's device kernels, which the build compiles ahead of time.
#pragma once

#include <string>
#include <vector>

#include "novaphy/dynamics/export.h"

namespace novaphy {

// Returns SOURCE modules of <novaphy/abi/backend.h>. The list is empty if the build supports no
// devices.
NOVAPHY_DYNAMICS_API std::vector<std::string> dynamics_device_modules();

}  // namespace novaphy
