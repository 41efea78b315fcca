#include "novaphy/core/device_kernel.h"

#include <array>
#include <bit>
#include <cstring>
#include <map>

#include "novaphy/core/assert.h"

namespace novaphy {
namespace {

constexpr size_t kMostWords = 128;

LaunchArgument argument(const char* name, const Array& array, bool read, bool write, bool own_row) {
  const DTypeInfo& type = dtype_info(array.dtype());
  LaunchArgument made;
  made.word = reinterpret_cast<uint64_t>(array.raw());
  made.name = name;
  made.range = array.range();
  made.row_bytes = own_row ? static_cast<uint32_t>(array.width() * type.bytes) : 0;
  made.read = read;
  made.write = write;
  made.differentiable = read && type.scalar == Scalar::F32;
  return made;
}

// A module of the device, made once and kept, as the device is.
novaphy_module* source_module(const DeviceContext& context, DeviceText text, const char* name) {
  static std::mutex mutex;
  static auto& all = *new std::map<std::pair<const DeviceContext*, DeviceText>, novaphy_module*>;
  const std::lock_guard lock(mutex);
  novaphy_module*& module = all[{&context, text}];
  if (module != nullptr) return module;
  novaphy_error error = make_error();
  check(context.api->module_create(context.device, NOVAPHY_CODE_SOURCE, text(), std::strlen(text()),
                                   &module, &error),
        error, name);
  return module;
}

}  // namespace

LaunchArgument reads(const char* name, const Array& array) {
  return argument(name, array, true, false, false);
}
LaunchArgument reads_row(const char* name, const Array& array) {
  return argument(name, array, true, false, true);
}
LaunchArgument writes(const char* name, const Array& array) {
  return argument(name, array, false, true, false);
}
LaunchArgument writes_row(const char* name, const Array& array) {
  return argument(name, array, false, true, true);
}
LaunchArgument updates(const char* name, const Array& array) {
  return argument(name, array, true, true, false);
}
LaunchArgument updates_row(const char* name, const Array& array) {
  return argument(name, array, true, true, true);
}
LaunchArgument number(int64_t value) {
  LaunchArgument made;
  made.word = static_cast<uint64_t>(value);
  return made;
}
LaunchArgument number(float value) {
  LaunchArgument made;
  made.word = std::bit_cast<uint32_t>(value);
  return made;
}

DeviceKernel::DeviceKernel(const novaphy_row_function& function, DeviceText text)
    : name_(function.name),
      function_(&function),
      text_(text),
      all_(*new std::vector<std::unique_ptr<const Made>>) {}
DeviceKernel::DeviceKernel(const char* builtin)
    : name_(builtin), all_(*new std::vector<std::unique_ptr<const Made>>) {}
DeviceKernel::~DeviceKernel() = default;

novaphy_kernel* DeviceKernel::get(const DeviceContext& context) const {
  const Made* const first = first_.load(std::memory_order_acquire);
  if (first != nullptr && first->context == &context) [[likely]]
    return first->kernel;
  const std::lock_guard lock(mutex_);
  for (const auto& made : all_)
    if (made->context == &context) return made->kernel;
  all_.push_back(std::make_unique<const Made>(make(context)));
  if (all_.size() == 1) first_.store(all_.front().get(), std::memory_order_release);
  return all_.back()->kernel;
}

DeviceKernel::Made DeviceKernel::make(const DeviceContext& context) const {
  const novaphy_backend_api& api = *context.api;
  novaphy_error error = make_error();
  novaphy_module* module = nullptr;
  const auto create = [&](int32_t format, const void* data, size_t bytes) {
    check(api.module_create(context.device, format, data, bytes, &module, &error), error, name_);
  };
  if (function_ == nullptr) {
    create(NOVAPHY_CODE_BUILTIN, name_, std::strlen(name_));
  } else if (context.host_accessible) {
    require(function_->rows != nullptr, ErrorKind::NotImplemented, name_, ": it has no code for ",
            context.id.str());
    create(NOVAPHY_CODE_BINARY, function_, sizeof(*function_));
  } else {
    require(text_ != nullptr && text_() != nullptr, ErrorKind::NotImplemented, name_,
            ": this build has no code of it for ", context.id.str());
    module = source_module(context, text_, name_);
  }
  novaphy_kernel* kernel = nullptr;
  check(api.kernel_get(module, function_ == nullptr ? "main" : name_, &kernel, &error), error,
        name_);
  return {&context, module, kernel};
}

void DeviceKernel::launch(Device device, int64_t n,
                          std::span<const LaunchArgument> arguments) const {
  if (n == 0) return;
  require(arguments.size() <= kMostWords, ErrorKind::Value, name_, ": expected at most ",
          kMostWords, " arguments, got ", arguments.size());
  require(function_ == nullptr || arguments.size() == function_->argument_count, ErrorKind::Value,
          name_, ": expected ", function_ == nullptr ? 0 : function_->argument_count,
          " arguments, got ", arguments.size());
  std::array<uint64_t, kMostWords> words;
  for (size_t k = 0; k < arguments.size(); ++k) {
    const LaunchArgument& a = arguments[k];
    words[k] = a.word;
    // A word of an array is an address within it.
    NOVAPHY_ASSERT(a.range == nullptr ||
                   a.word - reinterpret_cast<uint64_t>(a.range->data()) <= a.range->bytes());
    if (a.range == nullptr) {
      require(a.row_bytes == 0, ErrorKind::Value, name_, ", ", a.name, ": expected at least ", n,
              " rows, got none");
      continue;
    }
    // A device that follows a pointer of another one is lost.
    const Device own = a.range->storage().device();
    if (own != device) [[unlikely]]
      fail(ErrorKind::Value, name_, ", ", a.name, ": expected memory of ", device.str(), ", got ",
           own.str());
    if (a.row_bytes != 0 && a.range->bytes() / a.row_bytes < static_cast<uint64_t>(n)) [[unlikely]]
      fail(ErrorKind::Value, name_, ", ", a.name, ": expected at least ", n, " rows, got ",
           a.range->bytes() / a.row_bytes);
  }
  const DeviceContext& context = device_context(device);
  submit_launch(
      {context, get(context), name_, n, std::span(words.data(), arguments.size()), arguments});
}

}  // namespace novaphy
