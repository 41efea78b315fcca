// A stand-in for the CUDA driver: device memory is host memory, copies and fills happen, and of
// kernels the backend's own run (host_kernels.h), nothing that is compiled for a Program. For tests
// of what the backend does around kernels, on machines without a GPU.
// Environment variables choose what goes wrong:
//   FAKE_DRIVER_VERSION   what cuDriverGetVersion says (13000)
//   FAKE_DRIVER_DEVICES   how many devices there are (1)
//   FAKE_DRIVER_INIT      what cuInit returns (0)
//   FAKE_DRIVER_MEMORY    bytes of a device (1 GiB)
//   FAKE_DRIVER_HOSTILE   1: new memory is full of NaNs, rows run from the last to the first, and
//   who reads memory of the device elsewhere than in work of the device crashes (0)
//   FAKE_DRIVER_LOSE      the launch or fill, counted from 1, after which the device is lost
// Built with FAKE_DRIVER_LACKS_SYMBOL it does not export cuMemAllocAsync, as an old driver.
#include <sys/mman.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

#include "host_kernels.h"

#define FAKE extern "C" __attribute__((visibility("default"))) int

namespace {

constexpr int kInvalidValue = 1, kOutOfMemory = 2, kInvalidDevice = 101, kIllegalAddress = 700,
              kNotCapturing = 901;

long setting(const char* name, long otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr && *text != '\0' ? std::strtol(text, nullptr, 10) : otherwise;
}

std::atomic<long> g_launches{0};
bool lost() {
  const long after = setting("FAKE_DRIVER_LOSE", 0);
  return after > 0 && g_launches >= after;
}
int result() { return lost() ? kIllegalAddress : 0; }

std::mutex g_mutex;
std::map<void*, size_t>& blocks() {
  static auto& all = *new std::map<void*, size_t>;
  return all;
}
size_t g_used = 0;

// The memory of a hostile device, which only work of the device can access. Addresses are not
// reused.
class Guarded {
 public:
  void* allocate(size_t bytes) {
    bytes = (bytes + 4095) / 4096 * 4096;
    if (bytes > kRoom - used_) return nullptr;
    used_ += bytes;
    return begin_ + used_ - bytes;
  }
  bool holds(const void* pointer) const { return pointer >= begin_ && pointer < begin_ + used_; }
  void enter() {
    const std::lock_guard lock(mutex_);
    if (inside_++ == 0) protect(PROT_READ | PROT_WRITE);
  }
  void leave() {
    const std::lock_guard lock(mutex_);
    if (--inside_ == 0) protect(PROT_NONE);
  }

