#include "fusion.h"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <map>
#include <mutex>

#include "novaphy/core/parallel.h"

namespace nova::detail {

RowLayout row_layout(const ir::Program& p) {
  RowLayout layout;
  layout.row_local = true;
  enum : char { kUnread, kDirect, kShared };
  std::vector<char> how(p.sources.size(), kUnread);
  for (const ir::Instr& in : p.instrs) {
    const bool load = in.op == ir::Op::LOAD_F || in.op == ir::Op::LOAD_I;
    if (load) {
      const char now = p.instrs[in.b].op == ir::Op::INDEX ? kDirect : kShared;
      if (how[in.a] != kUnread && how[in.a] != now) layout.row_local = false;
      how[in.a] = now;
    } else {
      ir::for_each_operand(in, [&](ir::Value v) {
        if (p.instrs[v].op == ir::Op::INDEX) layout.row_local = false;
      });
    }
  }
  for (size_t s = 0; s < p.sources.size(); ++s) {
    const auto bytes = static_cast<uint32_t>(p.sources[s].width) * 4;
    if (how[s] == kDirect) layout.inputs.push_back({p.source_argument(s), bytes});
    if (how[s] == kShared) layout.shared.push_back({p.source_argument(s), bytes});
  }
  for (size_t o = 0; o < p.outputs.size(); ++o)
    layout.outputs.push_back(
        {p.output_argument(o), static_cast<uint32_t>(p.outputs[o].values.size()) * 4});
  for (size_t l = 0; l < p.loops.size(); ++l)
    if (p.loops[l].kind == ir::LoopKind::Csr) layout.tables.push_back({p.loop_argument(l), 4});
  if (p.argument_count() > kMaxFusedWords) layout.row_local = false;
  return layout;
}

namespace {

// The memory that the operations of a growing segment touch: disjoint intervals by their start.
class Footprint {
 public:
  // False when the access may see another row's data. `row_bytes` 0: all rows may be read.
  bool add(uint64_t begin, uint64_t bytes, uint32_t row_bytes, bool write) {
    if (bytes == 0) return true;
    const uint64_t end = begin + bytes;
    auto at = intervals_.upper_bound(begin);
    if (at != intervals_.begin() && std::prev(at)->second.end > begin) --at;
    if (at == intervals_.end() || at->first >= end) {
      intervals_.emplace_hint(at, begin, Interval{end, row_bytes, write});
      return true;
    }
    // The intervals stay disjoint: another view of the same bytes ends the segment.
    Interval& known = at->second;
    if (at->first != begin || known.end != end) return false;
    if ((write || known.written) && (row_bytes == 0 || known.row_bytes != row_bytes)) return false;
    if (known.row_bytes != row_bytes) known.row_bytes = 0;
    known.written = known.written || write;
    return true;
  }
  void clear() { intervals_.clear(); }

