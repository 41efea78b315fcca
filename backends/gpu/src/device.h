// The objects behind the opaque handles of <novaphy/abi/backend.h>, and the conversion of driver
// errors to errors of the ABI.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "driver.h"
#include "novaphy/abi/backend.h"

namespace novaphy::gpu {

// The record of a failing read, with the layout of device_error in device_prelude.cuh.
struct ErrorRecord {
  int64_t index;  // INT64_MAX: none
  int64_t row;
  int64_t rows;
  uint32_t kernel;
  int32_t source;
  uint32_t lock;
  uint32_t unused;
};
static_assert(sizeof(ErrorRecord) == 40);
// The last argument of every kernel, with the layout of device_sink in device_prelude.cuh.
struct SinkArgument {
  DevicePointer record;
  DevicePointer flag;
  uint32_t kernel;
  uint32_t unused;
  DevicePointer active;
};
static_assert(sizeof(SinkArgument) == 32);

// The names in the message about a failing read, kept as long as the kernel.
struct KernelNames {
  std::string name;
  std::vector<std::string> sources;
};

novaphy_status fail(novaphy_error* error, novaphy_status status, const char* format, ...)
    __attribute__((format(printf, 3, 4)));
// Converts exceptions to a status, because no exception may cross the C boundary.
template <class Body>
novaphy_status guarded(novaphy_error* error, Body&& body) noexcept;

const novaphy_host_api* host();

}  // namespace novaphy::gpu

struct novaphy_device {
  int32_t ordinal = 0;
  novaphy::gpu::DeviceId id = 0;
  novaphy::gpu::Context context = nullptr;
  int32_t arch = 0;  // 90 for compute capability 9.0
  int32_t units = 0;
  uint64_t total_memory = 0;
  novaphy::gpu::Module interpreter = nullptr;  // null until a Program needs it
  // The record of failing reads, and the flag that signals a record.
  novaphy::gpu::DevicePointer record = 0, flag_on_device = 0;
  volatile uint32_t* flag = nullptr;
  std::atomic<bool> lost{false};
  std::mutex mutex;  // guards the members below
  std::string lost_reason;
  uint32_t next_kernel = 1;
  std::unordered_map<uint32_t, novaphy::gpu::KernelNames> kernels;
};
struct novaphy_stream {
  novaphy_device* device;
  novaphy::gpu::Stream stream;
  bool capturing = false;
  novaphy::gpu::Stream before_capture = nullptr;  // the stream used outside of the capture
};
struct novaphy_event {
  novaphy_device* device;
  novaphy::gpu::Event event;
  bool recorded = false;
};
struct novaphy_graph {
  novaphy_device* device;
  novaphy::gpu::GraphExec exec;
};

namespace novaphy::gpu {

// Makes the device's context current, and restores the caller's context at the end of the scope.
class Use {
 public:
  explicit Use(const novaphy_device* device) {
    driver().context_get(&before_);
    if (before_ != device->context) driver().context_set(device->context);
    restore_ = before_ != nullptr && before_ != device->context;
  }
  ~Use() {
    if (restore_) driver().context_set(before_);
  }
  Use(const Use&) = delete;
  Use& operator=(const Use&) = delete;

