// A compute device, named "cpu", "cuda:0", ... The loaded backends decide which devices exist.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/export.h"

namespace novaphy {

enum class DeviceType : int32_t { CPU = 0, CUDA = 1, DLAN = 2 };

struct NOVAPHY_CORE_API Device {
  DeviceType type = DeviceType::CPU;
  int32_t ordinal = 0;

  static Device cpu() { return {}; }
  static Device cuda(int32_t ordinal = 0) { return {DeviceType::CUDA, ordinal}; }
  // "cpu", "cuda", "cuda:1", "dlan", "dlan:0"; anything else throws ErrorKind::Value. Does not ask
  // whether the device is there.
  static Device parse(std::string_view spec);
  std::string str() const;  // "cpu", "cuda:0"
  bool is_cpu() const { return type == DeviceType::CPU; }
  bool operator==(const Device&) const = default;
};

struct DeviceInfo {
  std::string name;
  int32_t arch = 0;
  int32_t units = 0;
  uint64_t total_memory = 0;
  uint64_t free_memory = 0;
  bool host_accessible = false;
  bool supports_graph_capture = false;
};

// The default device: set_default_device, else the environment variable NOVAPHY_DEVICE, else cpu.
NOVAPHY_CORE_API Device default_device();
NOVAPHY_CORE_API void set_default_device(Device device);  // throws when it is not available
NOVAPHY_CORE_API std::vector<Device> devices();
NOVAPHY_CORE_API bool device_available(Device device);
// Throws ErrorKind::Runtime with the collected reasons when the device is not there.
NOVAPHY_CORE_API void require_device(Device device);
// For a feature of the CPU alone: throws ErrorKind::NotImplemented elsewhere. `parts` name the
// caller and the feature.
template <class... Parts>
void require_cpu(Device device, const Parts&... parts) {
  if (!device.is_cpu()) [[unlikely]]
    fail(ErrorKind::NotImplemented, parts..., ": expected the device cpu, got ", device.str());
}
NOVAPHY_CORE_API DeviceInfo device_info(Device device);
NOVAPHY_CORE_API void synchronize(Device device);

}  // namespace novaphy

template <>
struct std::hash<novaphy::Device> {
  size_t operator()(const novaphy::Device& d) const noexcept {
    return (static_cast<size_t>(d.type) << 16) ^ static_cast<size_t>(d.ordinal);
  }
};
