#include "novaphy/vbd/device_modules.h"

#include "step_kernel_set.h"

namespace novaphy {

std::vector<std::string> vbd_device_modules() {
  std::vector<std::string> all;
  for (const char* const text :
       {detail::vbd_kernels_source(), detail::vbd_adjoint_kernels_source(),
        detail::vbd_coarse_kernels_source(), detail::vbd_gradient_kernels_source(),
        detail::vbd_tangent_kernels_source()})
    if (text != nullptr) all.push_back(text);
  return all;
}

}  // namespace novaphy
