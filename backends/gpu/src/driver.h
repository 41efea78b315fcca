// The vendor's driver library, opened at run time through a table of functions. The same build
// therefore runs on machines with and without a GPU, and compiles without a toolkit.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace novaphy::gpu {

using Result = int;  // 0: success
using DeviceId = int;
using DevicePointer = uint64_t;
using Context = struct ContextTag*;
using Stream = struct StreamTag*;
using Event = struct EventTag*;
using Module = struct ModuleTag*;
using Function = struct FunctionTag*;
using Graph = struct GraphTag*;
using GraphExec = struct GraphExecTag*;

// Results and constants of the driver interface that are used by value.
enum : int {
  kSuccess = 0,
  kInvalidValue = 1,
  kOutOfMemory = 2,
  kNoDevice = 100,
  kNotReady = 600,
};
enum DeviceAttribute : int {
  kMultiprocessors = 16,
  kComputeMajor = 75,
  kComputeMinor = 76,
  kMostSharedBytes = 97,  // per block, if the function requests this size
};
enum FunctionAttribute : int {
  kSharedBytes = 8,     // bytes that a launch adds
  kLargeClusters = 14,  // cluster sizes that not every device supports
};
enum : unsigned {
  kStreamDefault = 0,
  kStreamNonBlocking = 1,
  kHostPortable = 1,
  kHostMapped = 2,
  kCaptureRelaxed = 2,
};

// The shape of a launch, for queries about it.
struct LaunchShape {
  unsigned blocks[3], threads[3], shared_bytes;
  Stream stream;
  const void* attributes;
  unsigned attribute_count;
};

