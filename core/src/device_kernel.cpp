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

// Returns the module of a kernel source on a device. Modules are made once and kept as long as the
// device.
novaphy_module* source_module(const DeviceContext& context, DeviceSource source, const char* name) {
  static std::mutex mutex;
  static auto& all = *new std::map<std::pair<const DeviceContext*, DeviceSource>, novaphy_module*>;
  const std::lock_guard lock(mutex);
  novaphy_module*& module = all[{&context, source}];
  if (module != nullptr) return module;
  novaphy_error error = make_error();
  check(context.api->module_create(context.device, NOVAPHY_CODE_SOURCE, source(),
                                   std::strlen(source()), &module, &error),
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

DeviceKernel::DeviceKernel(const novaphy_row_function& function, DeviceSource source)
    : name_(function.name),
      function_(&function),
      source_(source),
      all_(*new std::vector<std::unique_ptr<const Made>>) {}
DeviceKernel::DeviceKernel(const char* builtin)
    : name_(builtin), all_(*new std::vector<std::unique_ptr<const Made>>) {}
DeviceKernel::~DeviceKernel() = default;

const DeviceKernel::Made& DeviceKernel::find(Device device) const {
  const DeviceContext& context = device_context(device);
  const std::lock_guard lock(mutex_);
  for (const auto& made : all_)
    if (made->context == &context) return *made;
  all_.push_back(std::make_unique<const Made>(make(context)));
  if (all_.size() == 1) first_.store(all_.front().get(), std::memory_order_release);
  return *all_.back();
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
    require(source_ != nullptr && source_() != nullptr, ErrorKind::NotImplemented, name_,
            ": this build has no code of it for ", context.id.str());
    module = source_module(context, source_, name_);
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
    // The word of an array argument is an address inside of its range.
    NOVAPHY_ASSERT(a.range == nullptr ||
                   a.word - reinterpret_cast<uint64_t>(a.range->data()) <= a.range->bytes());
    if (a.range == nullptr) {
      require(a.row_bytes == 0, ErrorKind::Value, name_, ", ", a.name, ": expected at least ", n,
              " rows, got none");
      continue;
    }
    // A device that uses a pointer of another device fails permanently, so the devices are compared
    // here.
    const Device own = a.range->device();
    if (own != device) [[unlikely]]
      fail(ErrorKind::Value, name_, ", ", a.name, ": expected memory of ", device.str(), ", got ",
           own.str());
    if (a.row_bytes != 0 && a.range->bytes() / a.row_bytes < static_cast<uint64_t>(n)) [[unlikely]]
      fail(ErrorKind::Value, name_, ", ", a.name, ": expected at least ", n, " rows, got ",
           a.range->bytes() / a.row_bytes);
  }
  const Made& made = get(device);
  submit_launch(
      {*made.context, made.kernel, name_, n, std::span(words.data(), arguments.size()), arguments});
}

namespace {

bool is_memory(uint64_t word) { return word != 0 && (word & kArrayBit) == 0; }

// Returns the device of the launch: the device of its arrays.
Device device_of(const char* kernel, std::span<const ArgumentInfo> infos,
                 const ArgumentWord* values) {
  bool has_memory = false;
  for (size_t k = 0; k < infos.size(); ++k) {
    if (infos[k].access == access::kNumber) continue;
    if (const Range* const range = range_of(values[k])) return range->device();
    has_memory |= is_memory(values[k]);
  }
  require(has_memory, ErrorKind::Value, kernel, ": expected an argument with rows");
  return Device::cpu();
}

// Throws an Error about the first invalid argument.
[[noreturn, gnu::noinline]] void refuse(const char* kernel, std::span<const ArgumentInfo> infos,
                                        const ArgumentWord* values, Device device, int64_t n) {
  for (size_t k = 0; k < infos.size(); ++k) {
    const ArgumentInfo& info = infos[k];
    if (info.access == access::kNumber) continue;
    require(!is_memory(values[k]) || (device.is_cpu() && launch_recorder() == nullptr),
            ErrorKind::Runtime, kernel, ", ", info.name, ": expected an array, got memory");
    if (is_memory(values[k])) continue;
    const Range* const range = range_of(values[k]);
    if (range == nullptr && (info.access & access::kOptional) != 0) continue;
    const size_t bytes = range == nullptr ? 0 : range->bytes();
    require(range == nullptr || range->device() == device, ErrorKind::Value, kernel, ", ",
            info.name, ": expected memory of ", device.str(), ", got ",
            range == nullptr ? "" : range->device().str());
    require(bytes >= static_cast<uint64_t>(n) * info.row_bytes, ErrorKind::Value, kernel, ", ",
            info.name, ": expected at least ", n, " rows, got ",
            info.row_bytes == 0 ? 0 : bytes / info.row_bytes);
  }
  fail(ErrorKind::Runtime, kernel, ": an argument changed during its launch");
}

}  // namespace

void DeviceKernel::launch_arrays(int64_t n, std::span<const ArgumentInfo> infos,
                                 const ArgumentWord* values) const {
  if (n == 0) return;
  const auto bits = [](const Device& device) { return std::bit_cast<uint64_t>(device); };
  const Device device = device_of(name_, infos, values);
  const uint64_t device_bits = bits(device), rows = static_cast<uint64_t>(n);
  std::array<uint64_t, kMostWords> words;
  std::array<Range*, kMostWords> written;
  size_t writes = 0;
  bool fits = true;
  for (size_t k = 0; k < infos.size(); ++k) {
    const ArgumentInfo& info = infos[k];
    uint64_t word = values[k];
    if (info.access != access::kNumber) {
      Range* const range = range_of(word);
      if (is_memory(word)) {
        fits &= device.is_cpu() && launch_recorder() == nullptr;
      } else if (range == nullptr) {
        fits &= info.row_bytes == 0 || (info.access & access::kOptional) != 0;
        word = 0;
      } else {
        // A device that uses a pointer of another device fails permanently, so the devices are
        // compared here.
        fits &= static_cast<int>(bits(range->device()) == device_bits) &
                static_cast<int>(range->bytes() >= rows * info.row_bytes);
        word = reinterpret_cast<uint64_t>(range->data());
        if ((info.access & access::kWrite) != 0) written[writes++] = range;
      }
    }
    words[k] = word;
  }
  if (!fits) [[unlikely]]
    refuse(name_, infos, values, device, n);
  const Made& made = get(device);
  const std::span given(words.data(), infos.size());
  if (launch_recorder() == nullptr) [[likely]] {
    launch_now(*made.context, made.kernel, name_, n, given);
    for (size_t k = 0; k < writes; ++k) written[k]->mark_written();
    return;
  }
  std::vector<LaunchArgument> arguments(infos.size());
  for (size_t k = 0; k < infos.size(); ++k) {
    const auto& [name, row_bytes, access] = infos[k];
    arguments[k].word = words[k];
    arguments[k].name = name;
    if (access == access::kNumber || words[k] == 0) continue;
    Range* const range = range_of(values[k]);
    arguments[k].range = {range->storage().shared_from_this(), range};
    arguments[k].row_bytes = row_bytes;
    arguments[k].read = (access & access::kRead) != 0;
    arguments[k].write = (access & access::kWrite) != 0;
    arguments[k].differentiable = (access & access::kDifferentiable) != 0;
  }
  submit_launch({*made.context, made.kernel, name_, n, given, arguments});
}

}  // namespace novaphy
