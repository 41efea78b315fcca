#include "novaphy/collision/device_modules.h"

#include "device_soft_contacts.h"

namespace novaphy {

std::vector<std::string> collision_device_modules() {
#ifdef NOVAPHY_WITH_DEVICE_COLLISION
  return {detail::soft_contacts_module()};
#else
  return {};
#endif
}

}  // namespace novaphy
