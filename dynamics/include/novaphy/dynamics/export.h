#pragma once

#include "novaphy/core/export.h"

#define NOVAPHY_DYNAMICS_API NOVAPHY_EXPORT
