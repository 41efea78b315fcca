#pragma once
// The macro that exports symbols of the library novaphy::dynamics (novaphy/core/export.h).
#include "novaphy/core/export.h"

#define NOVAPHY_DYNAMICS_API NOVAPHY_EXPORT
