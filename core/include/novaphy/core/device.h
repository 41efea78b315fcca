// A compute device, named "cpu", "cuda:0" and so on. The loaded backends decide which devices
// exist.
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
  // Reads "cpu", "cuda", "cuda:1", "dlan" or "dlan:0". Throws ErrorKind::Value for any other text.
  // The device need not exist.
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

// Returns the default device: the one given to set_default_device, else the environment variable
// NOVAPHY_DEVICE, else the CPU.
NOVAPHY_CORE_API Device default_device();
NOVAPHY_CORE_API void set_default_device(Device device);  // throws ErrorKind::Runtime if missing
NOVAPHY_CORE_API std::vector<Device> devices();
NOVAPHY_CORE_API bool device_available(Device device);
// Throws ErrorKind::Runtime with the reasons of all backends if the device does not exist.
NOVAPHY_CORE_API void require_device(Device device);
// Throws ErrorKind::NotImplemented unless the device is the CPU. Features that only the CPU
// supports call this check. `parts` start the message: the caller and the feature.
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
