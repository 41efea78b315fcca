// Devices, driver errors, and errors of kernels that read past the end of a source.
#include "device.h"

#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <limits>

#include "vendor.h"

namespace novaphy::gpu {
namespace {

constexpr ErrorRecord kNoError = {std::numeric_limits<int64_t>::max(), 0, 0, 0, -1, 0, 0};

// Returns whether the device can no longer be used in this process after an error.
bool is_fatal(Result result) {
  switch (result) {
    case 4:    // the driver is shutting down
    case 46:   // device unavailable
    case 214:  // uncorrectable memory error
    case 220:  // broken link between devices
    case 700:  // illegal address
    case 702:  // timeout
    case 709:  // the context is gone
    case 710:  // assertion on the device
    case 714:  // hardware stack
    case 715:  // illegal instruction
    case 716:  // misaligned address
    case 717:  // invalid address space
    case 718:  // invalid program counter
    case 719:  // launch failure
    case 999:  // unknown error, for example of a card that lost its bus
      return true;
    default:
      return false;
  }
}

novaphy_status check_ordinal(int32_t ordinal, novaphy_error* error) {
  const Driver& d = driver();
  if (d.devices == 0) return fail(error, NOVAPHY_NOT_SUPPORTED, "%s", d.problem.c_str());
  if (ordinal >= 0 && ordinal < d.devices) return NOVAPHY_OK;
  return fail(error, NOVAPHY_INVALID_ARGUMENT, "device ordinal: expected 0 to %d, got %d",
              d.devices - 1, ordinal);
}

// Allocates the record of failing reads, and the flag that signals a record.
novaphy_status make_sink(novaphy_device& device, novaphy_error* error) {
  const Driver& d = driver();
  void* flag = nullptr;
  novaphy_status status =
      check(&device, d.host_alloc(&flag, 256, kHostPortable | kHostMapped), "device_open", error);
  if (status != NOVAPHY_OK) return status;
  std::memset(flag, 0, 256);
  device.flag = static_cast<volatile uint32_t*>(flag);
  status =
      check(&device, d.host_device_pointer(&device.flag_on_device, flag, 0), "device_open", error);
  if (status != NOVAPHY_OK) return status;
  // Zeros follow the record. A load reads zeros in place of a row that does not exist, so there are
  // as many zeros as the widest row of a Program has.
  constexpr size_t kBytes = 128 + 4 * 4096;
  status = check(&device, d.alloc(&device.record, kBytes), "device_open", error);
  if (status != NOVAPHY_OK) return status;
  status = check(&device, d.fill_8(device.record, 0, kBytes, nullptr), "device_open", error);
  if (status != NOVAPHY_OK) return status;
  status = check(&device, d.copy_to_device(device.record, &kNoError, sizeof(kNoError), nullptr),
                 "device_open", error);
  if (status != NOVAPHY_OK) return status;
  return check(&device, d.stream_synchronize(nullptr), "device_open", error);
}

void release(novaphy_device* device) {
  const Driver& d = driver();
  {
    const Use use(device);
    forget_builtins(device);
    if (device->interpreter != nullptr && !device->lost) d.module_unload(device->interpreter);
    if (device->record != 0) d.free(device->record);
    if (device->flag != nullptr) d.host_free(const_cast<uint32_t*>(device->flag));
  }
  d.context_release(device->id);
  delete device;
}

}  // namespace

novaphy_status fail(novaphy_error* error, novaphy_status status, const char* format, ...) {
  if (error != nullptr) {
    error->status = status;
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(error->message, sizeof(error->message), format, arguments);
    va_end(arguments);
  }
  return status;
}

novaphy_status check_lost(novaphy_device* device, const char* what, novaphy_error* error) {
  if (!device->lost.load(std::memory_order_acquire)) [[likely]]
    return NOVAPHY_OK;
  const std::lock_guard lock(device->mutex);
  return fail(error, NOVAPHY_DEVICE_LOST, "%s: device %s:%d is lost since %s", what, vendor().name,
              device->ordinal, device->lost_reason.c_str());
}

novaphy_status check(novaphy_device* device, Result result, const char* what,
                     novaphy_error* error) {
  if (result == kSuccess) [[likely]]
    return NOVAPHY_OK;
  const std::string text = driver().describe(result);
  if (is_fatal(result)) {
    {
      const std::lock_guard lock(device->mutex);
      if (!device->lost) device->lost_reason = std::string(what) + " failed with " + text;
    }
    device->lost.store(true, std::memory_order_release);
    return check_lost(device, what, error);
  }
  if (result == kOutOfMemory)
    return fail(error, NOVAPHY_OUT_OF_MEMORY, "%s: %s", what, text.c_str());
  if (result == kInvalidValue)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "%s: %s", what, text.c_str());
  return fail(error, NOVAPHY_INTERNAL, "%s: %s", what, text.c_str());
}

