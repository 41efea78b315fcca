#include "fusion.h"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <mutex>

#include "device_graph.h"
#include "novaphy/core/parallel.h"
#include "optional_entry.h"

namespace nova::detail {

namespace {

struct FusedRun {
  const novaphy::DeviceContext& context;
  std::span<const OpList::Op> ops;  // of the whole plan
  std::span<const uint64_t> words;
  const Segment& segment;
  std::span<const HostPlan::Series> series;  // from the segment on
  int64_t first_block;
  std::atomic<bool> failed{false};
  std::mutex mutex = {};
  int64_t failed_block = 0;
  novaphy_status status = NOVAPHY_OK;
  novaphy_error error = novaphy::make_error();
  const char* failed_name = "";

  void note(int64_t block, novaphy_status s, const novaphy_error& e, const char* name) {
    const std::lock_guard lock(mutex);
    if (failed && failed_block < block)
      return;  // the first block's error, whatever the threads did
    failed = true;
    failed_block = block;
    status = s;
    error = e;
    failed_name = name;
  }
};

// The rows [begin, begin + rows) of one operation.
novaphy_status run_rows(const novaphy::DeviceContext& context, const OpList::Op& op,
                        const uint64_t* words, int64_t n, int64_t begin, int64_t rows,
                        novaphy_error& error) {
  const novaphy_backend_api& api = *context.api;
  if (op.kind == OpList::Op::Kind::Launch) {
    uint64_t arguments[kMaxFusedWords];
    const int64_t factor = op.n / n;
    const auto skip = static_cast<uint64_t>(begin * factor);
    std::memcpy(arguments, words + op.first_word, op.word_count * sizeof(uint64_t));
    for (const auto* list : {&op.layout->inputs, &op.layout->outputs, &op.layout->tables})
      for (const RowLayout::Word& w : *list) arguments[w.word] += skip * w.row_bytes;
    return api.launch(context.stream, op.kernel, rows * factor, arguments, op.word_count, &error);
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

void run_block(FusedRun& run, int64_t block) {
  const int64_t n = run.segment.n, begin = block * run.segment.block_rows;
  const int64_t rows = std::min(run.segment.block_rows, n - begin);
  novaphy_error error = novaphy::make_error();
  const HostPlan::Series* next = run.series.data();
  const HostPlan::Series* const end = next + run.series.size();
  for (uint32_t k = run.segment.first; k < run.segment.last;) {
    const OpList::Op& op = run.ops[k];
    const bool many = next != end && next->first == k;
    const novaphy_status status =
        many ? run.context.api->series_launch(next->series, begin, begin + rows, &error)
             : run_rows(run.context, op, run.words.data(), n, begin, rows, error);
    if (status != NOVAPHY_OK) [[unlikely]] {
      run.note(block, status, error, op.name);
      return;
    }
    k = many ? (next++)->last : k + 1;
  }
}

// Runs one segment block by block on the threads.
void run_fused(FusedRun& run) {
  const Segment& segment = run.segment;
  const int64_t blocks = (segment.n + segment.block_rows - 1) / segment.block_rows;
  // Between two looks at an interrupt.
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
    if (run.failed) novaphy::check(run.status, run.error, run.failed_name);
  }
}

bool makes_series(const novaphy_backend_api& api) {
  return has_entry(api, &novaphy_backend_api::series_create) &&
         has_entry(api, &novaphy_backend_api::series_destroy);
}

// Whether an operation between a series and `last` may write what those of the series touched.
bool written_since(const RunPlan& plan, std::span<const uint64_t> words,
                   const HostPlan::Series& series, uint32_t last) {
  const auto touched = [&](uint32_t begin, uint32_t end) {
    std::vector<MemoryAccess> all;
    for (uint32_t k = begin; k < end; ++k) touched_by(plan.ops[k], words, {}, all);
    return all;
  };
  const std::vector<MemoryAccess> before = touched(series.first, series.last);
  for (const MemoryAccess& later : touched(series.last, last))
    for (const MemoryAccess& a : before)
      if (later.write && later.begin < a.begin + a.bytes && a.begin < later.begin + later.bytes)
        return true;
  return false;
}

// Where launches of the kernel at k, over the rows of the segment, end.
uint32_t end_of_series(const RunPlan& plan, const Segment& segment, uint32_t k) {
  const OpList::Op& first = plan.ops[k];
  uint32_t end = k;
  while (end < segment.last && plan.ops[end].kind == OpList::Op::Kind::Launch &&
         plan.ops[end].kernel == first.kernel && plan.ops[end].n == segment.n)
    ++end;
  return end;
}

}  // namespace

HostPlan::HostPlan(const novaphy::DeviceContext& context, RunPlan plan,
                   std::span<const uint64_t> words)
    : context_(context), plan_(std::move(plan)), words_(words) {
  const novaphy_backend_api& api = *context.api;
  if (!makes_series(api)) return;
  std::vector<const uint64_t*> arguments;
  for (const Segment& segment : plan_.segments) {
    if (segment.n == 0) continue;
    for (uint32_t k = segment.first; k < segment.last;) {
      const uint32_t end = end_of_series(plan_, segment, k);
      if (end - k < 2) {
        ++k;
        continue;
      }
      const OpList::Op& op = plan_.ops[k];
      arguments.clear();
      for (uint32_t o = k; o < end; ++o)
        arguments.push_back(words.data() + plan_.ops[o].first_word);
      novaphy_series* series = nullptr;
      novaphy_error error = novaphy::make_error();
      const novaphy_status status = api.series_create(context.device, op.kernel, arguments.data(),
                                                      op.word_count, end - k, &series, &error);
      if (status == NOVAPHY_OK) {
        const bool follows = has_entry(api, &novaphy_backend_api::series_follow) &&
                             !series_.empty() && series_.back().first >= segment.first &&
                             !written_since(plan_, words, series_.back(), k);
        if (follows) api.series_follow(series, series_.back().series);
        series_.push_back({k, end, series});
      } else if (status != NOVAPHY_NOT_SUPPORTED) {
        novaphy::check(status, error, op.name);
      }
      k = end;
    }
  }
}

HostPlan::~HostPlan() {
  for (const Series& series : series_) context_.api->series_destroy(series.series);
}

void HostPlan::run() const {
  std::span<const Series> series = series_;
  for (const Segment& segment : plan_.segments) {
    if (segment.n > 0) {
      while (!series.empty() && series.front().first < segment.first) series = series.subspan(1);
      FusedRun run{.context = context_,
                   .ops = plan_.ops,
                   .words = words_,
                   .segment = segment,
                   .series = series,
                   .first_block = 0};
      run_fused(run);
      continue;
    }
    issue_in_order(context_,
                   std::span(plan_.ops).subspan(segment.first, segment.last - segment.first),
                   words_);
  }
}

}  // namespace nova::detail
