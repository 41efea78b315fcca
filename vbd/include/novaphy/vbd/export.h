#pragma once
// The macro that exports symbols of the library novaphy::vbd (novaphy/core/export.h).
#include "novaphy/core/export.h"

#define NOVAPHY_VBD_API NOVAPHY_EXPORT
