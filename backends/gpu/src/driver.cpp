#include "driver.h"

#include <dlfcn.h>

#include "vendor.h"

namespace novaphy::gpu {
namespace {

void* open_library(std::string& problem) {
  const VendorInfo& v = vendor();
  if (const char* path = v.driver_file(); path != nullptr && *path != '\0') {
    void* library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library == nullptr) {
      const char* why = dlerror();
      problem = std::string(v.driver_variable) + ": " + (why != nullptr ? why : path);
    }
    return library;
  }
  for (const char* const* name = v.driver_libraries; *name != nullptr; ++name) {
    if (void* library = dlopen(*name, RTLD_NOW | RTLD_LOCAL)) return library;
    const char* why = dlerror();
    problem += (problem.empty() ? "" : "; ") + std::string(why != nullptr ? why : *name);
  }
  problem = "no " + std::string(v.toolkit) + " driver on this machine (" + problem + ")";
  return nullptr;
}

void find_devices(Driver& d) {
  const VendorInfo& v = vendor();
  d.driver_version(&d.version);
  if (d.version < v.oldest_driver) {
    d.problem = "the driver is too old: it is of " + std::string(v.toolkit) + " " +
                version_text(d.version) + ", expected " + version_text(v.oldest_driver) +
                " or later";
    return;
  }
  const std::string with =
      " (driver of " + std::string(v.toolkit) + " " + version_text(d.version) + ")";
  if (const Result result = d.init(0); result != kSuccess) {
    d.problem = "the driver did not start: " + d.describe(result) + with;
    return;
  }
  if (const Result result = d.device_count(&d.devices); result != kSuccess) {
    d.problem = "the driver did not count its devices: " + d.describe(result) + with;
    d.devices = 0;
    return;
  }
  if (d.devices == 0) d.problem = "no device is visible" + with;
}

}  // namespace

bool lacks_symbol(Driver& d, const char* symbol) {
  if (d.driver_version != nullptr) d.driver_version(&d.version);
  d.problem = std::string("the driver library has no symbol ") + symbol;
  if (d.version > 0)
    d.problem += "; it is of " + std::string(vendor().toolkit) + " " + version_text(d.version) +
                 ", expected " + version_text(vendor().oldest_driver) + " or later";
  return false;
}

bool load_driver(Driver& d, void* library) {
  const char* missing = nullptr;
#define NOVAPHY_GPU_LOAD(name, result, arguments, symbol)                 \
  d.name = reinterpret_cast<result(*) arguments>(dlsym(library, symbol)); \
  if (d.name == nullptr && missing == nullptr) missing = symbol;
  NOVAPHY_GPU_DRIVER_FUNCTIONS(NOVAPHY_GPU_LOAD)
#undef NOVAPHY_GPU_LOAD
  return missing == nullptr || lacks_symbol(d, missing);
}

std::string version_text(int version) {
  return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

std::string Driver::describe(Result result) const {
  const char *name = nullptr, *text = nullptr;
  if (error_name != nullptr) error_name(result, &name);
  if (error_string != nullptr) error_string(result, &text);
  std::string s = name != nullptr ? name : "error " + std::to_string(result);
  if (text != nullptr) s += std::string(": ") + text;
  return s;
}

const Driver& driver() {
  static const Driver* const opened = [] {
    auto* d = new Driver;
    if (void* library = open_library(d->problem)) {
      d->problem.clear();
      if (vendor().load(*d, library)) find_devices(*d);
    }
    return d;
  }();
  return *opened;
}

}  // namespace novaphy::gpu
