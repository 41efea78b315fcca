#pragma once
// The macro that exports symbols of the library novaphy::collision (novaphy/core/export.h).
#include "novaphy/core/export.h"

#define NOVAPHY_COLLISION_API NOVAPHY_EXPORT
