// Launches, and who may record them instead of running them. Libraries change arrays of a device
// through submit_launch alone. Each launch is therefore ordered, raises versions, and can stand in
// a capture, and the library need not know captures.
#pragma once

#include <cstdint>
#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <string_view>

#include "novaphy/core/backend.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/storage.h"

namespace novaphy {

class Array;

// One argument word of a launch: a number, or the address of a range with what the launch does to
// it.
struct LaunchArgument {
  uint64_t word = 0;
  const char* name = "";         // for messages
  std::shared_ptr<Range> range;  // null: a number, or an array of no rows
  uint32_t row_bytes = 0;        // row i touches the bytes [i, i + 1) * row_bytes only; 0: any
  bool read = false, write = false;
  // Float values whose derivative counts: reading them raises where they carry a gradient, because
  // it would stop here.
  bool differentiable = false;

  // The same, of values through which no gradient is meant to flow.
  LaunchArgument detached() && {
    differentiable = false;
    return std::move(*this);
  }
};

// A launch over the rows [0, n). `name`, and the kernel, live as long as the process.
struct Launch {
  const DeviceContext& context;
  novaphy_kernel* kernel;
  const char* name;
  int64_t n;
  std::span<const uint64_t> words;
  std::span<const LaunchArgument> arguments;
};

// Takes what one thread submits. The tensor runtime installs one while a tape or a capture of its
// is active on the thread.
class NOVAPHY_CORE_API LaunchRecorder {
 public:
  virtual ~LaunchRecorder();
  // Runs or records it, and raises the versions of what it writes. Throws before anything is
  // written: ErrorKind::Runtime for a differentiable argument that carries a gradient.
  virtual void launch(const Launch& launch) = 0;
  // Whether gradients of what it records are asked for.
  virtual bool has_tape() const = 0;
  // What is submitted next holds for the present values of the range only, which the host has read.
  // A replay throws once they were written.
  virtual void depends_on(const std::shared_ptr<Range>& range) = 0;
  // The same of a number of a model; `name`, a field of it, lives as long as the process.
  virtual void depends_on(const std::shared_ptr<const float>& number, std::string_view name) = 0;
  // Every replay begins with this, once per owner; what it throws, the replay throws.
  virtual void before_replay(const std::shared_ptr<const void>& owner,
                             const std::function<void()>& check) = 0;
  // What is submitted uses this memory beside its arguments: a replay takes it.
  virtual void uses(const std::shared_ptr<ExclusiveUse>& memory) = 0;
};
NOVAPHY_CORE_API LaunchRecorder* launch_recorder();  // of this thread, or null
NOVAPHY_CORE_API LaunchRecorder* set_launch_recorder(
    LaunchRecorder* recorder);  // returns the one before

// Whether a launch of this thread has run when it returns, and nobody records it.
inline bool runs_at_once(Device device) { return device.is_cpu() && launch_recorder() == nullptr; }

// While one lives, launches of this thread run at once and nobody records them. `here` false: it
// does nothing.
class Unrecorded {
 public:
  explicit Unrecorded(bool here = true) : before_(launch_recorder()) {
    if (here) set_launch_recorder(nullptr);
  }
  Unrecorded(const Unrecorded&) = delete;
  Unrecorded& operator=(const Unrecorded&) = delete;
  ~Unrecorded() { set_launch_recorder(before_); }

 private:
  LaunchRecorder* const before_;
};

// What this thread submits next holds for the present values of these arrays only, which the host
// has read: see LaunchRecorder::depends_on.
NOVAPHY_CORE_API void depend_on(std::span<const Array* const> arrays);
inline void depend_on(std::initializer_list<const Array*> arrays) {
  depend_on(std::span(arrays.begin(), arrays.size()));
}

// By the recorder of this thread, or at once.
NOVAPHY_CORE_API void submit_launch(const Launch& launch);
// At once, whoever records. Versions are the caller's. The error names `name`.
NOVAPHY_CORE_API void launch_now(const DeviceContext& context, novaphy_kernel* kernel,
                                 const char* name, int64_t n, std::span<const uint64_t> words);

}  // namespace novaphy
