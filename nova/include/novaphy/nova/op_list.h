// OpList: recorded launches, copies and fills. A capture replays the list. Every operation of the
// runtime on device memory goes through submit_*, which runs the operation now or records it into
// the capture of this thread.
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
// Memory that an operation reads or writes. `row_bytes`: of one row of its domain; 0: any row.
struct MemoryAccess {
  uint64_t begin = 0, bytes = 0;
  uint32_t row_bytes = 0;
  bool write = false;
};
class DeviceReplay;
}  // namespace detail

// Memory that only a few operations use, one after the other: the same for the same number and
// size, or one of so many that take turns.
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
  std::map<std::pair<size_t, size_t>, Ranges> known_;  // by number and bytes
};

class NOVAPHY_NOVA_API OpList {
 public:
  struct Op {
    enum class Kind : uint8_t { Launch, Copy, Fill } kind;
    uint32_t first_word = 0, word_count = 0;  // Launch: argument words
    int64_t n = 0;                            // Launch: domain; Copy and Fill: bytes
    novaphy_kernel* kernel = nullptr;
    const char* name = "";
    void* target = nullptr;
    const void* source = nullptr;
    uint32_t pattern = 0;
    const detail::RowLayout* layout =
        nullptr;  // Launch: how the arguments depend on the row; null: unknown
    // Launch: what it touches, and the layout does not tell.
    uint32_t first_access = 0, access_count = 0;
    const int32_t* active = nullptr;  // Launch: so many of the first rows; null: all
    bool tables_change = false;  // in a plan: the list writes index tables that the launch reads
  };

  // No accesses and no layout: what a launch touches is not known, and it keeps its place.
  void add(Op op, std::span<const uint64_t> words,
           std::span<const detail::MemoryAccess> accesses = {});
  // Keeps a range (or a kernel) alive for as long as the list lives.
  void hold(std::shared_ptr<const void> owner, size_t bytes = 0) {
    held_.push_back(std::move(owner));
    held_bytes_ += bytes;
  }
  size_t held_bytes() const { return held_bytes_; }
  // Memory that only a few operations of the list use, one after the other. The list keeps it.
  ScratchMemory& scratch() { return scratch_; }
  void writes(const std::shared_ptr<Range>& range);
  // Whether an operation so far writes bytes of the range.
  bool writes_to(const Range& range) const;
  // The recording depends on the present value of the range (an index table): launch throws once it
  // was changed. `arrays`: it depends on them, which were made of the range; no matter where the
  // list makes them itself.
  void freeze(const std::shared_ptr<Range>& range, const std::shared_ptr<Range>& arrays = nullptr);
  // The same of a number of a model, which launches have as an argument. The list keeps its owner;
  // `name`, a field of the model, must outlive the list.
  void freeze(const std::shared_ptr<const float>& number, std::string_view name);
  // Every launch begins with this, once per owner: it brings up to date what the list only reads.
  // The list keeps the owner.
  void before_launch(const std::shared_ptr<const void>& owner, std::function<void()> prepare);
  void end_recording();
  // What the gradient of the range is after this point of the recording.
  void gradient(const std::shared_ptr<Range>& range, GradState state) { gradients_[range] = state; }
  // Memory that the operations use beside what they were given: a launch takes it.
  void uses(const std::shared_ptr<novaphy::ExclusiveUse>& memory) { memory_.add(memory); }
  size_t size() const { return ops_.size(); }
  const std::vector<Op>& ops() const { return ops_; }
  uint64_t id() const { return id_; }

  // Runs all operations in order. No allocation, lock or check per operation; the versions of all
  // written ranges are raised once at the end. Operations that touch written memory at their own
  // row only run block by block of rows, so that a block stays in the cache: the same results, less
  // memory traffic. Threads that launch one list take turns; while somebody else uses what it
  // `uses`, it throws.
  //
  // On a device that compiles, the first launches run the kernels of the operations, and one that
  // fuses them takes over when a thread has compiled it: the same bits, faster. The destructor
  // waits for that thread.
  void launch() const;
  // Does now, and waits for, what else the first launches do or start: plans and compiles. Throws
  // what they would, and while this thread captures. Nothing that a launch writes is touched.
  void prepare() const;
  // The same for a list that is run once, by the code that recorded it: the versions were raised
  // then.
  void run_once() const;

