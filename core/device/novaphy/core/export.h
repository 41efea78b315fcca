// <novaphy/core/export.h> for device code, where no library exports anything.
#define NOVAPHY_CORE_API
