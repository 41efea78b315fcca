#pragma once
// The macro that exports symbols of the library novaphy::io (novaphy/core/export.h).
#include "novaphy/core/export.h"

#define NOVAPHY_IO_API NOVAPHY_EXPORT