 private:
  Context before_ = nullptr;
  bool restore_ = false;
};

// Returns OK, or the status and message of a failed driver call. An error that makes the context
// unusable marks the device as lost. Every later call then reports it.
novaphy_status check(novaphy_device* device, Result result, const char* what, novaphy_error* error);
novaphy_status check_lost(novaphy_device* device, const char* what, novaphy_error* error);
// Reports a kernel that read past the end of a source. Must follow a wait of the host for the
// stream.
novaphy_status check_reads(novaphy_device* device, novaphy_stream* stream, novaphy_error* error);
// Frees the modules that the builtins keep for a device. The context of the device must be current.
void forget_builtins(const novaphy_device* device);
// Returns a number that identifies the kernel in the record of a failing read.
uint32_t remember_kernel(novaphy_device* device, KernelNames names);
void forget_kernel(novaphy_device* device, uint32_t kernel);
inline SinkArgument sink_of(const novaphy_device* device, uint32_t kernel,
                            DevicePointer active = 0) {
  return {device->record, device->flag_on_device, kernel, 0, active};
}

// The functions of the ABI's table, ordered by the files that define them.
novaphy_status device_count(int32_t* count, novaphy_error* error);
novaphy_status device_info(int32_t ordinal, novaphy_device_info* info, novaphy_error* error);
novaphy_status device_open(int32_t ordinal, novaphy_device** device, novaphy_error* error);
void device_close(novaphy_device* device);

novaphy_status memory_alloc(novaphy_device* device, int32_t kind, uint64_t bytes, void** pointer,
                            novaphy_error* error);
void memory_free(novaphy_device* device, int32_t kind, void* pointer);
novaphy_status memory_copy(novaphy_stream* stream, int32_t kind, void* target, const void* source,
                           uint64_t bytes, novaphy_error* error);
novaphy_status memory_fill(novaphy_stream* stream, void* target, uint64_t pattern,
                           uint32_t pattern_bytes, uint64_t bytes, novaphy_error* error);

novaphy_status stream_create(novaphy_device* device, novaphy_stream** stream, novaphy_error* error);
void stream_destroy(novaphy_stream* stream);
novaphy_status stream_synchronize(novaphy_stream* stream, novaphy_error* error);
novaphy_status stream_wait(novaphy_stream* stream, novaphy_event* event, novaphy_error* error);
novaphy_status event_create(novaphy_device* device, novaphy_event** event, novaphy_error* error);
void event_destroy(novaphy_event* event);
novaphy_status event_record(novaphy_event* event, novaphy_stream* stream, novaphy_error* error);
novaphy_status event_synchronize(novaphy_event* event, novaphy_error* error);
novaphy_status event_elapsed(novaphy_event* start, novaphy_event* stop, double* seconds,
                             novaphy_error* error);

novaphy_status module_create(novaphy_device* device, int32_t format, const void* data,
                             uint64_t bytes, novaphy_module** module, novaphy_error* error);
void module_destroy(novaphy_module* module);
novaphy_status kernel_get(novaphy_module* module, const char* name, novaphy_kernel** kernel,
                          novaphy_error* error);
novaphy_status launch(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                      const uint64_t* arguments, uint32_t argument_count, novaphy_error* error);
novaphy_status launch_active(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                             const int32_t* active, const uint64_t* arguments,
                             uint32_t argument_count, novaphy_error* error);
novaphy_status kernel_info(novaphy_kernel* kernel, novaphy_kernel_info* info, novaphy_error* error);

novaphy_status list_create(novaphy_device* device, int64_t n, const novaphy_list_op* ops,
                           uint32_t count, novaphy_list** list, novaphy_error* error);
novaphy_status list_launch(novaphy_list* list, novaphy_stream* stream, novaphy_error* error);
void list_destroy(novaphy_list* list);
int32_t persistent_takes(novaphy_device* device, const novaphy_list_op* op);
novaphy_status persistent_create(novaphy_device* device, const novaphy_persistent_op* ops,
                                 uint32_t count, novaphy_list** list, novaphy_error* error);

novaphy_status capture_begin(novaphy_stream* stream, novaphy_error* error);
novaphy_status capture_end(novaphy_stream* stream, novaphy_graph** graph, novaphy_error* error);
novaphy_status graph_launch(novaphy_graph* graph, novaphy_stream* stream, novaphy_error* error);
void graph_destroy(novaphy_graph* graph);

}  // namespace novaphy::gpu

#include <exception>
#include <new>

template <class Body>
novaphy_status novaphy::gpu::guarded(novaphy_error* error, Body&& body) noexcept {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return fail(error, NOVAPHY_OUT_OF_MEMORY, "out of host memory");
  } catch (const std::exception& exception) {
    return fail(error, NOVAPHY_INTERNAL, "%s", exception.what());
  } catch (...) {
    return fail(error, NOVAPHY_INTERNAL, "unknown exception");
  }
}
