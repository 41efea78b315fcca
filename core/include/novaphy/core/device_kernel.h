// DeviceKernel: the door for kernels that are no Programs: hand-written ones (row_kernel.h) and the
// builtins of backends.
//
//   const DeviceKernel kScale(scale, scale_kernels_text);
//   kScale.launch(n, {reads_row("x", x), writes_row("y", y), number(2.0f)});
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
NOVAPHY_CORE_API LaunchArgument number(float value);  // a FloatWord

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

 private:
  struct Made {
    const DeviceContext* context;
    novaphy_module* module;
    novaphy_kernel* kernel;
  };
  novaphy_kernel* get(const DeviceContext& context) const;
  Made make(const DeviceContext& context) const;

  const char* name_;
  const novaphy_row_function* function_ = nullptr;  // null: a builtin
  DeviceText text_ = nullptr;
  mutable std::atomic<const Made*> first_{nullptr};  // found without the lock
  mutable std::mutex mutex_;
  std::vector<std::unique_ptr<const Made>>& all_;  // never destroyed, like the devices
};

}  // namespace novaphy
