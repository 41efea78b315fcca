// Launches, and recorders that take launches instead of running them. Libraries change arrays of a
// device through submit_launch alone. Every launch is therefore ordered, raises the versions of the
// arrays that it writes, and can be captured. The library needs no code for captures.
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

// One argument word of a launch: a number, or a range with the access of the launch to the range.
struct LaunchArgument {
  uint64_t word = 0;
  const char* name = "";         // for error messages
  std::shared_ptr<Range> range;  // null: the word is a number, or the array has no rows
  uint32_t row_bytes = 0;        // row i accesses only bytes [i, i + 1) * row_bytes; 0: any bytes
  bool read = false, write = false;
  // The values are differentiable floats. A recorder throws if a differentiable argument that is
  // read carries a gradient, because a hand-written kernel would lose the gradient.
  bool differentiable = false;

  // Returns the argument without its gradient, for values that carry no gradient on purpose.
  LaunchArgument detached() && {
    differentiable = false;
    return std::move(*this);
  }
};

// A launch over the rows [0, n). `kernel` and `name` live as long as the process.
struct Launch {
  const DeviceContext& context;
  novaphy_kernel* kernel;
  const char* name;
  int64_t n;
  std::span<const uint64_t> words;
  std::span<const LaunchArgument> arguments;
};

// Takes the launches that one thread submits. The tensor runtime installs a recorder while one of
// its tapes or captures is active on the thread.
class NOVAPHY_CORE_API LaunchRecorder {
 public:
  virtual ~LaunchRecorder();
  // Runs or records the launch, and raises the versions of the written ranges. Throws
  // ErrorKind::Runtime before the first write if a differentiable argument carries a gradient.
  virtual void launch(const Launch& launch) = 0;
  // Returns whether a tape needs gradients of the recorded launches.
  virtual bool has_tape() const = 0;
  // Says that later launches are valid only for the present values of the range, because the host
  // has read them. A replay throws if the range was written since.
  virtual void depends_on(const std::shared_ptr<Range>& range) = 0;
  // Says that later launches are valid only for the present value of a number of a model. `name` is
  // the field of the number and lives as long as the process.
  virtual void depends_on(const std::shared_ptr<const float>& number, std::string_view name) = 0;
  // Registers a check that runs at the start of every replay, once per owner. An error of the check
  // becomes an error of the replay.
  virtual void before_replay(const std::shared_ptr<const void>& owner,
                             const std::function<void()>& check) = 0;
  // Says that later launches use the memory of this guard, although it is not among their
  // arguments. A replay claims the guard while it runs.
  virtual void uses(const std::shared_ptr<ExclusiveUse>& memory) = 0;
};
NOVAPHY_CORE_API LaunchRecorder* launch_recorder();  // this thread's recorder, or null
NOVAPHY_CORE_API LaunchRecorder* set_launch_recorder(
    LaunchRecorder* recorder);  // returns the previous recorder

// Returns whether a launch of this thread has finished when the call returns: the device is the CPU
// and no recorder is installed.
inline bool runs_at_once(Device device) { return device.is_cpu() && launch_recorder() == nullptr; }

// Removes the recorder of this thread for the lifetime of the object, so that launches run at once.
// If `here` is false, the object does nothing.
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

// Says that later launches of this thread are valid only for the present values of these arrays,
// because the host has read them. See LaunchRecorder::depends_on.
NOVAPHY_CORE_API void depend_on(std::span<const Array* const> arrays);
inline void depend_on(std::initializer_list<const Array*> arrays) {
  depend_on(std::span(arrays.begin(), arrays.size()));
}

// Gives the launch to the recorder of this thread, or runs the launch if no recorder is installed.
NOVAPHY_CORE_API void submit_launch(const Launch& launch);
// Runs the launch at once, even if a recorder is installed. The caller raises the versions. An
// error message contains `name`.
NOVAPHY_CORE_API void launch_now(const DeviceContext& context, novaphy_kernel* kernel,
                                 const char* name, int64_t n, std::span<const uint64_t> words);

}  // namespace novaphy
