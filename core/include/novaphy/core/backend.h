// The registry of backends. A backend is a plugin that fills the C table of
// <novaphy/abi/backend.h>. The interpreter of the CPU backend is linked in, so at least one backend
// always exists.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "novaphy/abi/backend.h"
#include "novaphy/core/device.h"
#include "novaphy/core/export.h"

namespace novaphy {

struct BackendInfo {
  std::string name;  // "cpu"; the file name if the plugin could not be loaded
  std::string version;
  uint32_t abi_major = 0, abi_minor = 0;
  std::string path;     // empty for the linked-in backend
  bool loaded = false;  // false: `error` has the reason
  bool active = false;  // whether this backend serves its device type
  int32_t device_count = 0;
  std::string error;
};

// One opened device of a backend, with its stream. Arrays and launches use the device through this
// struct.
struct DeviceContext {
  const novaphy_backend_api* api = nullptr;
  novaphy_device* device = nullptr;
  novaphy_stream* stream = nullptr;  // the default stream
  Device id;
  bool host_accessible = false;
};

// Lists every backend that was found, loaded or refused, in search order. The search looks in
// NOVAPHY_BACKEND_PATH (separated by colons), in `novaphy_backends/` beside the core library, and
// in the install folder. NOVAPHY_DISABLE_BACKENDS=name,name skips backends.
NOVAPHY_CORE_API std::vector<BackendInfo> backends();
// Loads one plugin by its path. Throws ErrorKind::Runtime with the reason if the plugin is refused.
NOVAPHY_CORE_API BackendInfo load_backend(const std::filesystem::path& path);
// Returns the context of a device and opens the device at its first use. Throws ErrorKind::Runtime
// with the reasons of all backends if the device does not exist.
NOVAPHY_CORE_API const DeviceContext& device_context(Device device);

// Throws an Error if `status` reports a failure. INDEX_OUT_OF_RANGE becomes ErrorKind::Index, every
// other failure ErrorKind::Runtime. The message starts with `what`.
NOVAPHY_CORE_API void check(novaphy_status status, const novaphy_error& error, const char* what);
// Returns an error without a message. Only the first character of the message buffer is
// initialized.
inline novaphy_error make_error() {
  novaphy_error error;
  error.struct_size = sizeof(novaphy_error);
  error.status = 0;
  error.message[0] = 0;
  return error;
}

}  // namespace novaphy
