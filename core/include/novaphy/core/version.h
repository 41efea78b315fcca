// The version of the engine.
#pragma once

#include "novaphy/core/export.h"

namespace novaphy {

NOVAPHY_CORE_API const char* version();  // "0.1.0"

}  // namespace novaphy
