#include "novaphy/nova/op_list.h"

#include <algorithm>
#include <bit>
#include <cstring>

#include "device_graph.h"
#include "device_replay.h"
#include "fusion.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/tensor.h"
#include "observer.h"
#include "recorder.h"

namespace nova {

using novaphy::DeviceContext;
using novaphy::ErrorKind;
using novaphy::require;

namespace {

thread_local OpList* capture = nullptr;                // list of the active ScopedCapture
thread_local OpList* deferred = nullptr;               // list of the active DeferredScope
thread_local DeferredScope* deferred_scope = nullptr;  // the scope that owns `deferred`

// With fewer launches of one kernel, finding scans costs more than it saves.
constexpr uint32_t kMinScan = 8;

void run_copy(const DeviceContext& c, void* target, const void* source, int64_t bytes) {
  novaphy_error error = novaphy::make_error();
  novaphy::check(c.api->memory_copy(c.stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, target, source,
                                    static_cast<uint64_t>(bytes), &error),
                 error, "copy");
}
void run_fill(const DeviceContext& c, void* target, uint32_t pattern, int64_t bytes) {
  novaphy_error error = novaphy::make_error();
  novaphy::check(
      c.api->memory_fill(c.stream, target, pattern, 4, static_cast<uint64_t>(bytes), &error), error,
      "fill");
}

void record(const DeviceContext& context, OpList::Op op, std::span<const uint64_t> words = {},
            std::span<const detail::MemoryAccess> accesses = {}) {
  OpList& list = *recording();
  require(list.context == nullptr || list.context == &context, ErrorKind::Runtime,
          "capture: recorded on ", list.context ? list.context->id.str() : "", ", then asked for ",
          context.id.str(), "; a capture holds the work of one device");
  list.context = &context;
  list.add(op, words, accesses);
}

}  // namespace

OpList* recording() { return capture ? capture : deferred; }

OpList::~OpList() = default;

OpList::OpList() {
  static std::atomic<uint64_t> next{0};
  id_ = ++next;
}

void OpList::add(Op op, std::span<const uint64_t> words,
                 std::span<const detail::MemoryAccess> accesses) {
  op.first_word = static_cast<uint32_t>(words_.size());
  op.word_count = static_cast<uint32_t>(words.size());
  words_.insert(words_.end(), words.begin(), words.end());
  op.first_access = static_cast<uint32_t>(accesses_.size());
  op.access_count = static_cast<uint32_t>(accesses.size());
  accesses_.insert(accesses_.end(), accesses.begin(), accesses.end());
  ops_.push_back(op);
}

void OpList::writes(const std::shared_ptr<Range>& range) {
  const Range* key = range.get();
  const auto at = std::lower_bound(written_keys_.begin(), written_keys_.end(), key);
  if (at != written_keys_.end() && *at == key) return;
  written_keys_.insert(at, key);
  written_.push_back(range);
}

bool OpList::writes_to(const Range& range) const {
  const auto written = [](const Range& r, void* keys) {
    const auto& known = *static_cast<const std::vector<const Range*>*>(keys);
    return std::binary_search(known.begin(), known.end(), &r);
  };
  void* keys = const_cast<std::vector<const Range*>*>(&written_keys_);
  return written(range, keys) || range.find_overlap(written, keys) != nullptr;
}

void OpList::freeze(const std::shared_ptr<Range>& range, const std::shared_ptr<Range>& arrays) {
  if (arrays && writes_to(*arrays)) return;
  require(
      !writes_to(*range), ErrorKind::Runtime,
      "capture: an index table that the capture itself writes; an Incidence of it must be rebuilt "
      "after that");
  require(
      !range->writable_export(), ErrorKind::Runtime,
      "capture: an index table with a writable export; a replay could not tell that it changed");
  frozen_.push_back({range, range->version(), arrays});
}

void OpList::end_recording() {
  std::sort(frozen_.begin(), frozen_.end());
  frozen_.erase(std::unique(frozen_.begin(), frozen_.end()), frozen_.end());
  std::erase_if(frozen_, [this](const Frozen& f) { return f.arrays && writes_to(*f.arrays); });
}

void OpList::freeze(const std::shared_ptr<const float>& number, std::string_view name) {
  for (const FrozenParameter& known : frozen_parameters_) {
    if (known.number != number) continue;
    require(std::bit_cast<uint32_t>(known.recorded) == std::bit_cast<uint32_t>(*number),
            ErrorKind::Runtime, "capture: model.", name, ": recorded as ", known.recorded,
            ", then as ", *number, "; a capture holds one value");
    return;
  }
  frozen_parameters_.push_back({number, *number, name});
}

void OpList::before_launch(const std::shared_ptr<const void>& owner,
                           std::function<void()> prepare) {
  for (const auto& [known, _] : before_launch_)
    if (known == owner) return;
  before_launch_.emplace_back(owner, std::move(prepare));
}

void OpList::check_unchanged() const {
  for (const Frozen& f : frozen_)
    require(f.table->version() == f.version, ErrorKind::Runtime, launcher,
            ": an index table (e.g. the contacts) was modified after the capture");
  for (const FrozenParameter& n : frozen_parameters_)
    if (std::bit_cast<uint32_t>(n.recorded) != std::bit_cast<uint32_t>(*n.number)) [[unlikely]]
      novaphy::fail(ErrorKind::Runtime, launcher, ": model.", n.name, ": recorded as ", n.recorded,
                    ", and now ", *n.number, "; record anew, or set it back");
}

void OpList::launch() const {
  require(capture == nullptr, ErrorKind::Runtime,
          "graph.launch() cannot be recorded into another capture");
  if (auto* observer = novaphy::array_observer()) observer->untracked_operation("graph.launch()");
  const std::lock_guard lock(launching_);
  const auto memory = memory_.take("graph.launch()", "what it was captured from");
  check_unchanged();
  for (const auto& [owner, prepare] : before_launch_) prepare();
  // Marks the ranges as written even if an operation fails or is interrupted, because some may have
  // been written.
  struct MarkWritten {
    const std::vector<std::shared_ptr<Range>>& ranges;
    ~MarkWritten() {
      for (const auto& range : ranges) range->mark_written();
    }
  } mark_written{written_};
  if (detail::DeviceReplay* replay = device_replay()) {
    replay->launch();
  } else {
    run(true);
  }
  for (const auto& [range, state] : gradients_) grad_info(*range).state = state;
}

void OpList::prepare() const {
  require(capture == nullptr, ErrorKind::Runtime, "graph.prepare() inside a ScopedCapture");
  const std::lock_guard lock(launching_);
  if (detail::DeviceReplay* replay = device_replay()) {
    replay->prepare();
  } else if (!ops_.empty() && context->host_accessible) {
    host_plan(true);
  }
}

void OpList::run_once() const { run(false); }

void OpList::submit() const {
  OpList* const into = recording();
  if (into == nullptr) return launch();
  check_unchanged();
  for (const Op& op : ops_)
    record(*context, op, std::span(words_).subspan(op.first_word, op.word_count),
           std::span(accesses_).subspan(op.first_access, op.access_count));
  for (const auto& range : written_) note_write(range);
  for (const Frozen& f : frozen_) into->freeze(f.table, f.arrays);
  for (const FrozenParameter& n : frozen_parameters_) into->freeze(n.number, n.name);
  for (const auto& [owner, prepare] : before_launch_) into->before_launch(owner, prepare);
  for (const auto& memory : memory_.all()) into->uses(memory);
  for (const auto& [range, state] : gradients_) into->gradient(range, state);
}

detail::DeviceReplay* OpList::device_replay() const {
  if (!device_replay_ && !ops_.empty() && !context->host_accessible &&
      context->api->capture_begin != nullptr)
    device_replay_ = std::make_unique<detail::DeviceReplay>(*context, ops_, words_, accesses_);
  return device_replay_.get();
}

detail::HostPlan& OpList::host_plan(bool again) const {
  if (!host_plan_)
    host_plan_ = std::make_unique<detail::HostPlan>(
        *context, detail::plan_run(ops_, words_, accesses_, {.min_scan = kMinScan}), words_,
        accesses_, again);
  return *host_plan_;
}

void OpList::run(bool again) const {
  if (ops_.empty()) return;
  if (context->host_accessible) {
    host_plan(again).run();
    return;
  }
  detail::issue_in_order(*context, ops_, words_);
}

DeferredScope::DeferredScope(bool wanted) : wanted_(wanted && !recording()) {
  if (wanted_) detail::enter_recording();
  resume();
}
DeferredScope::~DeferredScope() {
  if (wanted_) detail::leave_recording();
  if (list_ && deferred == list_.get()) deferred = nullptr;
}
void DeferredScope::flush() {
  if (!list_) return;
  deferred = nullptr;  // reset even if running the list throws
  const std::unique_ptr<OpList> full = std::move(list_);
  full->run_once();
  resume();
}
void DeferredScope::pause() {
  flush();
  if (list_) deferred = nullptr;
}
void DeferredScope::resume() {
  if (!wanted_) return;
  if (!list_) list_ = std::make_unique<OpList>();
  deferred = list_.get();
  deferred_scope = this;
}
void flush_deferred() {
  if (deferred) deferred_scope->flush();
}
size_t DeferredScope::held_bytes() const { return list_ ? list_->held_bytes() : 0; }

ScopedCapture::ScopedCapture() : graph_(std::make_shared<OpList>()) {
  require(capture == nullptr, ErrorKind::Runtime,
          "ScopedCapture: another capture is active on this thread");
  capture = graph_.get();
  detail::enter_observation();
}
void ScopedCapture::end() {
  if (!active_) return;
  active_ = false;
  capture = nullptr;
  graph_->end_recording();
  detail::leave_observation();
}
ScopedCapture::~ScopedCapture() { end(); }

OpList* current_capture() { return capture; }

detail::PartCapture::PartCapture(const char* place, const char* launcher)
    : list_(std::make_shared<OpList>()), outer_(capture) {
  list_->place = place;
  list_->launcher = launcher;
  capture = list_.get();
  detail::enter_observation();
}
detail::PartCapture::~PartCapture() {
  capture = outer_;
  list_->end_recording();
  detail::leave_observation();
}

void submit_launch(const DeviceContext& context, novaphy_kernel* kernel, const char* name,
                   int64_t n, std::span<const uint64_t> words, const detail::RowLayout* layout,
                   std::span<const detail::MemoryAccess> accesses, const int32_t* active) {
  if (recording() || active) {
    OpList::Op op{OpList::Op::Kind::Launch};
    op.layout = layout;
    op.n = n;
    op.kernel = kernel;
    op.name = name;
    op.active = active;
    if (recording()) return record(context, op, words, accesses);
    op.word_count = static_cast<uint32_t>(words.size());
    novaphy_error error = novaphy::make_error();
    return novaphy::check(detail::issue(context, op, words.data(), error), error, name);
  }
  launch_now(context, kernel, name, n, words);
}

void detail::submit_copy_bytes(const DeviceContext& context, void* target, const void* source,
                               int64_t bytes) {
  if (!recording()) return run_copy(context, target, source, bytes);
  OpList::Op op{OpList::Op::Kind::Copy};
  op.n = bytes;
  op.name = "copy";
  op.target = target;
  op.source = source;
  record(context, op);
}

void submit_copy(const std::shared_ptr<Range>& target, const std::shared_ptr<Range>& source) {
  detail::submit_copy_bytes(novaphy::device_context(target->storage().device()), target->data(),
                            source->data(), static_cast<int64_t>(target->bytes()));
  hold_in_capture(source);
  hold_in_capture(target);
  note_write(target);
}

void submit_fill(const std::shared_ptr<Range>& target, float value) {
  const DeviceContext& context = novaphy::device_context(target->storage().device());
  const auto bytes = static_cast<int64_t>(target->bytes());
  const auto pattern = std::bit_cast<uint32_t>(value);
  if (recording()) {
    OpList::Op op{OpList::Op::Kind::Fill};
    op.n = bytes;
    op.name = "fill";
    op.target = target->data();
    op.pattern = pattern;
    record(context, op);
    recording()->hold(target);
  } else {
    run_fill(context, target->data(), pattern, bytes);
  }
  note_write(target);
}

void note_write(const std::shared_ptr<Range>& range) {
  if (capture) capture->writes(range);
  range->mark_written();
}

const std::shared_ptr<Range>& ScratchMemory::take(size_t number, size_t bytes, size_t turns,
                                                  const novaphy::Device& device) {
  Ranges& known = known_[{number, bytes}];
  known.ranges.resize(std::max(known.ranges.size(), turns));
  std::shared_ptr<Range>& range = known.ranges[known.taken++ % turns];
  if (!range || range->storage().device() != device)
    range = novaphy::Storage::allocate(bytes, device, false)->range();
  return range;
}

}  // namespace nova
