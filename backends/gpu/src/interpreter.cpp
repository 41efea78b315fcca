// The host side of the interpreter: its module, the code of a Program in device memory, and
// launches.
#include "interpreter.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>

#include "module.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

constexpr unsigned kThreads = 64;             // per block
constexpr int64_t kSharedOfBlock = 48 << 10;  // every device has this much shared memory per block
constexpr int64_t kBlocksPerUnit = 16;        // with more rows, a block takes several rows in turn

// Loaded at the first use on a device, and kept until the device is closed.
novaphy_status load_interpreter(novaphy_device* device, Function* function, novaphy_error* error) {
  static std::mutex mutex;
  const std::lock_guard lock(mutex);
  if (device->interpreter == nullptr) {
    const novaphy_status status = load_code(device, interpreter_source(), "interpreter",
                                            Dialect::Program, &device->interpreter, error);
    if (status != NOVAPHY_OK) return status;
  }
  return check(device, driver().module_function(function, device->interpreter, kInterpreterEntry),
               kInterpreterEntry, error);
}

}  // namespace

novaphy_status run_interpreted(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                               DevicePointer active, const uint64_t* arguments,
                               novaphy_error* error) {
  const Driver& d = driver();
  int64_t blocks = (n + kThreads - 1) / kThreads;
  int64_t shared = int64_t{4} * kThreads * kernel.interpreted.values;
  DevicePointer scratch = 0;
  if (shared > kSharedOfBlock) {
    shared = 0;
    blocks = std::min(blocks, kBlocksPerUnit * stream->device->units);
    const auto bytes = static_cast<size_t>(blocks * kThreads * kernel.interpreted.values * 4);
    const novaphy_status status = check(
        stream->device, d.alloc_async(&scratch, bytes, stream->stream), kernel.name.c_str(), error);
    if (status != NOVAPHY_OK) return status;
  }
  // The driver copies as many words as the kernel declares, so the array has all of them.
  uint64_t words[kMaxArgumentWords];
  std::memcpy(words, arguments, kernel.argument_count * sizeof(uint64_t));
  DevicePointer code = kernel.interpreted.code;
  SinkArgument sink = sink_of(stream->device, kernel.number, active);
  void* pointers[] = {words, &code, &scratch, &n, &sink};
  const novaphy_status status =
      check(stream->device,
            d.launch(kernel.function, static_cast<unsigned>(blocks), 1, 1, kThreads, 1, 1,
                     static_cast<unsigned>(shared), stream->stream, pointers, nullptr),
            kernel.name.c_str(), error);
  if (scratch != 0) d.free_async(scratch, stream->stream);
  return status;
}

bool interpreter_is_forced() {
  const char* text = std::getenv("NOVAPHY_DEVICE_INTERPRETER");
  return text != nullptr && std::strcmp(text, "1") == 0;
}

void say_interpreted(const char* why) {
  static std::once_flag once;
  std::call_once(once, [&] {
    if (const char* quiet = std::getenv("NOVAPHY_QUIET"); quiet != nullptr && *quiet != '\0')
      return;
    std::fprintf(
        stderr,
        "novaphy: kernels that were not built ahead are interpreted on the %s device (same "
        "results, slower): %s [NOVAPHY_QUIET=1 hides this line]\n",
        vendor().toolkit, why);
  });
}

novaphy_status make_interpreted(novaphy_device* device, const nova::ir::Program& program,
                                novaphy_kernel& kernel, novaphy_error* error) {
  const Driver& d = driver();
  novaphy_status status = load_interpreter(device, &kernel.function, error);
  if (status == NOVAPHY_NOT_SUPPORTED)
    return fail(error, status,
                "kernel '%s' cannot be compiled, and no interpreter for %s was built ahead "
                "either: %s",
                kernel.name.c_str(), arch_name(device->arch).c_str(),
                compiler(d.version).problem.c_str());
  if (status != NOVAPHY_OK) return status;
  const InterpreterCode code = interpreter_code(program);
  const size_t bytes = code.instructions.size() * sizeof(InterpreterInstruction);
  status = check(device, d.alloc(&kernel.interpreted.code, bytes), kernel.name.c_str(), error);
  if (status != NOVAPHY_OK) return status;
  kernel.interpreted.values = code.values;
  status = check(
      device, d.copy_to_device(kernel.interpreted.code, code.instructions.data(), bytes, nullptr),
      kernel.name.c_str(), error);
  if (status == NOVAPHY_OK)
    status = check(device, d.stream_synchronize(nullptr), kernel.name.c_str(), error);
  return status;
}

}  // namespace novaphy::gpu
