#pragma once

#include "novaphy/core/export.h"

#define NOVAPHY_IO_API NOVAPHY_EXPORT
