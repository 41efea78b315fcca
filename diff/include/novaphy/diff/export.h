#pragma once
// The macro that exports symbols of the library novaphy::diff (novaphy/core/export.h).
#include "novaphy/core/export.h"
#define NOVAPHY_DIFF_API NOVAPHY_EXPORT
