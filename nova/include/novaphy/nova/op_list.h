// OpList: a list of recorded launches, copies and fills, which a capture replays. Every operation
// of the runtime on device memory goes through submit_*, which runs the operation or records it
// into the capture of this thread.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/storage.h"
#include "novaphy/nova/export.h"

namespace nova {

using novaphy::Range;

enum class GradState : uint8_t;  // tensor.h
namespace detail {
struct RowLayout;
class HostPlan;
// Memory that an operation reads or writes. `row_bytes` is the number of bytes per row if row i of
// the launch accesses only row i of the memory. With 0, a row may access all bytes.
struct MemoryAccess {
  uint64_t begin = 0, bytes = 0;
  uint32_t row_bytes = 0;
  bool write = false;
};
class DeviceReplay;
}  // namespace detail

// Scratch memory that a few operations use, one after the other. Requests with the same number and
// size share memory. With `turns` above 1, such requests alternate between that many buffers.
class NOVAPHY_NOVA_API ScratchMemory {
 public:
  const std::shared_ptr<Range>& take(size_t number, size_t bytes, size_t turns,
                                     const novaphy::Device& device);
  void clear() { known_.clear(); }

 private:
  struct Ranges {
    std::vector<std::shared_ptr<Range>> ranges;
    size_t taken = 0;
  };
  std::map<std::pair<size_t, size_t>, Ranges> known_;  // keyed by number and bytes
};

class NOVAPHY_NOVA_API OpList {
 public:
  struct Op {
    enum class Kind : uint8_t { Launch, Copy, Fill } kind;
    uint32_t first_word = 0, word_count = 0;  // Launch: its argument words
    int64_t n = 0;                            // Launch: number of rows; Copy and Fill: bytes
    novaphy_kernel* kernel = nullptr;
    const char* name = "";
    void* target = nullptr;
    const void* source = nullptr;
    uint32_t pattern = 0;
    const detail::RowLayout* layout =
        nullptr;  // Launch: how the arguments depend on the row; null: unknown
    // Launch: its memory accesses besides those of the layout.
    uint32_t first_access = 0, access_count = 0;
    const int32_t* active = nullptr;  // Launch: number of leading rows to run; null: all rows
    bool tables_change = false;  // in a plan: whether the list writes index tables that the launch
                                 // reads
  };

  // Appends an operation. If accesses and layout are missing, the memory of the operation is
  // unknown, and no operation may move across it.
  void add(Op op, std::span<const uint64_t> words,
           std::span<const detail::MemoryAccess> accesses = {});
  // Keeps a range or a kernel alive as long as the list.
  void hold(std::shared_ptr<const void> owner, size_t bytes = 0) {
    held_.push_back(std::move(owner));
    held_bytes_ += bytes;
  }
  size_t held_bytes() const { return held_bytes_; }
  // Scratch memory of the list, for few operations one after the other.
  ScratchMemory& scratch() { return scratch_; }
  void writes(const std::shared_ptr<Range>& range);
  // Returns whether a recorded operation writes bytes of the range.
  bool writes_to(const Range& range) const;
  // Says that the recording depends on the present value of a range (an index table). launch throws
  // if the value has changed. `arrays`: arrays that were computed from the range and that the
  // recording uses. The dependence ends if the list computes the arrays itself.
  void freeze(const std::shared_ptr<Range>& range, const std::shared_ptr<Range>& arrays = nullptr);
  // Says that the recording depends on the present value of a number of a model, which is an
  // argument of launches. The list keeps the number alive. `name`, the field of the model, must
  // outlive the list.
  void freeze(const std::shared_ptr<const float>& number, std::string_view name);
  // Registers a function that runs at the start of every launch, once per owner. The function
  // updates data that the list only reads. The list keeps the owner alive.
  void before_launch(const std::shared_ptr<const void>& owner, std::function<void()> prepare);
  void end_recording();
  // Records the state of a range's gradient after this point of the list.
  void gradient(const std::shared_ptr<Range>& range, GradState state) { gradients_[range] = state; }
  // Says that operations use the memory of this guard besides their arguments. A launch of the list
  // claims the guard.
  void uses(const std::shared_ptr<novaphy::ExclusiveUse>& memory) { memory_.add(memory); }
  size_t size() const { return ops_.size(); }
  const std::vector<Op>& ops() const { return ops_; }
  uint64_t id() const { return id_; }

