#pragma once

#include "novaphy/core/export.h"
#define NOVAPHY_DIFF_API NOVAPHY_EXPORT
