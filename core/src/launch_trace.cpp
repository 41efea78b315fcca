#include "novaphy/core/launch_trace.h"

#include <dlfcn.h>

#include <chrono>
#include <cstdlib>
#include <string>
#include <string_view>

#include "launch_trace.h"
#include "novaphy/core/error.h"
#include "trace_file.h"

namespace novaphy {
namespace {

int64_t now() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Never destroyed, because objects with static lifetime may launch at exit.
TraceFile* file = nullptr;
struct {
  int (*push)(const char*) = nullptr;
  int (*pop)() = nullptr;
} ranges;

void open_ranges() {
#ifdef NOVAPHY_WITH_CUDA
  void* const library = dlopen("libnvToolsExt.so.1", RTLD_NOW | RTLD_LOCAL);
  require(library != nullptr, ErrorKind::Value,
          "NOVAPHY_TRACE: expected the library of NVTX for \"nvtx\", got: ",
          library == nullptr ? dlerror() : "");
  ranges.push = reinterpret_cast<int (*)(const char*)>(dlsym(library, "nvtxRangePushA"));
  ranges.pop = reinterpret_cast<int (*)()>(dlsym(library, "nvtxRangePop"));
  require(ranges.push != nullptr && ranges.pop != nullptr, ErrorKind::Value,
          "NOVAPHY_TRACE: libnvToolsExt.so.1 has no nvtxRangePushA or nvtxRangePop");
#else
  fail(ErrorKind::Value,
       "NOVAPHY_TRACE: expected a file, because this build has no CUDA backend, got \"nvtx\"");
#endif
}

}  // namespace

namespace detail {

bool launches_are_traced = false;

LaunchEvent::LaunchEvent(const DeviceContext& context, const char* name, int64_t rows)
    : context_(context), name_(name), rows_(rows), begin_(now()) {
  if (ranges.push != nullptr) ranges.push(name);
}

LaunchEvent::~LaunchEvent() {
  if (ranges.pop != nullptr) ranges.pop();
  if (file != nullptr) file->add(name_, rows_, context_.id.str(), begin_, now());
}

}  // namespace detail

void open_launch_trace() {
  static const bool wanted = [] {
    const char* const value = std::getenv("NOVAPHY_TRACE");
    if (value == nullptr || *value == '\0') return false;
    if (std::string_view(value) == "nvtx") {
      open_ranges();
    } else {
      file = new TraceFile(value);
      std::atexit([] { file->flush(); });
    }
    detail::launches_are_traced = true;
    return true;
  }();
  static_cast<void>(wanted);
}

}  // namespace novaphy
