// The code of VBD for devices, for tools that compile it ahead.
#pragma once

#include <string>
#include <vector>

#include "novaphy/vbd/export.h"

namespace novaphy {

// SOURCE modules of <novaphy/abi/backend.h>; none where the build has no VBD for devices.
NOVAPHY_VBD_API std::vector<std::string> vbd_device_modules();

}  // namespace novaphy
