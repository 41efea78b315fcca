// Internal to core: the parts of the backend registry that other files use.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "novaphy/abi/backend.h"
#include "novaphy/core/device.h"

namespace novaphy {

inline constexpr const char* kDisabledReason = "disabled by NOVAPHY_DISABLE_BACKENDS";

inline constexpr int32_t kMaxOrdinal = 64;  // largest number of devices per type

const char* device_type_name(DeviceType type);
// Returns the number of devices of the active backend of a type.
int32_t active_device_count(DeviceType type);

// A file that looks like a backend, or an entry of the search path that cannot be used. `problem`
// has the reason.
struct BackendCandidate {
  std::filesystem::path path;
  std::string name;  // "cuda" of libnovaphy_backend_cuda.so
  std::string problem;
};
std::vector<std::filesystem::path> backend_search_path(std::vector<BackendCandidate>* unusable);
std::vector<BackendCandidate> find_backends();
std::string backend_name_of(const std::filesystem::path& path);

// Returns an empty text if dlopen may open the file, else the reason why not.
std::string plugin_file_problem(const std::filesystem::path& path);

// Returns an empty text if the table obeys the rules of the ABI, else the rule that it breaks.
std::string check_backend_table(const novaphy_backend_api* api);

const novaphy_host_api* host_api();

}  // namespace novaphy
