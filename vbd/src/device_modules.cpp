#include "novaphy/vbd/device_modules.h"

namespace novaphy {
namespace detail {
const char* vbd_kernels_text();
const char* vbd_adjoint_kernels_text();
const char* vbd_gradient_kernels_text();
const char* vbd_tangent_kernels_text();
}  // namespace detail

std::vector<std::string> vbd_device_modules() {
  std::vector<std::string> all;
  for (const char* const text :
       {detail::vbd_kernels_text(), detail::vbd_adjoint_kernels_text(),
        detail::vbd_gradient_kernels_text(), detail::vbd_tangent_kernels_text()})
    if (text != nullptr) all.push_back(text);
  return all;
}

}  // namespace novaphy
