#pragma once
// The macro that exports symbols of the library novaphy::nova (novaphy/core/export.h).
#include "novaphy/core/export.h"
#define NOVAPHY_NOVA_API NOVAPHY_EXPORT
