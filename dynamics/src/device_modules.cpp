#include "novaphy/dynamics/device_modules.h"

namespace novaphy {
namespace detail {
const char* articulation_contact_kernels_source();
const char* articulation_contact_jvp_kernels_source();
const char* articulation_contact_vjp_kernels_source();
const char* articulation_functions_kernels_source();
const char* articulation_jvp_kernels_source();
const char* articulation_kernels_source();
const char* body_actuation_kernels_source();
const char* gradient_notes_kernels_source();
const char* joint_coordinates_kernels_source();
}  // namespace detail

std::vector<std::string> dynamics_device_modules() {
  std::vector<std::string> modules;
  for (const char* text :
       {detail::articulation_contact_kernels_source(),
        detail::articulation_contact_jvp_kernels_source(),
        detail::articulation_contact_vjp_kernels_source(),
        detail::articulation_functions_kernels_source(), detail::articulation_jvp_kernels_source(),
        detail::articulation_kernels_source(), detail::body_actuation_kernels_source(),
        detail::gradient_notes_kernels_source(), detail::joint_coordinates_kernels_source()})
    if (text != nullptr) modules.emplace_back(text);
  return modules;
}

}  // namespace novaphy
