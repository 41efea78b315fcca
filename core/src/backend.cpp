#include "novaphy/core/backend.h"

#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>

#include "launch_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/cpu/query.h"
#include "registry.h"

namespace novaphy {
namespace fs = std::filesystem;
namespace {

constexpr int kTypes = 3;

struct Entry {
  BackendInfo info;
  int32_t device_type = -1;                  // -1: refused before the type was known
  const novaphy_backend_api* api = nullptr;  // null: refused
};

// The registry lives as long as the process. A backend is never unloaded, because arrays may still
// point into its memory.
class Registry {
 public:
  static Registry& get() {
    static Registry* registry = new Registry;
    return *registry;
  }

  std::vector<BackendInfo> list();
  BackendInfo load(const fs::path& path);
  const DeviceContext& context(Device device);
  int32_t device_count(DeviceType type);

 private:
  void search();  // this function and those below need the lock
  Entry open_file(const BackendCandidate& candidate);
  void accept(Entry& entry, const novaphy_backend_api* (*query)(uint32_t, const novaphy_host_api*,
                                                                novaphy_error*));
  Entry* active(DeviceType type);
  std::string reasons(DeviceType type);
  const DeviceContext& open(Device device);
  [[maybe_unused]] void say_interpreted();

  std::mutex mutex_;
  bool searched_ = false;
  std::vector<Entry> entries_;  // in order of preference; the linked-in backend is last
  std::array<const novaphy_backend_api*, kTypes> in_use_{};
  std::array<std::array<std::atomic<const DeviceContext*>, kMaxOrdinal>, kTypes> contexts_{};
};

void Registry::accept(Entry& entry,
                      const novaphy_backend_api* (*query)(uint32_t, const novaphy_host_api*,
                                                          novaphy_error*)) {
  novaphy_error error = make_error();
  const novaphy_backend_api* api = query(NOVAPHY_ABI_MAJOR, host_api(), &error);
  error.message[sizeof(error.message) - 1] = '\0';
  if (api == nullptr) {
    entry.info.error = error.message[0] != '\0'
                           ? error.message
                           : "novaphy_backend_query returned null without a reason";
    return;
  }
  // Until the version is known to match, only the version may be read.
  entry.info.abi_major = api->abi_major;
  entry.info.abi_minor = api->abi_minor;
  entry.info.error = check_backend_table(api);
  // A CPU plugin has compiled kernels, which must belong to the same version of the engine.
  if (entry.info.error.empty() && entry.info.name == "cpu" && !entry.info.path.empty() &&
      std::strcmp(api->version, NOVAPHY_VERSION) != 0)
    entry.info.error =
        std::string("it is of version ") + api->version + ", this library of " + NOVAPHY_VERSION;
  if (!entry.info.error.empty()) return;
  entry.info.name = api->name;
  entry.info.version = api->version;
  entry.device_type = api->device_type;
  entry.info.loaded = true;
  entry.api = api;
  error = make_error();
  int32_t count = 0;
  if (api->device_count(&count, &error) != NOVAPHY_OK || count <= 0) {
    error.message[sizeof(error.message) - 1] = '\0';
    entry.info.error = error.message[0] != '\0' ? error.message : "no device";
    count = 0;
  }
  entry.info.device_count = std::min(count, kMaxOrdinal);
}

Entry Registry::open_file(const BackendCandidate& candidate) {
  Entry entry;
  entry.info.name = candidate.name;
  entry.info.path = candidate.path.string();
  entry.info.error =
      candidate.problem.empty() ? plugin_file_problem(candidate.path) : candidate.problem;
  if (!entry.info.error.empty()) return entry;
  void* library = dlopen(candidate.path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) {
    const char* why = dlerror();
    entry.info.error = why != nullptr ? why : "dlopen failed";
    return entry;
  }
  const auto query =
      reinterpret_cast<novaphy_backend_query_fn>(dlsym(library, NOVAPHY_BACKEND_QUERY_SYMBOL));
  if (query == nullptr) {
    entry.info.error = "it exports no symbol " NOVAPHY_BACKEND_QUERY_SYMBOL;
    return entry;
  }
  accept(entry, query);
  return entry;
}

void Registry::search() {
  if (searched_) return;
  searched_ = true;
  for (const BackendCandidate& candidate : find_backends())
    entries_.push_back(open_file(candidate));
  Entry own;
  own.info.name = "cpu";
  accept(own, &novaphy_cpu_backend_query);
  entries_.push_back(own);
}

// Returns the backend of a device type. After the first device was opened, the backend of its type
// no longer changes.
Entry* Registry::active(DeviceType type) {
  const novaphy_backend_api* fixed = in_use_[static_cast<size_t>(type)];
  for (Entry& entry : entries_) {
    if (entry.api == nullptr || entry.device_type != static_cast<int32_t>(type)) continue;
    if (fixed != nullptr ? entry.api == fixed : entry.info.device_count > 0) return &entry;
  }
  return nullptr;
}

std::string Registry::reasons(DeviceType type) {
  std::string text;
  for (const Entry& entry : entries_) {
    if (entry.info.error.empty()) continue;
    const std::string name = device_type_name(type);
    const bool same_type = entry.device_type == static_cast<int32_t>(type);
    // A file named ..._cuda.so counts as a backend of this type even if it was refused before its
    // type was known.
    if (!same_type && !(entry.device_type < 0 && entry.info.name.find(name) != std::string::npos))
      continue;
    if (!text.empty()) text.append("; ");
    text.append(entry.info.path.empty() ? entry.info.name : entry.info.path)
        .append(": ")
        .append(entry.info.error);
  }
  if (!text.empty()) return text;
  text.append("no file libnovaphy_backend_").append(device_type_name(type)).append(".so in");
  for (const fs::path& folder : backend_search_path(nullptr))
    text.append(" ").append(folder.string());
  return text;
}

// Warns once per process that kernels are interpreted, which is several times slower. No warning if
// the user disabled the plugin.
void Registry::say_interpreted() {
  if (const char* quiet = std::getenv("NOVAPHY_QUIET"); quiet != nullptr && *quiet != '\0') return;
  std::string why;
  for (const Entry& entry : entries_) {
    if (entry.info.name != "cpu" || entry.info.path.empty() || entry.api != nullptr) continue;
    if (entry.info.error == kDisabledReason) return;
    why = entry.info.path + ": " + entry.info.error;
    break;
  }
  if (why.empty()) why = reasons(DeviceType::CPU);
  std::fprintf(
      stderr,
      "novaphy: kernels are interpreted (same results, slower), because the compiled ones were not "
      "loaded: %s [NOVAPHY_QUIET=1 hides this line]\n",
      why.c_str());
}

const DeviceContext& Registry::open(Device device) {
  num_threads();  // Throws here for a bad NOVAPHY_NUM_THREADS, because throwing is allowed here.
  open_launch_trace();
  const std::lock_guard lock(mutex_);
  search();
  auto& slot = contexts_[static_cast<size_t>(device.type)][static_cast<size_t>(device.ordinal)];
  if (const DeviceContext* context = slot.load(std::memory_order_acquire)) return *context;
  Entry* entry = active(device.type);
  require(entry != nullptr, ErrorKind::Runtime, device_type_name(device.type),
          " backend not available: ", reasons(device.type));
  require(device.ordinal < entry->info.device_count, ErrorKind::Runtime, "device ", device.str(),
          " not available: ", entry->info.name, " backend has ", entry->info.device_count,
          " device(s)");
  auto context = std::make_unique<DeviceContext>();
  novaphy_error error = make_error();
  context->api = entry->api;
  context->id = device;
  novaphy_device_info info{};
  info.struct_size = sizeof(info);
  check(entry->api->device_info(device.ordinal, &info, &error), error, "device_info");
  context->host_accessible = (info.capabilities & NOVAPHY_CAP_HOST_ACCESSIBLE) != 0;
  check(entry->api->device_open(device.ordinal, &context->device, &error), error, "device_open");
  const novaphy_status status =
      entry->api->stream_create(context->device, &context->stream, &error);
  if (status != NOVAPHY_OK) entry->api->device_close(context->device);
  check(status, error, "stream_create");
  in_use_[static_cast<size_t>(device.type)] = entry->api;
#ifdef NOVAPHY_WITH_NATIVE_KERNELS
  if (device.type == DeviceType::CPU && entry->info.path.empty()) say_interpreted();
#endif
  const DeviceContext* opened = context.release();
  slot.store(opened, std::memory_order_release);
  return *opened;
}

const DeviceContext& Registry::context(Device device) {
  const auto type = static_cast<size_t>(device.type);
  require(type < kTypes && device.ordinal >= 0 && device.ordinal < kMaxOrdinal, ErrorKind::Value,
          "device: ordinal ", device.ordinal, " is out of range");
  const DeviceContext* context =
      contexts_[type][static_cast<size_t>(device.ordinal)].load(std::memory_order_acquire);
  if (context != nullptr) [[likely]]
    return *context;
  return open(device);
}

int32_t Registry::device_count(DeviceType type) {
  const std::lock_guard lock(mutex_);
  search();
  if (static_cast<size_t>(type) >= kTypes) return 0;
  const Entry* entry = active(type);
  return entry != nullptr ? entry->info.device_count : 0;
}

std::vector<BackendInfo> Registry::list() {
  const std::lock_guard lock(mutex_);
  search();
  std::vector<BackendInfo> infos;
  for (const Entry& entry : entries_) {
    infos.push_back(entry.info);
    infos.back().active =
        entry.api != nullptr && active(static_cast<DeviceType>(entry.device_type)) == &entry;
  }
  return infos;
}

BackendInfo Registry::load(const fs::path& path) {
  const std::lock_guard lock(mutex_);
  search();
  std::error_code ignored;
  // dlopen searches the system folders for a path without a slash, so the path is made absolute.
  const fs::path absolute = fs::absolute(path, ignored);
  for (const Entry& entry : entries_) {
    if (entry.api == nullptr || entry.info.path.empty() ||
        !fs::equivalent(entry.info.path, absolute, ignored))
      continue;
    BackendInfo info = entry.info;
    info.active = active(static_cast<DeviceType>(entry.device_type)) == &entry;
    return info;
  }
  std::string name = backend_name_of(absolute);
  if (name.empty()) name = absolute.filename().string();
  Entry entry = open_file({absolute, name, {}});
  BackendInfo info = entry.info;
  const novaphy_backend_api* api = entry.api;
  entries_.insert(entries_.begin(), std::move(entry));
  require(info.loaded, ErrorKind::Runtime, "load_backend: ", absolute.string(), ": ", info.error);
  const Entry* used = active(static_cast<DeviceType>(api->device_type));
  info.active = used != nullptr && used->api == api;
  return info;
}

}  // namespace

std::vector<BackendInfo> backends() { return Registry::get().list(); }
BackendInfo load_backend(const fs::path& path) { return Registry::get().load(path); }
const DeviceContext& device_context(Device device) { return Registry::get().context(device); }
int32_t active_device_count(DeviceType type) { return Registry::get().device_count(type); }

void check(novaphy_status status, const novaphy_error& error, const char* what) {
  if (status == NOVAPHY_OK) [[likely]]
    return;
  const size_t length = strnlen(error.message, sizeof(error.message));
  const std::string message =
      length != 0 ? std::string(error.message, length)
                  : "failed with status " + std::to_string(static_cast<int>(status));
  fail(status == NOVAPHY_INDEX_OUT_OF_RANGE ? ErrorKind::Index : ErrorKind::Runtime, what, ": ",
       message);
}

}  // namespace novaphy
