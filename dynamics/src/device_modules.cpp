#include "novaphy/dynamics/device_modules.h"

namespace novaphy {
namespace detail {
const char* articulation_contact_kernels_text();
const char* articulation_contact_jvp_kernels_text();
const char* articulation_contact_vjp_kernels_text();
const char* articulation_functions_kernels_text();
const char* articulation_jvp_kernels_text();
const char* articulation_kernels_text();
const char* body_actuation_kernels_text();
const char* gradient_notes_kernels_text();
const char* joint_coordinates_kernels_text();
}  // namespace detail

std::vector<std::string> dynamics_device_modules() {
  std::vector<std::string> modules;
  for (const char* text :
       {detail::articulation_contact_kernels_text(),
        detail::articulation_contact_jvp_kernels_text(),
        detail::articulation_contact_vjp_kernels_text(),
        detail::articulation_functions_kernels_text(), detail::articulation_jvp_kernels_text(),
        detail::articulation_kernels_text(), detail::body_actuation_kernels_text(),
        detail::gradient_notes_kernels_text(), detail::joint_coordinates_kernels_text()})
    if (text != nullptr) modules.emplace_back(text);
  return modules;
}

}  // namespace novaphy
