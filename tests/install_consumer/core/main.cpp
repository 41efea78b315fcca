// Lists the backends, and moves some numbers through device memory.
#include <iostream>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/version.h"

int main() {
  std::cout << "NovaPhy " << novaphy::version() << " on " << novaphy::default_device().str() << "\n";
  for (const novaphy::BackendInfo& backend : novaphy::backends())
    std::cout << "  " << backend.name << (backend.path.empty() ? " (linked in)" : " " + backend.path)
              << (backend.active ? ", in use" : "") << (backend.error.empty() ? "" : ": " + backend.error)
              << "\n";

  const std::vector<novaphy::Vec3f> values = {{1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}};
  const auto array = novaphy::DeviceArray<novaphy::Vec3f>::from_host(values);
  return array.clone().to_host() == values ? 0 : 1;
}
