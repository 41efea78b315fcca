#pragma once

#include "novaphy/core/export.h"
#define NOVAPHY_NOVA_API NOVAPHY_EXPORT
