// Adapts a run-time library with CUDA's interface to the driver table (driver.h).
//
// The table below uses CUDA's function names, because Denglin's library has not been tested. A file
// can replace the names.
#pragma once

#include <string>

#include "driver.h"

namespace novaphy::gpu {

struct Dim3 {
  unsigned x, y, z;
};

// X(member, result, arguments, symbol, needed). If `needed` is false, a missing function has a
// replacement.
#define NOVAPHY_DLAN_FUNCTIONS(X)                                                                \
  X(version, Result, (int*), "cudaRuntimeGetVersion", false)                                     \
  X(error_name, const char*, (Result), "cudaGetErrorName", true)                                 \
  X(error_string, const char*, (Result), "cudaGetErrorString", true)                             \
  X(device_count, Result, (int*), "cudaGetDeviceCount", true)                                    \
  X(device_set, Result, (int), "cudaSetDevice", true)                                            \
  X(device_now, Result, (int*), "cudaGetDevice", true)                                           \
  X(device_attribute, Result, (int*, int, int), "cudaDeviceGetAttribute", true)                  \
  X(device_properties, Result, (void*, int), "cudaGetDeviceProperties", false)                   \
  X(memory_info, Result, (size_t*, size_t*), "cudaMemGetInfo", true)                             \
  X(alloc, Result, (DevicePointer*, size_t), "cudaMalloc", true)                                 \
  X(free, Result, (DevicePointer), "cudaFree", true)                                             \
  X(alloc_async, Result, (DevicePointer*, size_t, Stream), "cudaMallocAsync", false)             \
  X(free_async, Result, (DevicePointer, Stream), "cudaFreeAsync", false)                         \
  X(host_alloc, Result, (void**, size_t, unsigned), "cudaHostAlloc", true)                       \
  X(host_free, Result, (void*), "cudaFreeHost", true)                                            \
  X(host_device_pointer, Result, (DevicePointer*, void*, unsigned), "cudaHostGetDevicePointer",  \
    true)                                                                                        \
  X(copy, Result, (void*, const void*, size_t, int, Stream), "cudaMemcpyAsync", true)            \
  X(fill, Result, (DevicePointer, int, size_t, Stream), "cudaMemsetAsync", true)                 \
  X(stream_create, Result, (Stream*, unsigned), "cudaStreamCreateWithFlags", true)               \
  X(stream_destroy, Result, (Stream), "cudaStreamDestroy", true)                                 \
  X(stream_synchronize, Result, (Stream), "cudaStreamSynchronize", true)                         \
  X(stream_wait, Result, (Stream, Event, unsigned), "cudaStreamWaitEvent", true)                 \
  X(event_create, Result, (Event*, unsigned), "cudaEventCreateWithFlags", true)                  \
  X(event_destroy, Result, (Event), "cudaEventDestroy", true)                                    \
  X(event_record, Result, (Event, Stream), "cudaEventRecord", true)                              \
  X(event_synchronize, Result, (Event), "cudaEventSynchronize", true)                            \
  X(event_elapsed, Result, (float*, Event, Event), "cudaEventElapsedTime", true)                 \
  X(launch, Result, (const void*, Dim3, Dim3, void**, size_t, Stream), "cudaLaunchKernel", true) \
  X(blocks_per_unit, Result, (int*, Function, int, size_t),                                      \
    "cudaOccupancyMaxActiveBlocksPerMultiprocessor", false)

// The function VendorInfo::load: fills the driver table from the library and opens the kernels
// (kernels.h).
bool load_runtime(Driver& d, void* library);

}  // namespace novaphy::gpu
