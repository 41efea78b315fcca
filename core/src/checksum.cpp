// Range::checksum, computed on the device that has the bytes.
#include <map>
#include <mutex>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"

namespace novaphy {
namespace {

// Returns the checksum kernel of a device, or null if the backend lacks it. The kernel is made once
// per device and never destroyed.
novaphy_kernel* checksum_kernel(const DeviceContext& context) {
  static std::mutex mutex;
  static auto& known = *new std::map<const DeviceContext*, novaphy_kernel*>;
  const std::lock_guard lock(mutex);
  if (const auto at = known.find(&context); at != known.end()) return at->second;
  constexpr char kName[] = "checksum_u64";
  novaphy_error error = make_error();
  novaphy_module* module = nullptr;
  novaphy_kernel* kernel = nullptr;
  const novaphy_status status = context.api->module_create(
      context.device, NOVAPHY_CODE_BUILTIN, kName, sizeof(kName) - 1, &module, &error);
  if (status != NOVAPHY_INVALID_ARGUMENT) {
    check(status, error, "checksum");
    check(context.api->kernel_get(module, "main", &kernel, &error), error, "checksum");
  }
  return known[&context] = kernel;
}

uint64_t checksum_of(const Device& device, const void* data, size_t bytes) {
  const DeviceContext& context = device_context(device);
  novaphy_error error = make_error();
  novaphy_kernel* const kernel = checksum_kernel(context);
  if (kernel == nullptr) {
    std::vector<unsigned char> host(bytes);
    check(context.api->memory_copy(context.stream, NOVAPHY_COPY_DEVICE_TO_HOST, host.data(), data,
                                   bytes, &error),
          error, "checksum");
    return checksum_of(Device::cpu(), host.data(), bytes);
  }
  uint64_t sum = 0;
  const std::shared_ptr<Storage> out = Storage::allocate(sizeof(sum), device, false);
  const uint64_t words[] = {reinterpret_cast<uint64_t>(data), bytes,
                            reinterpret_cast<uint64_t>(out->data())};
  check(context.api->launch(context.stream, kernel, static_cast<int64_t>((bytes + 7) / 8), words, 3,
                            &error),
        error, "checksum");
  check(context.api->memory_copy(context.stream, NOVAPHY_COPY_DEVICE_TO_HOST, &sum, out->data(),
                                 sizeof(sum), &error),
        error, "checksum");
  return sum;
}

}  // namespace

uint64_t Range::checksum() const {
  return bytes_ == 0 ? 0 : checksum_of(storage_->device(), data_, bytes_);
}

}  // namespace novaphy
