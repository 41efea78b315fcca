#include "novaphy/vbd/device_modules.h"

namespace novaphy {
namespace detail {
const char* vbd_kernels_text();
}

std::vector<std::string> vbd_device_modules() {
  const char* const text = detail::vbd_kernels_text();
  return text != nullptr ? std::vector<std::string>{text} : std::vector<std::string>{};
}

}  // namespace novaphy
