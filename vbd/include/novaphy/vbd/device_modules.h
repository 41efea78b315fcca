// The source code of VBD's device kernels, for tools that compile kernels ahead of time.
#pragma once

#include <string>
#include <vector>

#include "novaphy/vbd/export.h"

namespace novaphy {

// Returns the modules, in the form SOURCE of <novaphy/abi/backend.h>. The list is empty if the
// build has no VBD for devices.
NOVAPHY_VBD_API std::vector<std::string> vbd_device_modules();

}  // namespace novaphy
