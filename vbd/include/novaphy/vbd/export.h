#pragma once

#include "novaphy/core/export.h"

#define NOVAPHY_VBD_API NOVAPHY_EXPORT
