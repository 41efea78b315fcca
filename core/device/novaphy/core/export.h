// Device code has no exported symbols. This file replaces <novaphy/core/export.h> there.
#define NOVAPHY_CORE_API