  // Runs all operations in order, without an allocation, lock or check per operation. The versions
  // of all written ranges are raised once at the end. Operations that access written memory only at
  // their own row run block by block of rows. A block then stays in the cache, and the results are
  // the same. Threads that launch the same list take turns. Throws if another call uses memory
  // given to `uses`.
  //
  // On a device that compiles kernels, the first launches run the kernels of the operations one by
  // one. Another thread compiles a fused kernel, which takes over when it is ready and gives the
  // same bits. The destructor waits for that thread.
  void launch() const;
  // Makes the plans and compiles the kernels of the first launches now, and waits for them. Throws
  // their errors, and throws while this thread captures. Memory that a launch writes is not
  // touched.
  void prepare() const;
  // Launches a list that runs once, for the code that recorded it. The recording has already raised
  // the versions of the outputs.
  void run_once() const;
  // Launches the list, or appends its operations to the list of recording(). The caller keeps the
  // list alive.
  void submit() const;
  const std::vector<std::shared_ptr<Range>>& written() const { return written_; }
  // Where the list records, and how it runs, in messages.
  const char* place = "a ScopedCapture";
  const char* launcher = "graph.launch()";

  OpList();
  ~OpList();
  OpList(const OpList&) = delete;
  OpList& operator=(const OpList&) = delete;
  const novaphy::DeviceContext* context = nullptr;  // context of the first operation, which all
                                                    // operations share

 private:
  void check_unchanged() const;  // throws if a value has changed that the recording depends on
  void run(bool again) const;    // again: the list runs repeatedly, so that making a plan is worth
                                 // its time
  detail::HostPlan& host_plan(bool again) const;
  detail::DeviceReplay* device_replay() const;  // null: the device cannot replay graphs
  uint64_t id_;
  std::vector<Op> ops_;
  std::vector<uint64_t> words_;
  std::vector<detail::MemoryAccess> accesses_;
  // Made at the first launch, on devices whose memory the host can access.
  mutable std::unique_ptr<detail::HostPlan> host_plan_;
  mutable std::mutex launching_;
  novaphy::ExclusiveUses memory_;
  std::vector<std::shared_ptr<const void>> held_;
  size_t held_bytes_ = 0;
  ScratchMemory scratch_;
  std::vector<std::shared_ptr<Range>> written_;
  std::vector<const Range*> written_keys_;  // sorted; prevents duplicates
  struct Frozen {
    std::shared_ptr<Range> table;
    uint64_t version;
    std::shared_ptr<Range> arrays;
    auto operator<=>(const Frozen&) const = default;
  };
  std::vector<Frozen> frozen_;
  struct FrozenParameter {
    std::shared_ptr<const float> number;
    float recorded;
    std::string_view name;
  };
  std::vector<FrozenParameter> frozen_parameters_;
  std::vector<std::pair<std::shared_ptr<const void>, std::function<void()>>> before_launch_;
  std::map<std::shared_ptr<Range>, GradState> gradients_;  // state after a launch
  // Made at the first launch, on devices that replay graphs. Declared last, because its thread
  // reads the members above.
  mutable std::unique_ptr<detail::DeviceReplay> device_replay_;
};

// Waits for compilations on other threads. A list waits in its destructor, so this function is for
// lists that still exist at the end of the process. The exit destroys static objects of compilers,
// so no compilation may run then. Python calls this function at its exit.
NOVAPHY_NOVA_API void wait_for_compilers();

// Records launches, copies and fills of this thread, instead of running them, for the lifetime of
// the object. Host reads and other operations that cannot be recorded throw an error with the name
// of the call.
class NOVAPHY_NOVA_API ScopedCapture {
 public:
  ScopedCapture();
  ~ScopedCapture();
  ScopedCapture(const ScopedCapture&) = delete;
  ScopedCapture& operator=(const ScopedCapture&) = delete;
  void end();  // stops recording; the destructor also does
  const std::shared_ptr<OpList>& graph() const { return graph_; }

