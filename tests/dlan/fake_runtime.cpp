// A stand-in for Denglin's run-time library, with a device that is the host: memory is the host's,
// and kernels that were compiled for the host (host.h) run, thread by thread. Threads that wait for
// their block are fibers.
// Environment variables say what the device is like, and what goes wrong:
//   FAKE_DLAN_WARP      threads of a warp (32): the last warp of a block comes first
//   FAKE_DLAN_VERSION   what cudaRuntimeGetVersion says (11000)
//   FAKE_DLAN_DEVICES   how many devices there are (1)
//   FAKE_DLAN_MEMORY    bytes of a device (1 GiB)
//   FAKE_DLAN_LOSE      the launch or fill, counted from 1, after which the device is lost
// Built with FAKE_DLAN_LACKS_SYMBOL it has no cudaMemsetAsync, with FAKE_DLAN_OTHER_NAME it has it
// as dlMemsetAsync.
#include <ucontext.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "fake_stub.h"
#include "novaphy/cpu/float_mode.h"

#define FAKE extern "C" __attribute__((visibility("default")))

FAKE FakeIndex fake_dlan_thread, fake_dlan_block, fake_dlan_block_size, fake_dlan_grid_size;
FAKE void* fake_dlan_shared;
FakeIndex fake_dlan_thread, fake_dlan_block, fake_dlan_block_size, fake_dlan_grid_size;
void* fake_dlan_shared;

namespace {

constexpr int kInvalidValue = 1, kOutOfMemory = 2, kInvalidDevice = 101, kIllegalAddress = 700;

long setting(const char* name, long otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr && *text != '\0' ? std::strtol(text, nullptr, 10) : otherwise;
}

std::atomic<long> g_launches{0};
bool lost() {
  static const long after = setting("FAKE_DLAN_LOSE", 0);
  return after > 0 && g_launches >= after;
}
int result() { return lost() ? kIllegalAddress : 0; }
size_t memory() { return static_cast<size_t>(setting("FAKE_DLAN_MEMORY", 1L << 30)); }

std::mutex g_mutex;
std::map<void*, size_t> g_blocks;
size_t g_used = 0;

int allocate(void** pointer, size_t bytes) {
  if (lost()) return kIllegalAddress;
  const std::lock_guard lock(g_mutex);
  if (bytes == 0) return kInvalidValue;
  if (bytes > memory() - g_used) return kOutOfMemory;
  void* made = std::aligned_alloc(256, (bytes + 255) / 256 * 256);
  if (made == nullptr) return kOutOfMemory;
  g_blocks[made] = bytes;
  g_used += bytes;
  *pointer = made;
  return 0;
}
int release(void* pointer) {
  const std::lock_guard lock(g_mutex);
  const auto found = g_blocks.find(pointer);
  if (found == g_blocks.end()) return kInvalidValue;
  g_used -= found->second;
  g_blocks.erase(found);
  std::free(pointer);
  return 0;
}

// A fiber runs threads until one of them waits. The fiber keeps this thread, and another fiber
// takes the remaining threads.
struct Fiber {
  ucontext_t context;
  std::unique_ptr<char[]> stack;
  unsigned thread = 0;
  bool waits = false;
};
std::vector<std::unique_ptr<Fiber>> g_fibers;
std::vector<unsigned> g_order;  // order of the threads of a block
size_t g_next = 0;
Fiber* g_running = nullptr;
ucontext_t g_scheduler;
const FakeStub* g_stub;
void* const* g_arguments;

void run_threads() {
  for (;;) {
    while (g_next < g_order.size()) {
      g_running->thread = fake_dlan_thread.x = g_order[g_next++];
      g_stub->run(g_arguments);
    }
    g_running->waits = false;
    swapcontext(&g_running->context, &g_scheduler);
  }
}
void enter(Fiber& fiber) {
  g_running = &fiber;
  fake_dlan_thread.x = fiber.thread;
  swapcontext(&g_scheduler, &fiber.context);
}
Fiber& fiber(size_t k) {
  constexpr size_t kStack = 128 << 10;
  while (g_fibers.size() <= k) {
    Fiber& made = *g_fibers.emplace_back(std::make_unique<Fiber>());
    made.stack = std::make_unique<char[]>(kStack);
    getcontext(&made.context);
    made.context.uc_stack.ss_sp = made.stack.get();
    made.context.uc_stack.ss_size = kStack;
    made.context.uc_link = nullptr;
    makecontext(&made.context, run_threads, 0);
  }
  return *g_fibers[k];
}
void run_block() {
  g_next = 0;
  size_t waiting = 0;
  while (g_next < g_order.size()) {
    Fiber& f = fiber(waiting);
    enter(f);
    if (f.waits) ++waiting;
  }
  while (waiting > 0) {
    size_t still = 0;
    for (size_t k = 0; k < waiting; ++k) {
      fiber(k).waits = false;
      enter(fiber(k));
      if (!fiber(k).waits) continue;
      std::swap(g_fibers[still], g_fibers[k]);
      ++still;
    }
    waiting = still;
  }
}

struct Handle {};
int make(void** handle) {
  *handle = new Handle;
  return result();
}
int destroy(void* handle) {
  delete static_cast<Handle*>(handle);
  return result();
}
thread_local int t_device = 0;

}  // namespace