  OpList();
  ~OpList();
  OpList(const OpList&) = delete;
  OpList& operator=(const OpList&) = delete;
  const novaphy::DeviceContext* context = nullptr;  // of the first operation; all must agree

 private:
  void run(bool again) const;  // again: it is worth a plan
  detail::HostPlan& host_plan(bool again) const;
  detail::DeviceReplay* device_replay() const;  // null: the device replays no graphs
  uint64_t id_;
  std::vector<Op> ops_;
  std::vector<uint64_t> words_;
  std::vector<detail::MemoryAccess> accesses_;
  // Made at the first launch, on devices whose memory the host may dereference.
  mutable std::unique_ptr<detail::HostPlan> host_plan_;
  mutable std::mutex launching_;
  novaphy::ExclusiveUses memory_;
  std::vector<std::shared_ptr<const void>> held_;
  size_t held_bytes_ = 0;
  ScratchMemory scratch_;
  std::vector<std::shared_ptr<Range>> written_;
  std::vector<const Range*> written_keys_;  // sorted, to add each once
  struct Frozen {
    std::shared_ptr<Range> table;
    uint64_t version;
    std::shared_ptr<Range> arrays;
    auto operator<=>(const Frozen&) const = default;
  };
  std::vector<Frozen> frozen_;
  struct FrozenNumber {
    std::shared_ptr<const float> number;
    float recorded;
    std::string_view name;
  };
  std::vector<FrozenNumber> frozen_numbers_;
  std::vector<std::pair<std::shared_ptr<const void>, std::function<void()>>> before_launch_;
  std::map<std::shared_ptr<Range>, GradState> gradients_;  // after a launch
  // Made at the first launch, on devices that replay graphs. Last, because its thread reads what is
  // above.
  mutable std::unique_ptr<detail::DeviceReplay> device_replay_;
};

// Waits for what launches have started on other threads. Lists wait when they are destroyed; this
// is for those that a process leaves behind: the exit destroys static objects of compilers, so a
// compilation must not be under way then. Python calls it at its exit.
NOVAPHY_NOVA_API void wait_for_compilers();

// While one is alive, launches, copies and fills of this thread are recorded and not run. Host
// reads and other work that cannot be recorded raise, naming the call.
class NOVAPHY_NOVA_API ScopedCapture {
 public:
  ScopedCapture();
  ~ScopedCapture();
  ScopedCapture(const ScopedCapture&) = delete;
  ScopedCapture& operator=(const ScopedCapture&) = delete;
  void end();  // stops recording; the destructor does it too
  const std::shared_ptr<OpList>& graph() const { return graph_; }

 private:
  std::shared_ptr<OpList> graph_;
  bool active_ = true;
};
NOVAPHY_NOVA_API OpList* current_capture();  // of this thread, or null
// Whether the host can read the results of a launch of this thread when the launch returns.
inline bool host_can_read(novaphy::Device device) {
  return device.is_cpu() && current_capture() == nullptr;
}

// While one is alive, what this thread submits is collected and then run as one list, so that its
// operations can share the cache. Does nothing inside a capture (the capture collects already).
// flush() runs what there is.
class NOVAPHY_NOVA_API DeferredScope {
 public:
  explicit DeferredScope(bool wanted);
  ~DeferredScope();  // discards what was not flushed: an exception is on its way
  DeferredScope(const DeferredScope&) = delete;
  DeferredScope& operator=(const DeferredScope&) = delete;
  void flush();
  void pause();   // flush, and run directly from now on
  void resume();  // collect again
  size_t held_bytes() const;

 private:
  std::unique_ptr<OpList> list_;
  bool wanted_;
};

// Runs what a DeferredScope of this thread has collected: for whoever is about to look at the
// memory.
NOVAPHY_NOVA_API void flush_deferred();

// Launches of this library's own kernels over the domain n; novaphy::submit_launch is for those of
// others. `words` are the argument words; `name` is for messages and must outlive the list.
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
// Runs now even while a capture records: for what is derived from index tables, which a capture
// freezes.
using novaphy::launch_now;
// The capture or deferred list of this thread, or null.
NOVAPHY_NOVA_API OpList* recording();
// Keeps the owner alive while that list (if any) lives. `bytes`: memory that only the list needs.
template <class T>
void hold_in_capture(const std::shared_ptr<T>& owner, size_t bytes = 0) {
  if (OpList* list = recording()) list->hold(owner, bytes);
}

}  // namespace nova
