#include "fusion.h"

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <mutex>

#include "device_graph.h"
#include "intervals.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/launch_trace.h"
#include "novaphy/core/parallel.h"
#include "optional_entry.h"
#include "phased_run.h"
#include "plan_print.h"

namespace nova::detail {

namespace {

// With fewer operations, planning phases costs more than it saves.
constexpr uint32_t kMinPhasedOps = 16;
constexpr uint32_t kShort = 8;  // fewer operations make a short segment

struct FusedRun {
  const novaphy::DeviceContext& context;
  std::span<const OpList::Op> ops;  // all operations of the plan
  std::span<const uint64_t> words;
  const Segment& segment;
  std::span<const HostPlan::Scan> scan;  // the scans (launches of one kernel as one call) of this
                                         // segment
  int64_t first_block;
  std::atomic<bool> failed{false};
  std::mutex mutex = {};
  int64_t failed_block = 0;
  novaphy_status status = NOVAPHY_OK;
  novaphy_error error = novaphy::make_error();
  const OpList::Op* failed_op = nullptr;
  bool by_scan = false;  // error messages of a scan count rows from 0 of the whole launch

  void note(int64_t block, novaphy_status s, const novaphy_error& e, const OpList::Op& op,
            bool many) {
    const std::lock_guard lock(mutex);
    if (failed && failed_block < block)
      return;  // report the error of the first block, whatever thread finds it
    failed = true;
    failed_block = block;
    status = s;
    error = e;
    failed_op = &op;
    by_scan = many;
  }
};

void run_block(FusedRun& run, int64_t block) {
  const int64_t n = run.segment.n, begin = block * run.segment.block_rows;
  const int64_t rows = std::min(run.segment.block_rows, n - begin);
  novaphy_error error = novaphy::make_error();
  const HostPlan::Scan* next = run.scan.data();
  const HostPlan::Scan* const end = next + run.scan.size();
  for (uint32_t k = run.segment.first; k < run.segment.last;) {
    const OpList::Op& op = run.ops[k];
    const bool many = next != end && next->first == k;
    const novaphy_status status =
        many ? novaphy::traced_launch(run.context, op.name, rows,
                                      [&] {
                                        return run.context.api->scan_launch(next->scan, begin,
                                                                            begin + rows, &error);
                                      })
             : run_rows(run.context, op, run.words.data(), n, begin, rows, error);
    if (status != NOVAPHY_OK) [[unlikely]] {
      run.note(block, status, error, op, many);
      return;
    }
    k = many ? (next++)->last : k + 1;
  }
}

// Runs one segment on the threads, block by block.
void run_fused(FusedRun& run) {
  const Segment& segment = run.segment;
  const int64_t blocks = (segment.n + segment.block_rows - 1) / segment.block_rows;
  // Number of blocks between two checks for an interrupt.
  const int64_t per_round = std::max<int64_t>(1, 262144 / segment.block_rows);
  for (; run.first_block < blocks; run.first_block += per_round) {
    novaphy::check_interrupt();
    novaphy::parallel_for(
        std::min(per_round, blocks - run.first_block),
        [](void* self, int64_t chunk) {
          FusedRun& r = *static_cast<FusedRun*>(self);
          run_block(r, r.first_block + chunk);
        },
        &run);
    if (!run.failed) continue;
    if (run.by_scan) novaphy::check(run.status, run.error, run.failed_op->name);
    fail_as_a_whole(run.context, *run.failed_op, run.words.data(), run.status, run.error);
  }
}

bool makes_scan(const novaphy_backend_api& api) {
  return has_entry(api, &novaphy_backend_api::scan_create) &&
         has_entry(api, &novaphy_backend_api::scan_destroy);
}

// Returns whether an operation between a scan and `last` may write memory that the operations of
// the scan accessed. A scan is a row of launches of one kernel that run as one call.
bool written_since(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                   std::span<const MemoryAccess> accesses, const HostPlan::Scan& scan,
                   uint32_t last) {
  const auto touched = [&](uint32_t begin, uint32_t end) {
    std::vector<MemoryAccess> all;
    for (uint32_t k = begin; k < end; ++k) touched_by(ops[k], words, accesses, all);
    return all;
  };
  const std::vector<MemoryAccess> before = touched(scan.first, scan.last);
  for (const MemoryAccess& later : touched(scan.last, last))
    for (const MemoryAccess& a : before)
      if (later.write && share_bytes(later, a)) return true;
  return false;
}

// Returns the end of consecutive launches of the kernel at k over the rows of the segment.
uint32_t end_of_scan(std::span<const OpList::Op> ops, const Segment& segment, uint32_t k) {
  const OpList::Op& first = ops[k];
  uint32_t end = k;
  while (end < segment.last && ops[end].kind == OpList::Op::Kind::Launch &&
         ops[end].kernel == first.kernel && ops[end].n == segment.n)
    ++end;
  return end;
}

}  // namespace

novaphy_status run_rows(const novaphy::DeviceContext& context, const OpList::Op& op,
                        const uint64_t* words, int64_t n, int64_t begin, int64_t rows,
                        novaphy_error& error) {
  if (rows == n) return issue(context, op, words, error);
  const novaphy_backend_api& api = *context.api;
  if (op.kind == OpList::Op::Kind::Launch) {
    uint64_t arguments[kMaxFusedWords];
    const int64_t factor = op.n / n;
    const auto skip = static_cast<uint64_t>(begin * factor);
    NOVAPHY_ASSERT(op.n % n == 0 && op.word_count <= kMaxFusedWords && op.layout != nullptr);
    std::memcpy(arguments, words + op.first_word, op.word_count * sizeof(uint64_t));
    for (const auto* list : {&op.layout->inputs, &op.layout->outputs, &op.layout->tables})
      for (const RowLayout::Word& w : *list) arguments[w.word] += skip * w.row_bytes;
    return novaphy::traced_launch(context, op.name, rows * factor, [&] {
      return api.launch(context.stream, op.kernel, active_rows(op, begin * factor, rows * factor),
                        arguments, op.word_count, &error);
    });
  }
  const int64_t row_bytes = op.n / n;
  const auto skip = static_cast<uint64_t>(begin * row_bytes);
  auto* target = static_cast<char*>(op.target) + skip;
  const auto bytes = static_cast<uint64_t>(rows * row_bytes);
  return op.kind == OpList::Op::Kind::Copy
             ? api.memory_copy(context.stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, target,
                               static_cast<const char*>(op.source) + skip, bytes, &error)
             : api.memory_fill(context.stream, target, op.pattern, 4, bytes, &error);
}

void fail_as_a_whole(const novaphy::DeviceContext& context, const OpList::Op& op,
                     const uint64_t* words, novaphy_status status, const novaphy_error& error) {
  novaphy_error whole = novaphy::make_error();
  const int64_t rows = rows_of(op);
  const novaphy_status again = run_rows(context, op, words, rows, 0, rows, whole);
  if (again == status) novaphy::check(again, whole, op.name);
  novaphy::check(status, error, op.name);
}

HostPlan::HostPlan(const novaphy::DeviceContext& context, RunPlan plan,
                   std::span<const uint64_t> words, std::span<const MemoryAccess> accesses,
                   bool phases)
    : context_(context),
      ops_(std::move(plan.ops)),
      segments_(std::move(plan.segments)),
      words_(words) {
  if (phases) make_phases(accesses);
  if (makes_scan(*context.api)) make_scan(accesses);
  if (phases && prints_plans()) print(accesses);
}

void HostPlan::print(std::span<const MemoryAccess> accesses) const {
  std::vector<PlanPart> parts;
  for (const Segment& segment : segments_) {
    PlanPart part{segment};
    if (const auto found = phases_.find(segment.first); found != phases_.end())
      part.phases = found->second->phases();
    for (const Scan& scan : scans_)
      if (scan.first >= segment.first && scan.last <= segment.last) ++part.scans;
    parts.push_back(part);
  }
  std::fputs(describe_plan(ops_, parts, words_, accesses).c_str(), stderr);
}

void HostPlan::make_scan(std::span<const MemoryAccess> accesses) {
  const novaphy_backend_api& api = *context_.api;
  std::vector<const uint64_t*> arguments;
  for (const Segment& segment : segments_) {
    if (segment.n == 0) continue;
    for (uint32_t k = segment.first; k < segment.last;) {
      const uint32_t end = end_of_scan(ops_, segment, k);
      if (end - k < 2) {
        ++k;
        continue;
      }
      const OpList::Op& op = ops_[k];
      arguments.clear();
      for (uint32_t o = k; o < end; ++o) arguments.push_back(words_.data() + ops_[o].first_word);
      const bool follows = !scans_.empty() && scans_.back().first >= segment.first &&
                           !written_since(ops_, words_, accesses, scans_.back(), k);
      novaphy_scan* scan = nullptr;
      novaphy_error error = novaphy::make_error();
      const novaphy_status status =
          api.scan_create(context_.device, op.kernel, arguments.data(), op.word_count, end - k,
                          follows ? scans_.back().scan : nullptr, &scan, &error);
      if (status == NOVAPHY_OK) {
        scans_.push_back({k, end, scan});
      } else if (status != NOVAPHY_NOT_SUPPORTED) {
        novaphy::check(status, error, op.name);
      }
      k = end;
    }
  }
}

// Divides the operations outside of long segments into phases. Short segments become parts of
// phases too, because a short segment would otherwise end a run of phases.
void HostPlan::make_phases(std::span<const MemoryAccess> accesses) {
  const auto is_short = [](const Segment& s) { return s.n == 0 || s.last - s.first < kShort; };
  std::vector<Segment> cut;
  for (size_t k = 0; k < segments_.size();) {
    size_t end = k;
    while (end < segments_.size() && is_short(segments_[end])) ++end;
    if (end == k || segments_[end - 1].last - segments_[k].first < kMinPhasedOps) {
      cut.insert(cut.end(), segments_.begin() + k, segments_.begin() + std::max(end, k + 1));
    } else {
      cut_into_phases(segments_[k].first, segments_[end - 1].last, accesses, cut);
    }
    k = std::max(end, k + 1);
  }
  segments_ = std::move(cut);
}

void HostPlan::cut_into_phases(uint32_t first, uint32_t last,
                               std::span<const MemoryAccess> accesses, std::vector<Segment>& cut) {
  while (first < last) {
    uint32_t end = first;
    while (end < last && fits_phases(ops_[end], words_, accesses)) ++end;
    if (end - first >= kMinPhasedOps) {
      cut.push_back({first, end});
      phases_.emplace(
          first, std::make_unique<PhasedRun>(context_, std::span(ops_).subspan(first, end - first),
                                             words_, accesses));
    } else {
      end = std::max(end, first + 1);
      cut.push_back({first, end});
    }
    first = end;
  }
}

HostPlan::~HostPlan() {
  for (const Scan& scan : scans_) context_.api->scan_destroy(scan.scan);
}

void HostPlan::run() const {
  std::span<const Scan> scan = scans_;
  auto phases = phases_.begin();
  for (const Segment& segment : segments_) {
    if (segment.n > 0) {
      while (!scan.empty() && scan.front().first < segment.first) scan = scan.subspan(1);
      FusedRun run{.context = context_,
                   .ops = ops_,
                   .words = words_,
                   .segment = segment,
                   .scan = scan,
                   .first_block = 0};
      run_fused(run);
    } else if (phases != phases_.end() && phases->first == segment.first) {
      (phases++)->second->run();
    } else {
      issue_in_order(context_, std::span(ops_).subspan(segment.first, segment.last - segment.first),
                     words_);
    }
  }
}

}  // namespace nova::detail
