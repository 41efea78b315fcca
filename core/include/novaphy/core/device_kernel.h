// Kernel: the launch interface of hand-written kernels (row_kernel.h). A kernel's struct of
// arguments says how a launch accesses each array.
//
//   const Kernel<ScaleArguments> kScale(scale, scale_kernels_source);
//   run(kScale, n, {.x = x, .y = y, .factor = 2.0f});
//
// DeviceKernel: the same for the builtins of backends, and for kernels without such a struct.
//
//   kScan.launch(device, n, {reads("in", in), writes("out", out)});
//
// One call says what the launch reads and writes, as ranges: that orders it among recorded
// launches, raises versions and keeps the memory alive.
#pragma once

#include <atomic>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <mutex>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/core/export.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/row_kernel.h"

namespace novaphy {

// The arguments of a launch, in the order of its words. reads and writes: any row in any row; the
// others: row i only in row i, so the array has at least as many rows as the launch. `updates`
// reads and writes. Float arrays that are read are differentiable (see LaunchArgument).
NOVAPHY_CORE_API LaunchArgument reads(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument reads_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument writes(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument writes_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument updates(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument updates_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument number(int64_t value);

// The text of a *_kernels.h for the compilers of devices; null: the build has none.
using DeviceText = const char* (*)();

// Made ready for a device at its first launch there. For objects that live as long as the process:
// recordings refer to them.
class NOVAPHY_CORE_API DeviceKernel {
 public:
  DeviceKernel(const novaphy_row_function& function, DeviceText text);
  explicit DeviceKernel(const char* builtin);  // see <novaphy/abi/program.h>
  ~DeviceKernel();
  DeviceKernel(const DeviceKernel&) = delete;
  DeviceKernel& operator=(const DeviceKernel&) = delete;

  const char* name() const { return name_; }
  // Over n rows on the device of the arrays; 0 rows do nothing, and write nothing. Errors:
  //   ErrorKind::Value           another number of arguments or device, too few rows
  //   ErrorKind::NotImplemented  a device for which the build has no text of the kernel
  //   ErrorKind::Runtime         a recorder refuses, or the device fails
  void launch(Device device, int64_t n, std::span<const LaunchArgument> arguments) const;
  void launch(Device device, int64_t n, std::initializer_list<LaunchArgument> arguments) const {
    launch(device, n, std::span<const LaunchArgument>(arguments.begin(), arguments.size()));
  }
  // The same of an array, or the bits of a number, for each argument.
  void launch_arrays(int64_t n, std::span<const ArgumentInfo> infos,
                     const ArgumentWord* values) const;

 private:
  friend class LaunchList;
  struct Made {
    const DeviceContext* context;
    novaphy_module* module;
    novaphy_kernel* kernel;
  };
  const Made& get(Device device) const {
    const Made* const first = first_.load(std::memory_order_acquire);
    return first != nullptr && first->context->id == device ? *first : find(device);
  }
  const Made& find(Device device) const;
  Made make(const DeviceContext& context) const;

  const char* name_;
  const novaphy_row_function* function_ = nullptr;  // null: a builtin
  DeviceText text_ = nullptr;
  mutable std::atomic<const Made*> first_{nullptr};  // found without the lock
  mutable std::mutex mutex_;
  std::vector<std::unique_ptr<const Made>>& all_;  // never destroyed, like the devices
};

// A DeviceKernel whose arguments are of a struct.
template <class A>
class Kernel : public DeviceKernel {
 public:
  Kernel(const RowKernel<A>& kernel, DeviceText text) : DeviceKernel(kernel, text) {}
  explicit Kernel(const char* builtin) : DeviceKernel(builtin) {}
};

// Over n rows, on the device of the arrays: now, or where this thread records. Errors as
// DeviceKernel::launch.
template <class A>
void run(const Kernel<A>& kernel, int64_t n, const std::type_identity_t<A>& arguments) {
  kernel.launch_arrays(n, detail::ArgumentTable<A>::kInfos,
                       reinterpret_cast<const ArgumentWord*>(&arguments));
}

}  // namespace novaphy
