// The registry of backends. A backend is a plugin that fills the C table of
// <novaphy/abi/backend.h>; the CPU backend's interpreter is linked in, so there is always one.
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
  std::string name;  // "cpu"; the file's name when it could not be loaded
  std::string version;
  uint32_t abi_major = 0, abi_minor = 0;
  std::string path;     // empty for the one that is linked in
  bool loaded = false;  // false: `error` says why
  bool active = false;  // the one in use for its device type
  int32_t device_count = 0;
  std::string error;
};

// One opened device of a backend with its stream: what arrays and launches go through.
struct DeviceContext {
  const novaphy_backend_api* api = nullptr;
  novaphy_device* device = nullptr;
  novaphy_stream* stream = nullptr;  // the default stream
  Device id;
  bool host_accessible = false;
};

// Every backend found, loaded or refused, in search order. Search: NOVAPHY_BACKEND_PATH (colon
// separated), `novaphy_backends/` beside the core library, the install folder.
// NOVAPHY_DISABLE_BACKENDS=name,name skips.
NOVAPHY_CORE_API std::vector<BackendInfo> backends();
// Loads one plugin by path; throws ErrorKind::Runtime with the reason when it is refused.
NOVAPHY_CORE_API BackendInfo load_backend(const std::filesystem::path& path);
// Opens the device at first use; throws ErrorKind::Runtime with the collected reasons when it is
// not there.
NOVAPHY_CORE_API const DeviceContext& device_context(Device device);

// Throws the C status as an Error (INDEX_OUT_OF_RANGE as Index, the others as Runtime), prefixed by
// `what`.
NOVAPHY_CORE_API void check(novaphy_status status, const novaphy_error& error, const char* what);
// Without a message: the rest of its characters is not set.
inline novaphy_error make_error() {
  novaphy_error error;
  error.struct_size = sizeof(novaphy_error);
  error.status = 0;
  error.message[0] = 0;
  return error;
}

}  // namespace novaphy
