#pragma once

#include "novaphy/core/export.h"

#define NOVAPHY_COLLISION_API NOVAPHY_EXPORT
