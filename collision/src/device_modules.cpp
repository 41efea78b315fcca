#include "novaphy/collision/device_modules.h"

#include "contact_bodies.h"
#include "rigid_contacts.h"
#include "rigid_tree.h"
#include "soft_contacts.h"

namespace novaphy {

std::vector<std::string> collision_device_modules() {
  std::vector<std::string> modules;
  for (const char* text : {detail::soft_contact_kernels_text(),
                           detail::rigid_contact_kernels_text(), detail::rigid_mesh_kernels_text(),
                           detail::rigid_tree_kernels_text(), detail::contact_body_kernels_text()})
    if (text != nullptr) modules.emplace_back(text);
  return modules;
}

}  // namespace novaphy
