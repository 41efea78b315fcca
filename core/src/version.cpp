#include "novaphy/core/version.h"

namespace novaphy {

const char* version() { return NOVAPHY_VERSION; }

}  // namespace novaphy