 private:
  std::shared_ptr<OpList> graph_;
  bool active_ = true;
};
NOVAPHY_NOVA_API OpList* current_capture();  // this thread's capture, or null

namespace detail {
// Records the launches of a part that runs several times, such as the body of a scan. Unlike a
// ScopedCapture, this capture may stand inside of another capture.
class PartCapture {
 public:
  PartCapture(const char* place, const char* launcher);
  ~PartCapture();
  PartCapture(const PartCapture&) = delete;
  PartCapture& operator=(const PartCapture&) = delete;
  const std::shared_ptr<OpList>& list() const { return list_; }

 private:
  std::shared_ptr<OpList> list_;
  OpList* outer_;
};
// Submits a copy of bytes on one device. The caller raises versions and keeps the memory alive.
void submit_copy_bytes(const novaphy::DeviceContext& context, void* target, const void* source,
                       int64_t bytes);
}  // namespace detail

// Returns whether the host can read the results of a launch of this thread as soon as the launch
// returns.
inline bool host_can_read(novaphy::Device device) {
  return device.is_cpu() && current_capture() == nullptr;
}

// Collects the submissions of this thread into one list and then runs the list, so that operations
// share the cache. Has no effect inside of a capture, which collects already. flush() runs the
// collected operations.
class NOVAPHY_NOVA_API DeferredScope {
 public:
  explicit DeferredScope(bool wanted);
  ~DeferredScope();  // discards unflushed operations, as after an exception
  DeferredScope(const DeferredScope&) = delete;
  DeferredScope& operator=(const DeferredScope&) = delete;
  void flush();
  void pause();   // runs the collected operations; later ones run directly
  void resume();  // collects again
  size_t held_bytes() const;

 private:
  std::unique_ptr<OpList> list_;
  bool wanted_;
};

// Runs the operations that a DeferredScope of this thread has collected. Code that is about to read
// memory that these operations write calls this function.
NOVAPHY_NOVA_API void flush_deferred();

// Submits a launch of a kernel of this library over n rows. Other libraries use
// novaphy::submit_launch. `words` are the argument words. `name` is for messages and must outlive
// the list.
NOVAPHY_NOVA_API void submit_launch(const novaphy::DeviceContext& context, novaphy_kernel* kernel,
                                    const char* name, int64_t n, std::span<const uint64_t> words,
                                    const detail::RowLayout* layout = nullptr,
                                    std::span<const detail::MemoryAccess> accesses = {},
                                    const int32_t* active = nullptr);
NOVAPHY_NOVA_API void submit_copy(const std::shared_ptr<Range>& target,
                                  const std::shared_ptr<Range>& source);
NOVAPHY_NOVA_API void submit_fill(const std::shared_ptr<Range>& target, float value);
// Says that a submitted operation writes the range: raises its version, now and at every replay.
NOVAPHY_NOVA_API void note_write(const std::shared_ptr<Range>& range);
// Runs a launch now even while a capture records. Used for data that is computed from index tables,
// whose values a capture freezes.
using novaphy::launch_now;
// Returns the capture or the deferred list of this thread, or null.
NOVAPHY_NOVA_API OpList* recording();
// Keeps the owner alive as long as the list of recording(), if one records. `bytes` is memory that
// only this list needs.
template <class T>
void hold_in_capture(const std::shared_ptr<T>& owner, size_t bytes = 0) {
  if (OpList* list = recording()) list->hold(owner, bytes);
}

}  // namespace nova