 private:
  static constexpr size_t kRoom = size_t{64} << 30;
  void protect(int how) {
    if (mprotect(begin_, kRoom, how) != 0) std::abort();
  }
  char* const begin_ = static_cast<char*>(
      mmap(nullptr, kRoom, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
  size_t used_ = 0;
  int inside_ = 0;
  std::mutex mutex_;
};
Guarded* guarded() {
  static Guarded* const memory = setting("FAKE_DRIVER_HOSTILE", 0) != 0 ? new Guarded : nullptr;
  return memory;
}
// While an object of this class lives, the device works.
struct Works {
  Works() {
    if (guarded() != nullptr) guarded()->enter();
  }
  ~Works() {
    if (guarded() != nullptr) guarded()->leave();
  }
};

int allocate(void** pointer, size_t bytes, bool of_host = false) {
  if (lost()) return kIllegalAddress;
  const std::lock_guard lock(g_mutex);
  const auto memory = static_cast<size_t>(setting("FAKE_DRIVER_MEMORY", 1L << 30));
  if (bytes == 0) return kInvalidValue;
  if (bytes > memory - g_used) return kOutOfMemory;
  void* made = guarded() != nullptr && !of_host
                   ? guarded()->allocate(bytes)
                   : std::aligned_alloc(4096, (bytes + 4095) / 4096 * 4096);
  if (made == nullptr) return kOutOfMemory;
  if (guarded() != nullptr) {
    const Works now;
    std::memset(made, 0xFF, bytes);
  }
  blocks()[made] = bytes;
  g_used += bytes;
  *pointer = made;
  return 0;
}
int release(void* pointer) {
  const std::lock_guard lock(g_mutex);
  const auto found = blocks().find(pointer);
  if (found == blocks().end()) return kInvalidValue;
  g_used -= found->second;
  blocks().erase(found);
  if (guarded() == nullptr || !guarded()->holds(pointer)) std::free(pointer);
  return 0;
}

void* pointer(uint64_t p) { return reinterpret_cast<void*>(p); }
// A stream, an event, a module or a graph.
struct Handle {
  bool capturing = false;
  std::vector<std::function<void()>> work;  // captured work
};
int make(void** handle) {
  *handle = new Handle;
  return result();
}
bool capturing(void* stream) {
  return stream != nullptr && static_cast<Handle*>(stream)->capturing;
}
// Runs the work now, or captures it.
int submit(void* stream, std::function<void()> work) {
  if (lost()) return kIllegalAddress;
  if (capturing(stream)) {
    static_cast<Handle*>(stream)->work.push_back(std::move(work));
  } else {
    const Works now;
    work();
  }
  return 0;
}
template <class T>
int fill(uint64_t target, T value, size_t count, void* stream) {
  ++g_launches;
  return submit(stream, [=] { std::fill_n(static_cast<T*>(pointer(target)), count, value); });
}
int copy(void* target, const void* source, size_t bytes, void* stream) {
  return submit(stream, [=] { std::memmove(target, source, bytes); });
}
int destroy(void* handle) {
  delete static_cast<Handle*>(handle);
  return result();
}
thread_local void* t_context = nullptr;
int g_context;

}  // namespace

FAKE cuDriverGetVersion(int* version) {
  *version = static_cast<int>(setting("FAKE_DRIVER_VERSION", 13000));
  return 0;
}
FAKE cuGetErrorName(int code, const char** name) {
  *name = code == kOutOfMemory      ? "CUDA_ERROR_OUT_OF_MEMORY"
          : code == kIllegalAddress ? "CUDA_ERROR_ILLEGAL_ADDRESS"
          : code == 0               ? "CUDA_SUCCESS"
                                    : "CUDA_ERROR_FAKE";
  return 0;
}
FAKE cuGetErrorString(int code, const char** text) {
  *text = code == kOutOfMemory ? "out of memory" : "an error of the fake driver";
  return 0;
}
FAKE cuInit(unsigned) { return static_cast<int>(setting("FAKE_DRIVER_INIT", 0)); }
FAKE cuDeviceGetCount(int* count) {
  *count = static_cast<int>(setting("FAKE_DRIVER_DEVICES", 1));
  return 0;
}
FAKE cuDeviceGet(int* device, int ordinal) {
  *device = ordinal;
  return ordinal < setting("FAKE_DRIVER_DEVICES", 1) ? 0 : kInvalidDevice;
}
FAKE cuDeviceGetName(char* name, int size, int) {
  std::snprintf(name, static_cast<size_t>(size), "Fake GPU");
  return 0;
}
FAKE cuDeviceGetAttribute(int* value, int attribute, int) {
  // Compute capability 9.0, 4 units, and the shared memory of such a device.
  *value = attribute == 75 ? 9 : attribute == 76 ? 0 : attribute == 97 ? 227 << 10 : 4;
  return 0;
}
FAKE cuDeviceTotalMem_v2(size_t* bytes, int) {
  *bytes = static_cast<size_t>(setting("FAKE_DRIVER_MEMORY", 1L << 30));
  return 0;
}
FAKE cuDevicePrimaryCtxRetain(void** context, int) {
  *context = &g_context;
  return 0;
}
FAKE cuDevicePrimaryCtxRelease_v2(int) { return 0; }
FAKE cuCtxSetCurrent(void* context) {
  t_context = context;
  return 0;
}
FAKE cuCtxGetCurrent(void** context) {
  *context = t_context;
  return 0;
}
FAKE cuMemGetInfo_v2(size_t* free_bytes, size_t* total) {
  *total = static_cast<size_t>(setting("FAKE_DRIVER_MEMORY", 1L << 30));
  *free_bytes = *total - g_used;
  return result();
}
FAKE cuMemAlloc_v2(uint64_t* target, size_t bytes) {
  return allocate(reinterpret_cast<void**>(target), bytes);
}
FAKE cuMemFree_v2(uint64_t target) { return release(pointer(target)); }
#ifndef FAKE_DRIVER_LACKS_SYMBOL
FAKE cuMemAllocAsync(uint64_t* target, size_t bytes, void*) {
  return allocate(reinterpret_cast<void**>(target), bytes);
}
#endif
// Memory that a captured graph allocates belongs to the graph.
FAKE cuMemFreeAsync(uint64_t target, void* stream) {
  return capturing(stream) ? result() : release(pointer(target));
}
FAKE cuMemHostAlloc(void** target, size_t bytes, unsigned) { return allocate(target, bytes, true); }
FAKE cuMemFreeHost(void* target) { return release(target); }
FAKE cuMemHostGetDevicePointer_v2(uint64_t* target, void* source, unsigned) {
  *target = reinterpret_cast<uint64_t>(source);
  return 0;
}
FAKE cuMemcpyHtoDAsync_v2(uint64_t target, const void* source, size_t bytes, void* stream) {
  return copy(pointer(target), source, bytes, stream);
}
FAKE cuMemcpyDtoHAsync_v2(void* target, uint64_t source, size_t bytes, void* stream) {
  return copy(target, pointer(source), bytes, stream);
}
FAKE cuMemcpyDtoDAsync_v2(uint64_t target, uint64_t source, size_t bytes, void* stream) {
  return copy(pointer(target), pointer(source), bytes, stream);
}
FAKE cuMemsetD8Async(uint64_t target, unsigned char value, size_t count, void* stream) {
  return fill(target, value, count, stream);
}
FAKE cuMemsetD16Async(uint64_t target, unsigned short value, size_t count, void* stream) {
  return fill(target, value, count, stream);
}
FAKE cuMemsetD32Async(uint64_t target, unsigned value, size_t count, void* stream) {
  return fill(target, value, count, stream);
}
FAKE cuMemsetD2D32Async(uint64_t target, size_t pitch, unsigned value, size_t width, size_t height,
                        void* stream) {
  int status = result();
  for (size_t row = 0; row < height && status == 0; ++row)
    status = fill(target + row * pitch, value, width, stream);
  return status;
}
FAKE cuStreamCreate(void** stream, unsigned) { return make(stream); }
FAKE cuStreamDestroy_v2(void* stream) { return destroy(stream); }
FAKE cuStreamSynchronize(void*) { return result(); }
FAKE cuStreamWaitEvent(void*, void*, unsigned) { return result(); }
FAKE cuEventCreate(void** event, unsigned) { return make(event); }
FAKE cuEventDestroy_v2(void* event) { return destroy(event); }
FAKE cuEventRecord(void*, void*) { return result(); }
FAKE cuEventSynchronize(void*) { return result(); }
FAKE cuEventElapsedTime(float* milliseconds, void*, void*) {
  *milliseconds = 0.0f;
  return result();
}
FAKE cuModuleLoadData(void** module, const void*) { return make(module); }
FAKE cuModuleUnload(void* module) { return destroy(module); }
FAKE cuModuleGetFunction(void** function, void*, const char* name) {
  constexpr int kNotFound = 500;
  static HostKernel generated = {"", false, nullptr};  // the code of a Program does nothing here
  const HostKernel* found = find_host_kernel(name);
  if (std::strcmp(name, "novaphy_main") == 0 || std::strcmp(name, "novaphy_early") == 0)
    found = &generated;
  *function = const_cast<HostKernel*>(found);
  return found != nullptr ? result() : kNotFound;
}
FAKE cuLaunchKernel(void* function, unsigned blocks, unsigned, unsigned, unsigned threads, unsigned,
                    unsigned, unsigned, void* stream, void** arguments, void**) {
  const int before = result();
  ++g_launches;
  const auto& kernel = *static_cast<const HostKernel*>(function);
  if (before == 0 && kernel.bind != nullptr)
    submit(stream, [&kernel, blocks, threads, thread = kernel.bind(arguments)] {
      const std::lock_guard lock(g_mutex);
      run_host_kernel(kernel, blocks, threads, setting("FAKE_DRIVER_HOSTILE", 0) != 0, thread);
    });
  return before;  // the next call reports a failing kernel
}
// Always runs one block, because blocks run one after the other here.
FAKE cuLaunchCooperativeKernel(void* function, unsigned, unsigned, unsigned, unsigned threads,
                               unsigned, unsigned, unsigned, void* stream, void** arguments) {
  const int before = result();
  ++g_launches;
  const auto& kernel = *static_cast<const HostKernel*>(function);
  if (before == 0 && kernel.bind != nullptr)
    submit(stream, [&kernel, threads, thread = kernel.bind(arguments)] {
      const std::lock_guard lock(g_mutex);
      run_host_kernel(kernel, 1, threads, false, thread);
    });
  return before;
}
FAKE cuOccupancyMaxActiveBlocksPerMultiprocessor(int* blocks, void*, int, size_t) {
  *blocks = 1;
  return result();
}
FAKE cuFuncSetAttribute(void*, int, int) { return result(); }
FAKE cuOccupancyMaxActiveClusters(int* clusters, void*, const void*) {
  *clusters = static_cast<int>(setting("FAKE_DRIVER_CLUSTERS", 1));
  return result();
}
FAKE cuStreamBeginCapture_v2(void* stream, unsigned) {
  static_cast<Handle*>(stream)->capturing = true;
  return result();
}
FAKE cuStreamEndCapture(void* stream, void** graph) {
  if (!static_cast<Handle*>(stream)->capturing) return kNotCapturing;
  static_cast<Handle*>(stream)->capturing = false;
  const int status = make(graph);
  static_cast<Handle*>(*graph)->work.swap(static_cast<Handle*>(stream)->work);
  return status;
}
FAKE cuGraphInstantiateWithFlags(void** exec, void* graph, unsigned long long) {
  *exec = new Handle(*static_cast<Handle*>(graph));
  return result();
}
FAKE cuGraphDestroy(void* graph) { return destroy(graph); }
FAKE cuGraphExecDestroy(void* exec) { return destroy(exec); }
FAKE cuGraphLaunch(void* exec, void*) {
  ++g_launches;
  if (!lost()) {
    const Works now;
    for (const auto& work : static_cast<Handle*>(exec)->work) work();
  }
  return result();
}
