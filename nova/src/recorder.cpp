// The runtime's recorder of launches of libraries that do not depend on the runtime.
#include "recorder.h"

#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace nova::detail {
namespace {

using novaphy::Launch;
using novaphy::LaunchArgument;

// Refuses arguments that carry a gradient, because a hand-written launch has no known adjoint.
void refuse_gradients(const Tape& tape, const Launch& launch) {
  for (const LaunchArgument& a : launch.arguments) {
    if (!a.read || !a.differentiable || !a.range) continue;
    tape.check_not_of_another(*a.range, launch.name, a.name);
    if (tape.carries_gradient(*a.range))
      novaphy::fail(novaphy::ErrorKind::Runtime, launch.name, ", ", a.name,
                    ": it carries a gradient of the active Tape, which would silently stop in a "
                    "hand-written kernel. Launch it under nova.no_grad() and give its derivative "
                    "with Tape.record_custom");
  }
}

class Recorder : public novaphy::LaunchRecorder {
 public:
  void launch(const Launch& launch) override {
    Tape* const tape = Tape::active();
    if (tape != nullptr) refuse_gradients(*tape, launch);
    accesses_.clear();
    for (const LaunchArgument& a : launch.arguments) {
      if (!a.range) continue;
      const uint64_t bytes =
          a.row_bytes != 0 ? static_cast<uint64_t>(launch.n) * a.row_bytes : a.range->bytes();
      accesses_.push_back({a.word, bytes, a.row_bytes, a.write});
      hold_in_capture(a.range);
    }
    submit_launch(launch.context, launch.kernel, launch.name, launch.n, launch.words, nullptr,
                  accesses_);
    if (tape != nullptr) tape->record_launch(launch, accesses_);
    for (const LaunchArgument& a : launch.arguments)
      if (a.write && a.range) note_write(a.range);
    if (tape == nullptr) return;
    for (const LaunchArgument& a : launch.arguments)
      if (a.write && a.range) tape->mark_constant(*a.range);
  }
  bool has_tape() const override { return Tape::active() != nullptr; }
  void depends_on(const std::shared_ptr<Range>& range) override {
    if (OpList* graph = current_capture()) graph->freeze(range);
  }
  void depends_on(const std::shared_ptr<const float>& number, std::string_view name) override {
    if (OpList* graph = current_capture()) graph->freeze(number, name);
  }
  void before_replay(const std::shared_ptr<const void>& owner,
                     const std::function<void()>& check) override {
    if (OpList* graph = current_capture()) graph->before_launch(owner, check);
  }
  void uses(const std::shared_ptr<novaphy::ExclusiveUse>& memory) override {
    if (OpList* graph = current_capture()) graph->uses(memory);
  }

 private:
  std::vector<MemoryAccess> accesses_;  // accesses of the current launch, a member to reuse the
                                        // memory
};

thread_local Recorder recorder;
thread_local int recorder_depth = 0;
thread_local novaphy::LaunchRecorder* recorder_before = nullptr;

}  // namespace

void enter_recording() {
  if (recorder_depth++ == 0) recorder_before = novaphy::set_launch_recorder(&recorder);
}
void leave_recording() {
  if (--recorder_depth == 0) novaphy::set_launch_recorder(recorder_before);
}

}  // namespace nova::detail
