// Kernel: the launch interface of hand-written kernels (row_kernel.h). The argument struct of a
// kernel says how a launch accesses each array.
//
//   const Kernel<ScaleArguments> kScale(scale, scale_kernels_source);
//   run(kScale, n, {.x = x, .y = y, .factor = 2.0f});
//
// DeviceKernel: the same for builtin kernels of backends, and for kernels without an argument
// struct.
//
//   kScan.launch(device, n, {reads("in", in), writes("out", out)});
//
// A launch names the ranges of memory that it reads and writes. These names determine the order of
// recorded launches, the versions of the arrays, and the lifetime of their memory.
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

// The arguments of a launch, in the order of the kernel's argument words. With `reads`, `writes`
// and `updates` any row of the kernel may access any row of the array; `updates` reads and writes.
// With `..._row`, row i accesses only row i of the array, which therefore needs at least as many
// rows as the launch. Float arrays that are read are differentiable (see LaunchArgument).
NOVAPHY_CORE_API LaunchArgument reads(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument reads_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument writes(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument writes_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument updates(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument updates_row(const char* name, const Array& array);
NOVAPHY_CORE_API LaunchArgument number(int64_t value);

// Returns the source of a *_kernels.h for device compilers, or null if the build has no such
// source.
using DeviceSource = const char* (*)();

// A kernel is compiled or loaded for a device at its first launch there. A DeviceKernel must live
// as long as the process, because recordings refer to it.
class NOVAPHY_CORE_API DeviceKernel {
 public:
  DeviceKernel(const novaphy_row_function& function, DeviceSource source);
  explicit DeviceKernel(const char* builtin);  // name of a builtin, see <novaphy/abi/program.h>
  ~DeviceKernel();
  DeviceKernel(const DeviceKernel&) = delete;
  DeviceKernel& operator=(const DeviceKernel&) = delete;

  const char* name() const { return name_; }
  // Runs the kernel over n rows on the device of the arrays. A launch over 0 rows does nothing.
  // Errors:
  //   ErrorKind::Value           wrong number of arguments, wrong device, too few rows
  //   ErrorKind::NotImplemented  the build has no source of the kernel for the device
  //   ErrorKind::Runtime         the recorder refuses the launch, or the device fails
  void launch(Device device, int64_t n, std::span<const LaunchArgument> arguments) const;
  void launch(Device device, int64_t n, std::initializer_list<LaunchArgument> arguments) const {
    launch(device, n, std::span<const LaunchArgument>(arguments.begin(), arguments.size()));
  }
  // Launches with one array, or the bits of one number, as the value of each argument.
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
  DeviceSource source_ = nullptr;
  mutable std::atomic<const Made*> first_{nullptr};  // the entry of the first device, read without
                                                     // the lock
  mutable std::mutex mutex_;
  std::vector<std::unique_ptr<const Made>>& all_;  // never destroyed, because devices are not
                                                   // either
};

// A DeviceKernel with an argument struct A.
template <class A>
class Kernel : public DeviceKernel {
 public:
  Kernel(const RowKernel<A>& kernel, DeviceSource source) : DeviceKernel(kernel, source) {}
  explicit Kernel(const char* builtin) : DeviceKernel(builtin) {}
};

// Runs the kernel over n rows on the device of the arrays. A thread that records adds the launch to
// the recording instead. Errors as for DeviceKernel::launch.
template <class A>
void run(const Kernel<A>& kernel, int64_t n, const std::type_identity_t<A>& arguments) {
  kernel.launch_arrays(n, detail::ArgumentTable<A>::kInfos,
                       reinterpret_cast<const ArgumentWord*>(&arguments));
}

}  // namespace novaphy