// X(member, result, arguments, symbol). A vendor with a different library assigns its own functions
// to the members (VendorInfo::load). The first three members are loaded first, so that every later
// failure can report a version and a text.
#define NOVAPHY_GPU_DRIVER_FUNCTIONS(X)                                                           \
  X(driver_version, Result, (int*), "cuDriverGetVersion")                                         \
  X(error_name, Result, (Result, const char**), "cuGetErrorName")                                 \
  X(error_string, Result, (Result, const char**), "cuGetErrorString")                             \
  X(init, Result, (unsigned), "cuInit")                                                           \
  X(device_count, Result, (int*), "cuDeviceGetCount")                                             \
  X(device_get, Result, (DeviceId*, int), "cuDeviceGet")                                          \
  X(device_name, Result, (char*, int, DeviceId), "cuDeviceGetName")                               \
  X(device_attribute, Result, (int*, int, DeviceId), "cuDeviceGetAttribute")                      \
  X(device_memory, Result, (size_t*, DeviceId), "cuDeviceTotalMem_v2")                            \
  X(context_retain, Result, (Context*, DeviceId), "cuDevicePrimaryCtxRetain")                     \
  X(context_release, Result, (DeviceId), "cuDevicePrimaryCtxRelease_v2")                          \
  X(context_set, Result, (Context), "cuCtxSetCurrent")                                            \
  X(context_get, Result, (Context*), "cuCtxGetCurrent")                                           \
  X(memory_info, Result, (size_t*, size_t*), "cuMemGetInfo_v2")                                   \
  X(alloc, Result, (DevicePointer*, size_t), "cuMemAlloc_v2")                                     \
  X(free, Result, (DevicePointer), "cuMemFree_v2")                                                \
  X(alloc_async, Result, (DevicePointer*, size_t, Stream), "cuMemAllocAsync")                     \
  X(free_async, Result, (DevicePointer, Stream), "cuMemFreeAsync")                                \
  X(host_alloc, Result, (void**, size_t, unsigned), "cuMemHostAlloc")                             \
  X(host_free, Result, (void*), "cuMemFreeHost")                                                  \
  X(host_device_pointer, Result, (DevicePointer*, void*, unsigned),                               \
    "cuMemHostGetDevicePointer_v2")                                                               \
  X(copy_to_device, Result, (DevicePointer, const void*, size_t, Stream), "cuMemcpyHtoDAsync_v2") \
  X(copy_to_host, Result, (void*, DevicePointer, size_t, Stream), "cuMemcpyDtoHAsync_v2")         \
  X(copy_on_device, Result, (DevicePointer, DevicePointer, size_t, Stream),                       \
    "cuMemcpyDtoDAsync_v2")                                                                       \
  X(fill_8, Result, (DevicePointer, unsigned char, size_t, Stream), "cuMemsetD8Async")            \
  X(fill_16, Result, (DevicePointer, unsigned short, size_t, Stream), "cuMemsetD16Async")         \
  X(fill_32, Result, (DevicePointer, unsigned, size_t, Stream), "cuMemsetD32Async")               \
  X(fill_2d_32, Result, (DevicePointer, size_t, unsigned, size_t, size_t, Stream),                \
    "cuMemsetD2D32Async")                                                                         \
  X(stream_create, Result, (Stream*, unsigned), "cuStreamCreate")                                 \
  X(stream_destroy, Result, (Stream), "cuStreamDestroy_v2")                                       \
  X(stream_synchronize, Result, (Stream), "cuStreamSynchronize")                                  \
  X(stream_wait, Result, (Stream, Event, unsigned), "cuStreamWaitEvent")                          \
  X(event_create, Result, (Event*, unsigned), "cuEventCreate")                                    \
  X(event_destroy, Result, (Event), "cuEventDestroy_v2")                                          \
  X(event_record, Result, (Event, Stream), "cuEventRecord")                                       \
  X(event_synchronize, Result, (Event), "cuEventSynchronize")                                     \
  X(event_elapsed, Result, (float*, Event, Event), "cuEventElapsedTime")                          \
  X(module_load, Result, (Module*, const void*), "cuModuleLoadData")                              \
  X(module_unload, Result, (Module), "cuModuleUnload")                                            \
  X(module_function, Result, (Function*, Module, const char*), "cuModuleGetFunction")             \
  X(launch, Result,                                                                               \
    (Function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, Stream,      \
     void**, void**),                                                                             \
    "cuLaunchKernel")                                                                             \
  X(launch_together, Result,                                                                      \
    (Function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned, Stream,      \
     void**),                                                                                     \
    "cuLaunchCooperativeKernel")                                                                  \
  X(blocks_per_unit, Result, (int*, Function, int, size_t),                                       \
    "cuOccupancyMaxActiveBlocksPerMultiprocessor")                                                \
  X(function_set, Result, (Function, int, int), "cuFuncSetAttribute")                             \
  X(clusters_at_once, Result, (int*, Function, const LaunchShape*),                               \
    "cuOccupancyMaxActiveClusters")                                                               \
  X(capture_begin, Result, (Stream, unsigned), "cuStreamBeginCapture_v2")                         \
  X(capture_end, Result, (Stream, Graph*), "cuStreamEndCapture")                                  \
  X(graph_instantiate, Result, (GraphExec*, Graph, unsigned long long),                           \
    "cuGraphInstantiateWithFlags")                                                                \
  X(graph_destroy, Result, (Graph), "cuGraphDestroy")                                             \
  X(graph_exec_destroy, Result, (GraphExec), "cuGraphExecDestroy")                                \
  X(graph_launch, Result, (GraphExec, Stream), "cuGraphLaunch")

struct Driver {
#define NOVAPHY_GPU_MEMBER(name, result, arguments, symbol) result(*name) arguments = nullptr;
  NOVAPHY_GPU_DRIVER_FUNCTIONS(NOVAPHY_GPU_MEMBER)
#undef NOVAPHY_GPU_MEMBER
  int version = 0;  // 13000: CUDA 13.0
  int devices = 0;
  std::string problem;  // reason why no device can be used, or empty

  // Returns a text such as "CUDA_ERROR_OUT_OF_MEMORY: out of memory".
  std::string describe(Result result) const;
};

// Returns the driver, which the first call opens. The driver stays open until the process ends.
// Never throws.
const Driver& driver();
// Loads the functions by the symbols above. Returns false and sets d.problem if one is missing.
bool load_driver(Driver& d, void* library);
// Sets d.problem for a missing symbol, for VendorInfo::load. Returns false.
bool lacks_symbol(Driver& d, const char* symbol);
// Returns a text such as "13.0".
std::string version_text(int version);

}  // namespace novaphy::gpu
