// The twin of <novaphy/core/export.h> for device code, which exports no symbols.
#define NOVAPHY_CORE_API
