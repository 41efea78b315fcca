// Device memory and pinned host memory, copies and fills.
#include "device.h"

namespace novaphy::gpu {
namespace {

DevicePointer device_pointer(const void* p) { return reinterpret_cast<DevicePointer>(p); }

novaphy_status before_work(novaphy_stream* stream, const char* what, novaphy_error* error) {
  return check_lost(stream->device, what, error);
}

}  // namespace

novaphy_status memory_alloc(novaphy_device* device, int32_t kind, uint64_t bytes, void** pointer,
                            novaphy_error* error) {
  if (kind != NOVAPHY_MEMORY_DEVICE && kind != NOVAPHY_MEMORY_PINNED_HOST)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "memory_alloc: unknown kind %d", kind);
  if (const novaphy_status status = check_lost(device, "memory_alloc", error); status != NOVAPHY_OK)
    return status;
  // The driver aligns device memory to 256 bytes, and pinned memory to pages, as the ABI requires.
  const uint64_t size = bytes == 0 ? 256 : bytes;
  const Use use(device);
  Result result = kOutOfMemory;
  if (kind == NOVAPHY_MEMORY_DEVICE) {
    DevicePointer made = 0;
    if (size <= device->total_memory) result = driver().alloc(&made, size);
    *pointer = reinterpret_cast<void*>(made);
  } else if (size < uint64_t{1} << 47) {
    result = driver().host_alloc(pointer, size, kHostPortable | kHostMapped);
  }
  if (result == kOutOfMemory)
    return fail(error, NOVAPHY_OUT_OF_MEMORY,
                "memory_alloc: no %llu bytes; the device has %llu in all",
                static_cast<unsigned long long>(bytes),
                static_cast<unsigned long long>(device->total_memory));
  return check(device, result, "memory_alloc", error);
}

// memory_free cannot report errors. The memory of a lost device was freed with its context.
void memory_free(novaphy_device* device, int32_t kind, void* pointer) {
  if (pointer == nullptr || device->lost) return;
  const Use use(device);
  if (kind == NOVAPHY_MEMORY_DEVICE) {
    driver().free(device_pointer(pointer));
  } else {
    driver().host_free(pointer);
  }
}

novaphy_status memory_copy(novaphy_stream* stream, int32_t kind, void* target, const void* source,
                           uint64_t bytes, novaphy_error* error) {
  if (kind < NOVAPHY_COPY_DEVICE_TO_DEVICE || kind > NOVAPHY_COPY_DEVICE_TO_HOST)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "memory_copy: unknown kind %d", kind);
  if (bytes == 0) return NOVAPHY_OK;
  if (const novaphy_status status = before_work(stream, "memory_copy", error); status != NOVAPHY_OK)
    return status;
  const Driver& d = driver();
  const Use use(stream->device);
  // With pageable host memory these calls return when the host memory is no longer needed.
  switch (kind) {
    case NOVAPHY_COPY_HOST_TO_DEVICE:
      return check(stream->device,
                   d.copy_to_device(device_pointer(target), source, bytes, stream->stream),
                   "memory_copy", error);
    case NOVAPHY_COPY_DEVICE_TO_HOST: {
      const novaphy_status status = check(
          stream->device, d.copy_to_host(target, device_pointer(source), bytes, stream->stream),
          "memory_copy", error);
      return status != NOVAPHY_OK || stream->capturing ? status
                                                       : check_reads(stream->device, stream, error);
    }
    default:
      return check(
          stream->device,
          d.copy_on_device(device_pointer(target), device_pointer(source), bytes, stream->stream),
          "memory_copy", error);
  }
}

novaphy_status memory_fill(novaphy_stream* stream, void* target, uint64_t pattern,
                           uint32_t pattern_bytes, uint64_t bytes, novaphy_error* error) {
  if (pattern_bytes != 1 && pattern_bytes != 2 && pattern_bytes != 4 && pattern_bytes != 8)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "memory_fill: pattern_bytes: expected 1, 2, 4 or 8, got %u", pattern_bytes);
  if (bytes % pattern_bytes != 0)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "memory_fill: %llu bytes are no multiple of the pattern's %u",
                static_cast<unsigned long long>(bytes), pattern_bytes);
  if (bytes == 0) return NOVAPHY_OK;
  if (const novaphy_status status = before_work(stream, "memory_fill", error); status != NOVAPHY_OK)
    return status;
  const Driver& d = driver();
  const Use use(stream->device);
  const DevicePointer at = device_pointer(target);
  const auto low = static_cast<uint32_t>(pattern), high = static_cast<uint32_t>(pattern >> 32);
  const uint64_t count = bytes / pattern_bytes;
  Result result = kSuccess;
  if (pattern_bytes == 1) {
    result = d.fill_8(at, static_cast<unsigned char>(low), count, stream->stream);
  } else if (pattern_bytes == 2) {
    result = d.fill_16(at, static_cast<unsigned short>(low), count, stream->stream);
  } else if (pattern_bytes == 4) {
    result = d.fill_32(at, low, count, stream->stream);
  } else if (low == high) {
    result = d.fill_32(at, low, 2 * count, stream->stream);
  } else {  // a pattern of eight bytes: its halves as columns of one word in rows of eight bytes
    result = d.fill_2d_32(at, 8, low, 1, count, stream->stream);
    if (result == kSuccess) result = d.fill_2d_32(at + 4, 8, high, 1, count, stream->stream);
  }
  return check(stream->device, result, "memory_fill", error);
}

}  // namespace novaphy::gpu