 private:
  struct Interval {
    uint64_t end;
    uint32_t row_bytes;
    bool written;
  };
  std::map<uint64_t, Interval> intervals_;
};

uint64_t address(const void* p) { return reinterpret_cast<uint64_t>(p); }

// Adds the operation; false when it cannot run block by block with what is in the footprint.
bool add_op(Footprint& footprint, const OpList::Op& op, std::span<const uint64_t> words,
            int64_t n) {
  const auto rows = static_cast<uint64_t>(n);
  if (op.kind != OpList::Op::Kind::Launch) {
    const auto bytes = static_cast<uint64_t>(op.n);
    if (bytes % (4 * rows) != 0) return false;
    const auto row_bytes = static_cast<uint32_t>(bytes / rows);
    if (op.source && !footprint.add(address(op.source), bytes, row_bytes, false)) return false;
    return footprint.add(address(op.target), bytes, row_bytes, true);
  }
  if (!op.layout || !op.layout->row_local || op.n != n) return false;
  const uint64_t* arguments = words.data() + op.first_word;
  for (const RowLayout::Word& w : op.layout->inputs)
    if (!footprint.add(arguments[w.word], rows * w.row_bytes, w.row_bytes, false)) return false;
  for (const RowLayout::Word& w : op.layout->shared)
    if (!footprint.add(arguments[w.word], arguments[w.word + 1] * w.row_bytes, 0, false))
      return false;
  for (const RowLayout::Word& w : op.layout->outputs)
    if (!footprint.add(arguments[w.word], rows * w.row_bytes, w.row_bytes, true)) return false;
  return true;
}

}  // namespace

std::vector<Segment> find_segments(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                   int64_t min_rows) {
  std::vector<Segment> segments;
  Footprint footprint;
  // The rows of the stretch that starts at k: those of its first launch.
  auto rows_from = [&](size_t k) -> int64_t {
    for (; k < ops.size(); ++k)
      if (ops[k].kind == OpList::Op::Kind::Launch) return ops[k].n;
    return 0;
  };
  size_t k = 0;
  while (k < ops.size()) {
    Segment segment{static_cast<uint32_t>(k), static_cast<uint32_t>(k), 0};
    const int64_t n = rows_from(k);
    if (n >= min_rows) {
      footprint.clear();
      while (k < ops.size() && add_op(footprint, ops[k], words, n)) ++k;
      segment.last = static_cast<uint32_t>(k);
      segment.n = n;
    }
    if (segment.last - segment.first < 2) {  // nothing to gain: join the plain stretch before it
      k = segment.first + 1;
      segment.last = static_cast<uint32_t>(k);
      segment.n = 0;
      if (!segments.empty() && segments.back().n == 0) {
        segments.back().last = segment.last;
        continue;
      }
    }
    segments.push_back(segment);
  }
  return segments;
}

namespace {

struct FusedRun {
  const novaphy::DeviceContext& context;
  std::span<const OpList::Op> ops;
  std::span<const uint64_t> words;
  int64_t n;
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
  const int64_t begin = block * kBlockRows, rows = std::min(kBlockRows, run.n - begin);
  const auto skip = static_cast<uint64_t>(begin);
  const novaphy_backend_api& api = *run.context.api;
  novaphy_error error = novaphy::make_error();
  uint64_t arguments[kMaxFusedWords];
  for (const OpList::Op& op : run.ops) {
    novaphy_status status = NOVAPHY_OK;
    if (op.kind == OpList::Op::Kind::Launch) {
      std::memcpy(arguments, run.words.data() + op.first_word, op.word_count * sizeof(uint64_t));
      for (const auto* list : {&op.layout->inputs, &op.layout->outputs, &op.layout->tables})
        for (const RowLayout::Word& w : *list) arguments[w.word] += skip * w.row_bytes;
      status = api.launch(run.context.stream, op.kernel, rows, arguments, op.word_count, &error);
    } else {
      const uint64_t row_bytes = static_cast<uint64_t>(op.n / run.n);
      auto* target = static_cast<char*>(op.target) + skip * row_bytes;
      const uint64_t bytes = static_cast<uint64_t>(rows) * row_bytes;
      status = op.kind == OpList::Op::Kind::Copy
                   ? api.memory_copy(run.context.stream, NOVAPHY_COPY_DEVICE_TO_DEVICE, target,
                                     static_cast<const char*>(op.source) + skip * row_bytes, bytes,
                                     &error)
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
  const int64_t blocks = (segment.n + kBlockRows - 1) / kBlockRows;
  constexpr int64_t kBlocksPerRound = 256;  // between two looks at an interrupt
  for (int64_t first = 0; first < blocks; first += kBlocksPerRound) {
    novaphy::check_interrupt();
    FusedRun run{.context = context,
                 .ops = ops.subspan(segment.first, segment.last - segment.first),
                 .words = words,
                 .n = segment.n,
                 .first_block = first};
    novaphy::parallel_for(
        std::min(kBlocksPerRound, blocks - first),
        [](void* self, int64_t chunk) {
          FusedRun& r = *static_cast<FusedRun*>(self);
          run_block(r, r.first_block + chunk);
        },
        &run);
    if (run.failed) novaphy::check(run.status, run.error, run.failed_name);
  }
}

}  // namespace nova::detail
