#include "fusion.h"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <mutex>

#include "novaphy/core/parallel.h"

namespace nova::detail {

namespace {

struct FusedRun {
  const novaphy::DeviceContext& context;
  std::span<const OpList::Op> ops;
  std::span<const uint64_t> words;
  const Segment& segment;
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

void run_block(FusedRun& run, int64_t block) {
  const int64_t n = run.segment.n, begin = block * run.segment.block_rows;
  const int64_t rows = std::min(run.segment.block_rows, n - begin);
  const novaphy_backend_api& api = *run.context.api;
  novaphy_error error = novaphy::make_error();
  uint64_t arguments[kMaxFusedWords];
  for (const OpList::Op& op : run.ops) {
    novaphy_status status = NOVAPHY_OK;
    if (op.kind == OpList::Op::Kind::Launch) {
      const int64_t factor = op.n / n;
      const auto skip = static_cast<uint64_t>(begin * factor);
      std::memcpy(arguments, run.words.data() + op.first_word, op.word_count * sizeof(uint64_t));
      for (const auto* list : {&op.layout->inputs, &op.layout->outputs, &op.layout->tables})
        for (const RowLayout::Word& w : *list) arguments[w.word] += skip * w.row_bytes;
      status = api.launch(run.context.stream, op.kernel, rows * factor, arguments, op.word_count,
                          &error);
    } else {
      const int64_t row_bytes = op.n / n;
      const auto skip = static_cast<uint64_t>(begin * row_bytes);
      auto* target = static_cast<char*>(op.target) + skip;
      const auto bytes = static_cast<uint64_t>(rows * row_bytes);
      status = op.kind == OpList::Op::Kind::Copy
                   ? api.memory_copy(run.context.stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, target,
                                     static_cast<const char*>(op.source) + skip, bytes, &error)
                   : api.memory_fill(run.context.stream, target, op.pattern, 4, bytes, &error);
    }
    if (status != NOVAPHY_OK) [[unlikely]] {
      run.note(block, status, error, op.name);
      return;
    }
  }
}

}  // namespace

void run_fused(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
               std::span<const uint64_t> words, const Segment& segment) {
  const int64_t blocks = (segment.n + segment.block_rows - 1) / segment.block_rows;
  // Between two looks at an interrupt.
  const int64_t per_round = std::max<int64_t>(1, 262144 / segment.block_rows);
  for (int64_t first = 0; first < blocks; first += per_round) {
    novaphy::check_interrupt();
    FusedRun run{.context = context,
                 .ops = ops.subspan(segment.first, segment.last - segment.first),
                 .words = words,
                 .segment = segment,
                 .first_block = first};
    novaphy::parallel_for(
        std::min(per_round, blocks - first),
        [](void* self, int64_t chunk) {
          FusedRun& r = *static_cast<FusedRun*>(self);
          run_block(r, r.first_block + chunk);
        },
        &run);
    if (run.failed) novaphy::check(run.status, run.error, run.failed_name);
  }
}

}  // namespace nova::detail