FAKE void fake_dlan_wait() {
  g_running->waits = true;
  swapcontext(&g_running->context, &g_scheduler);
}

FAKE int cudaRuntimeGetVersion(int* version) {
  *version = static_cast<int>(setting("FAKE_DLAN_VERSION", 11000));
  return 0;
}
FAKE const char* cudaGetErrorName(int code) {
  return code == kOutOfMemory      ? "cudaErrorMemoryAllocation"
         : code == kIllegalAddress ? "cudaErrorIllegalAddress"
                                   : "cudaErrorFake";
}
FAKE const char* cudaGetErrorString(int code) {
  return code == kOutOfMemory ? "out of memory" : "an error of the fake library";
}
FAKE int cudaGetDeviceCount(int* count) {
  *count = static_cast<int>(setting("FAKE_DLAN_DEVICES", 1));
  return 0;
}
FAKE int cudaSetDevice(int device) {
  if (device < 0 || device >= setting("FAKE_DLAN_DEVICES", 1)) return kInvalidDevice;
  t_device = device;
  return 0;
}
FAKE int cudaGetDevice(int* device) {
  *device = t_device;
  return 0;
}
FAKE int cudaDeviceGetAttribute(int* value, int attribute, int) {
  *value = attribute == 75   ? 7
           : attribute == 76 ? 0
           : attribute == 10 ? static_cast<int>(setting("FAKE_DLAN_WARP", 32))
                             : 4;
  return 0;
}
FAKE int cudaGetDeviceProperties(void* properties, int) {
  std::snprintf(static_cast<char*>(properties), 256, "Fake Denglin");
  return 0;
}
FAKE int cudaMemGetInfo(size_t* free_bytes, size_t* total) {
  *total = memory();
  *free_bytes = *total - g_used;
  return result();
}
FAKE int cudaMalloc(void** target, size_t bytes) { return allocate(target, bytes); }
FAKE int cudaFree(void* target) { return release(target); }
FAKE int cudaHostAlloc(void** target, size_t bytes, unsigned) { return allocate(target, bytes); }
FAKE int cudaFreeHost(void* target) { return release(target); }
FAKE int cudaHostGetDevicePointer(void** target, void* source, unsigned) {
  *target = source;
  return 0;
}
FAKE int cudaMemcpyAsync(void* target, const void* source, size_t bytes, int, void*) {
  if (lost()) return kIllegalAddress;
  std::memmove(target, source, bytes);
  return 0;
}
#ifndef FAKE_DLAN_LACKS_SYMBOL
#ifdef FAKE_DLAN_OTHER_NAME
#define cudaMemsetAsync dlMemsetAsync
#endif
FAKE int cudaMemsetAsync(void* target, int value, size_t bytes, void*) {
  ++g_launches;
  if (lost()) return kIllegalAddress;
  std::memset(target, value, bytes);
  return 0;
}
#endif
FAKE int cudaStreamCreateWithFlags(void** stream, unsigned) { return make(stream); }
FAKE int cudaStreamDestroy(void* stream) { return destroy(stream); }
FAKE int cudaStreamSynchronize(void*) { return result(); }
FAKE int cudaStreamWaitEvent(void*, void*, unsigned) { return result(); }
FAKE int cudaEventCreateWithFlags(void** event, unsigned) { return make(event); }
FAKE int cudaEventDestroy(void* event) { return destroy(event); }
FAKE int cudaEventRecord(void*, void*) { return result(); }
FAKE int cudaEventSynchronize(void*) { return result(); }
FAKE int cudaEventElapsedTime(float* milliseconds, void*, void*) {
  *milliseconds = 0.0f;
  return result();
}
FAKE int cudaLaunchKernel(const void* function, FakeIndex grid, FakeIndex block, void** arguments,
                          size_t shared_bytes, void*) {
  ++g_launches;
  if (lost()) return 0;  // the next call reports the loss
  if (function == nullptr || grid.x == 0 || block.x == 0 || block.x > 1024) return kInvalidValue;
  const std::lock_guard lock(g_mutex);
  const novaphy::cpu::FloatMode own;  // independent of the caller's mode
  alignas(16) static char shared[64 << 10];
  if (shared_bytes > sizeof(shared)) return kInvalidValue;
  fake_dlan_shared = shared;
  fake_dlan_grid_size = grid;
  fake_dlan_block_size = block;
  g_stub = static_cast<const FakeStub*>(function);
  g_arguments = arguments;
  const auto warp = static_cast<unsigned>(setting("FAKE_DLAN_WARP", 32));
  g_order.clear();
  for (unsigned first = (block.x - 1) / warp * warp;; first -= warp) {
    for (unsigned t = first; t < std::min(first + warp, block.x); ++t) g_order.push_back(t);
    if (first == 0) break;
  }
  for (fake_dlan_block = {0, 0, 0}; fake_dlan_block.x < grid.x; ++fake_dlan_block.x) run_block();
  return 0;
}
