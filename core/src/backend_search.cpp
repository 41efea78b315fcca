// Search for backend plugins, and the checks of a plugin's function table.
#include <dlfcn.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <set>

#include "novaphy/core/parallel.h"
#include "registry.h"

namespace novaphy {
namespace fs = std::filesystem;
namespace {

constexpr const char* kPrefix = "libnovaphy_backend_";
constexpr const char* kSuffix = ".so";

std::vector<std::string> split(const char* text, char separator) {
  std::vector<std::string> parts;
  if (text == nullptr) return parts;
  std::string part;
  for (const char* c = text; *c != '\0'; ++c) {
    if (*c == separator) {
      parts.push_back(part);
      part.clear();
    } else {
      part += *c;
    }
  }
  parts.push_back(part);
  std::erase_if(parts, [](const std::string& p) { return p.empty(); });
  return parts;
}

fs::path own_directory() {
  Dl_info info{};
  if (dladdr(reinterpret_cast<const void*>(&backend_search_path), &info) == 0 ||
      info.dli_fname == nullptr)
    return {};
  std::error_code ignored;
  const fs::path path = fs::canonical(info.dli_fname, ignored);
  return ignored ? fs::path() : path.parent_path();
}

void host_parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context) noexcept {
  parallel_for(chunks, body, context);
}
int32_t host_in_parallel() noexcept { return in_parallel() ? 1 : 0; }

}  // namespace

const novaphy_host_api* host_api() {
  static const novaphy_host_api api = {sizeof(novaphy_host_api), NOVAPHY_ABI_MAJOR,
                                       NOVAPHY_ABI_MINOR, &host_parallel_for, &host_in_parallel};
  return &api;
}

std::string backend_name_of(const fs::path& path) {
  const std::string file = path.filename().string();
  const std::string prefix = kPrefix, suffix = kSuffix;
  if (!file.starts_with(prefix) || !file.ends_with(suffix) ||
      file.size() <= prefix.size() + suffix.size())
    return {};
  return file.substr(prefix.size(), file.size() - prefix.size() - suffix.size());
}

std::vector<fs::path> backend_search_path(std::vector<BackendCandidate>* unusable) {
  std::vector<fs::path> folders;
  for (const std::string& entry : split(std::getenv("NOVAPHY_BACKEND_PATH"), ':')) {
    if (fs::path(entry).is_absolute()) {
      folders.emplace_back(entry);
    } else if (unusable != nullptr) {
      // A relative entry depends on the current directory, and plugins must never load from there.
      unusable->push_back(
          {entry, entry, "NOVAPHY_BACKEND_PATH: expected an absolute path, got \"" + entry + "\""});
    }
  }
  if (const fs::path own = own_directory(); !own.empty())
    folders.push_back(own / "novaphy_backends");
  folders.emplace_back(NOVAPHY_INSTALL_BACKEND_DIR);
  return folders;
}

std::vector<BackendCandidate> find_backends() {
  std::vector<BackendCandidate> found;
  const std::vector<fs::path> folders = backend_search_path(&found);
  const std::vector<std::string> disabled = split(std::getenv("NOVAPHY_DISABLE_BACKENDS"), ',');
  std::set<fs::path> seen;
  for (const fs::path& folder : folders) {
    std::vector<fs::path> files;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      if (!backend_name_of(entry.path()).empty()) files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    for (const fs::path& file : files) {
      std::error_code ignored;
      const fs::path canonical = fs::weakly_canonical(file, ignored);
      if (!seen.insert(ignored ? file : canonical).second) continue;
      BackendCandidate candidate{file, backend_name_of(file), {}};
      if (std::find(disabled.begin(), disabled.end(), candidate.name) != disabled.end()) {
        candidate.problem = kDisabledReason;
      }
      found.push_back(std::move(candidate));
    }
  }
  return found;
}

std::string check_backend_table(const novaphy_backend_api* api) {
  if (api->abi_major != NOVAPHY_ABI_MAJOR) {
    return "its ABI major version is " + std::to_string(api->abi_major) + ", this build needs " +
           std::to_string(NOVAPHY_ABI_MAJOR);
  }
  // The capture functions at the end of the table are optional; everything before them is
  // mandatory.
  const size_t mandatory = offsetof(novaphy_backend_api, capture_begin);
  if (api->struct_size < mandatory) {
    return "its function table has " + std::to_string(api->struct_size) +
           " bytes, expected at least " + std::to_string(mandatory);
  }
  if (api->name == nullptr || api->version == nullptr)
    return "its function table has no name or version";
  if (api->device_type < NOVAPHY_DEVICE_CPU || api->device_type > NOVAPHY_DEVICE_DLAN) {
    return "its device type " + std::to_string(api->device_type) + " is unknown";
  }
#define NOVAPHY_NEED(field) \
  if (api->field == nullptr) return "its function table lacks " #field
  NOVAPHY_NEED(device_count);
  NOVAPHY_NEED(device_info);
  NOVAPHY_NEED(device_open);
  NOVAPHY_NEED(device_close);
  NOVAPHY_NEED(memory_alloc);
  NOVAPHY_NEED(memory_free);
  NOVAPHY_NEED(memory_copy);
  NOVAPHY_NEED(memory_fill);
  NOVAPHY_NEED(stream_create);
  NOVAPHY_NEED(stream_destroy);
  NOVAPHY_NEED(stream_synchronize);
  NOVAPHY_NEED(stream_wait);
  NOVAPHY_NEED(event_create);
  NOVAPHY_NEED(event_destroy);
  NOVAPHY_NEED(event_record);
  NOVAPHY_NEED(event_synchronize);
  NOVAPHY_NEED(event_elapsed);
  NOVAPHY_NEED(module_create);
  NOVAPHY_NEED(module_destroy);
  NOVAPHY_NEED(kernel_get);
  NOVAPHY_NEED(launch);
#undef NOVAPHY_NEED
  if (api->struct_size > mandatory) {
    if (api->struct_size < offsetof(novaphy_backend_api, kernel_info))
      return "its function table ends inside the capture group";
    const int there = (api->capture_begin != nullptr) + (api->capture_end != nullptr) +
                      (api->graph_launch != nullptr) + (api->graph_destroy != nullptr);
    if (there != 0 && there != 4)
      return "its capture group is incomplete: all four functions or none";
  }
  return {};
}

}  // namespace novaphy