novaphy_status check_reads(novaphy_device* device, novaphy_stream* stream, novaphy_error* error) {
  if (*device->flag == 0) [[likely]]
    return NOVAPHY_OK;
  const Driver& d = driver();
  ErrorRecord record;
  novaphy_status status =
      check(device, d.copy_to_host(&record, device->record, sizeof(record), stream->stream),
            "launch", error);
  if (status == NOVAPHY_OK)
    status = check(device, d.stream_synchronize(stream->stream), "launch", error);
  if (status != NOVAPHY_OK) return status;
  *device->flag = 0;
  status =
      check(device, d.copy_to_device(device->record, &kNoError, sizeof(kNoError), stream->stream),
            "launch", error);
  if (status != NOVAPHY_OK) return status;
  KernelNames names;
  {
    const std::lock_guard lock(device->mutex);
    const auto found = device->kernels.find(record.kernel);
    if (found != device->kernels.end()) names = found->second;
  }
  if (names.name.empty()) names.name = "(destroyed)";
  if (record.source < 0)
    return fail(error, NOVAPHY_INDEX_OUT_OF_RANGE, "%s: slot %lld holds row %lld of %lld rows",
                names.name.c_str(), static_cast<long long>(record.index),
                static_cast<long long>(record.row), static_cast<long long>(record.rows));
  const auto source = static_cast<size_t>(record.source);
  return fail(error, NOVAPHY_INDEX_OUT_OF_RANGE,
              "kernel '%s': row i = %lld reads row %lld of source '%s', which has %lld rows",
              names.name.c_str(), static_cast<long long>(record.index),
              static_cast<long long>(record.row),
              source < names.sources.size() ? names.sources[source].c_str() : "?",
              static_cast<long long>(record.rows));
}

uint32_t remember_kernel(novaphy_device* device, KernelNames names) {
  const std::lock_guard lock(device->mutex);
  const uint32_t number = device->next_kernel++;
  device->kernels.emplace(number, std::move(names));
  return number;
}

void forget_kernel(novaphy_device* device, uint32_t kernel) {
  const std::lock_guard lock(device->mutex);
  device->kernels.erase(kernel);
}

novaphy_status device_count(int32_t* count, novaphy_error* error) {
  const Driver& d = driver();
  *count = d.devices;
  if (d.devices == 0) fail(error, NOVAPHY_OK, "%s", d.problem.c_str());
  return NOVAPHY_OK;
}

novaphy_status device_info(int32_t ordinal, novaphy_device_info* info, novaphy_error* error) {
  if (const novaphy_status status = check_ordinal(ordinal, error); status != NOVAPHY_OK)
    return status;
  const uint64_t size = info->struct_size;
  if (size < sizeof(novaphy_device_info)) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "device_info: struct_size: expected at least %zu, got %llu",
                sizeof(novaphy_device_info), static_cast<unsigned long long>(size));
  }
  *info = {};
  info->struct_size = size;
  const Driver& d = driver();
  DeviceId id = 0;
  int major = 0, minor = 0, units = 0;
  size_t total = 0, free_bytes = 0, all = 0;
  Result result = d.device_get(&id, ordinal);
  if (result == kSuccess) result = d.device_name(info->name, sizeof(info->name), id);
  if (result == kSuccess) result = d.device_attribute(&major, kComputeMajor, id);
  if (result == kSuccess) result = d.device_attribute(&minor, kComputeMinor, id);
  if (result == kSuccess) result = d.device_attribute(&units, kMultiprocessors, id);
  if (result == kSuccess) result = d.device_memory(&total, id);
  // Only a context knows the free memory. Without a context the free memory is reported as zero.
  Context context = nullptr;
  if (result == kSuccess && d.context_retain(&context, id) == kSuccess) {
    novaphy_device here;
    here.context = context;
    {
      const Use use(&here);
      if (d.memory_info(&free_bytes, &all) != kSuccess) free_bytes = 0;
    }
    d.context_release(id);
  }
  if (result != kSuccess)
    return fail(error, NOVAPHY_INTERNAL, "device_info: %s", d.describe(result).c_str());
  info->arch = 10 * major + minor;
  info->units = units;
  info->total_memory = total;
  info->free_memory = free_bytes < total ? free_bytes : total;
  info->capabilities =
      NOVAPHY_CAP_SOURCE_MODULES | (vendor().graphs ? NOVAPHY_CAP_GRAPH_CAPTURE : 0);
  return NOVAPHY_OK;
}

novaphy_status device_open(int32_t ordinal, novaphy_device** device, novaphy_error* error) {
  if (const novaphy_status status = check_ordinal(ordinal, error); status != NOVAPHY_OK)
    return status;
  return guarded(error, [&] {
    const Driver& d = driver();
    auto made = std::make_unique<novaphy_device>();
    made->ordinal = ordinal;
    int major = 0, minor = 0;
    size_t total = 0;
    Result result = d.device_get(&made->id, ordinal);
    if (result == kSuccess) result = d.device_attribute(&major, kComputeMajor, made->id);
    if (result == kSuccess) result = d.device_attribute(&minor, kComputeMinor, made->id);
    if (result == kSuccess) result = d.device_attribute(&made->units, kMultiprocessors, made->id);
    if (result == kSuccess) result = d.device_memory(&total, made->id);
    if (result == kSuccess) result = d.context_retain(&made->context, made->id);
    if (result != kSuccess) return check(made.get(), result, "device_open", error);
    made->arch = 10 * major + minor;
    made->total_memory = total;
    novaphy_device* const opened = made.release();
    novaphy_status status = NOVAPHY_OK;
    {
      const Use use(opened);
      status = make_sink(*opened, error);
    }
    if (status != NOVAPHY_OK) {
      release(opened);
      return status;
    }
    *device = opened;
    return NOVAPHY_OK;
  });
}

void device_close(novaphy_device* device) { release(device); }

}  // namespace novaphy::gpu
