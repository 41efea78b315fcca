#include "novaphy/collision/device_modules.h"

#include "contact_bodies.h"
#include "rigid_contacts.h"
#include "rigid_tree.h"
#include "soft_contacts.h"

namespace novaphy {

std::vector<std::string> collision_device_modules() {
  std::vector<std::string> modules;
  for (const char* text :
       {detail::soft_contact_kernels_source(), detail::rigid_contact_kernels_source(),
        detail::rigid_mesh_kernels_source(), detail::rigid_tree_kernels_source(),
        detail::contact_body_kernels_source()})
    if (text != nullptr) modules.emplace_back(text);
  return modules;
}

}  // namespace novaphy
