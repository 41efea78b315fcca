// Decides which recorded operations run block by block, and in which order.
#include <algorithm>
#include <map>

#include "fusion.h"
#include "intervals.h"

namespace nova::detail {

RowLayout row_layout(const ir::Program& p) {
  RowLayout layout;
  layout.row_local = true;
  layout.operations = static_cast<uint32_t>(p.instrs.size());
  enum : char { kUnread, kDirect, kShared };
  std::vector<char> how(p.sources.size(), kUnread);
  for (const ir::Instr& in : p.instrs) {
    const bool load = in.op == ir::Op::LOAD_F || in.op == ir::Op::LOAD_I;
    if (load) {
      const char now = p.instrs[in.b].op == ir::Op::INDEX ? kDirect : kShared;
      const bool both = how[in.a] != kUnread && how[in.a] != now;
      if (both) layout.row_local = false;
      how[in.a] = both ? static_cast<char>(kShared) : now;
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
    if (p.sources[s].type == ir::Type::I32) layout.indices.push_back({p.source_argument(s), bytes});
  }
  for (size_t o = 0; o < p.outputs.size(); ++o)
    layout.outputs.push_back(
        {p.output_argument(o), static_cast<uint32_t>(p.outputs[o].values.size()) * 4});
  for (size_t l = 0; l < p.loops.size(); ++l)
    if (p.loops[l].kind == ir::LoopKind::Csr) layout.tables.push_back({p.loop_argument(l), 4});
  if (p.argument_count() > kMaxFusedWords) layout.row_local = false;
  return layout;
}

bool is_table(const OpList::Op& op, std::span<const uint64_t> words, uint64_t address) {
  if (op.layout == nullptr) return false;
  const uint64_t* arguments = words.data() + op.first_word;
  return std::any_of(op.layout->tables.begin(), op.layout->tables.end(), [&](const auto& table) {
    return arguments[table.word] == address || arguments[table.word + 1] == address;
  });
}

bool touched_by(const OpList::Op& op, std::span<const uint64_t> words,
                std::span<const MemoryAccess> accesses, std::vector<MemoryAccess>& touched) {
  const auto address = [](const void* p) { return reinterpret_cast<uint64_t>(p); };
  const auto rows = static_cast<uint64_t>(op.n);
  if (op.kind != OpList::Op::Kind::Launch) {
    if (op.source) touched.push_back({address(op.source), rows, 4, false});
    touched.push_back({address(op.target), rows, 4, true});
    return true;
  }
  const auto known = accesses.subspan(op.first_access, op.access_count);
  touched.insert(touched.end(), known.begin(), known.end());
  if (!op.layout || op.layout->of_builtin) return !known.empty();
  const uint64_t* arguments = words.data() + op.first_word;
  // an input may have fewer rows; no lane reads beyond
  for (const RowLayout::Word& w : op.layout->inputs)
    touched.push_back({arguments[w.word], std::min(rows, arguments[w.word + 1]) * w.row_bytes,
                       w.row_bytes, false});
  for (const RowLayout::Word& w : op.layout->shared)
    touched.push_back({arguments[w.word], arguments[w.word + 1] * w.row_bytes, 0, false});
  for (const RowLayout::Word& w : op.layout->outputs)
    touched.push_back({arguments[w.word], rows * w.row_bytes, w.row_bytes, true});
  return true;
}

namespace {

// A scan (launches of one kernel as one call) over few rows is distributed over threads in blocks
// of kFewRows if all its launches together have kSharedOut rows.
constexpr int64_t kSharedOut = 32768, kFewRows = 128;
// Largest number of launches in a scan, after which the caller checks for an interrupt.
constexpr size_t kMostLaunches = 65536;

// The memory that some operations access, as disjoint intervals keyed by their start.
class Footprint {
  struct Interval {
    uint64_t end;
    uint32_t row_bytes;  // 0: any row may be read
    bool written;
  };
  using Intervals = std::map<uint64_t, Interval>;

 public:
  // Returns whether an access would change a result if it ran before the added accesses instead of
  // after them.
  bool conflicts(const MemoryAccess& access) const {
    if (access.bytes == 0) return false;
    for (auto at = first_from(intervals_, access.begin); at != intervals_.end(); ++at) {
      if (at->first >= access.begin + access.bytes) return false;
      if (access.write || at->second.written) return true;
    }
    return false;
  }
  bool conflicts(std::span<const MemoryAccess> accesses) const {
    return std::any_of(accesses.begin(), accesses.end(),
                       [this](const MemoryAccess& a) { return conflicts(a); });
  }

  // Adds the accesses of an operation to run block by block with the operations so far. Returns
  // false, without a change, if the operation may access data of another row.
  bool add_fused(std::span<const MemoryAccess> accesses) {
    undo_.clear();
    for (const MemoryAccess& access : accesses) {
      if (add_fused(access)) continue;
      for (auto at = undo_.rbegin(); at != undo_.rend(); ++at) {
        if (at->second.end == 0) {
          intervals_.erase(at->first);
        } else {
          intervals_[at->first] = at->second;
        }
      }
      return false;
    }
    return true;
  }
  // Adds the accesses of an operation that runs separately.
  void add(std::span<const MemoryAccess> accesses) {
    for (const MemoryAccess& access : accesses) {
      if (access.bytes == 0) continue;
      uint64_t begin = access.begin, end = access.begin + access.bytes;
      bool written = access.write;
      auto at = first_from(intervals_, begin);
      while (at != intervals_.end() && at->first < end) {  // merges overlapping intervals
        begin = std::min(begin, at->first);
        end = std::max(end, at->second.end);
        written = written || at->second.written;
        at = intervals_.erase(at);
      }
      intervals_[begin] = {end, 0, written};
    }
  }
  void clear() { intervals_.clear(); }
  // Returns the bytes per row of all memory that operations access at their own row.
  uint64_t bytes_per_row() const {
    uint64_t bytes = 0;
    for (const auto& [begin, interval] : intervals_) bytes += interval.row_bytes;
    return bytes;
  }

 private:
  bool add_fused(const MemoryAccess& access) {
    if (access.bytes == 0) return true;
    const uint64_t end = access.begin + access.bytes;
    const auto at = first_from(intervals_, access.begin);
    if (at == intervals_.end() || at->first >= end) {
      intervals_[access.begin] = {end, access.row_bytes, access.write};
      undo_.push_back({access.begin, Interval{}});
      return true;
    }
    // Intervals stay disjoint. An access through another view of the same bytes is not fused.
    Interval& known = at->second;
    if (at->first != access.begin || known.end != end) return false;
    if ((access.write || known.written) &&
        (access.row_bytes == 0 || known.row_bytes != access.row_bytes))
      return false;
    undo_.push_back({at->first, known});
    if (known.row_bytes != access.row_bytes) known.row_bytes = 0;
    known.written = known.written || access.write;
    return true;
  }

  Intervals intervals_;
  std::vector<std::pair<uint64_t, Interval>> undo_;
};

class Planner {
 public:
  Planner(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
          std::span<const MemoryAccess> accesses, const PlanLimits& limits)
      : ops_(ops), words_(words), accesses_(accesses), limits_(limits) {
    order_.resize(ops.size());
    for (uint32_t k = 0; k < ops.size(); ++k) order_[k] = k;
  }

  RunPlan plan() {
    RunPlan made;
    for (size_t k = 0; k < order_.size();) {
      const int64_t n = rows_from(k);
      if (n >= std::max<int64_t>(1, limits_.min_rows) && grow(k, n)) {
        const size_t first = k + before_.size(), last = first + fused_.size();
        append_plain(made.segments, k, first);
        made.segments.push_back(
            {static_cast<uint32_t>(first), static_cast<uint32_t>(last), n, block_rows(n)});
        k = last;
      } else if (const size_t last = end_of_scan(k); last > k) {
        const int64_t rows = op(k).n, launches = static_cast<int64_t>(last - k);
        made.segments.push_back({static_cast<uint32_t>(k), static_cast<uint32_t>(last), rows,
                                 rows * launches < kSharedOut ? rows : kFewRows});
        k = last;
      } else {
        append_plain(made.segments, k, k + 1);
        ++k;
      }
    }
    for (const uint32_t k : order_) made.ops.push_back(ops_[k]);
    return made;
  }

 private:
  static void append_plain(std::vector<Segment>& segments, size_t first, size_t last) {
    if (first == last) return;
    if (!segments.empty() && segments.back().n == 0) {
      segments.back().last = static_cast<uint32_t>(last);
    } else {
      segments.push_back({static_cast<uint32_t>(first), static_cast<uint32_t>(last)});
    }
  }

  const OpList::Op& op(size_t k) const { return ops_[order_[k]]; }

  // Returns the number of rows of a segment that starts at operation k. The number is that of the
  // first launch, or of a launch soon after if this has fewer rows per element.
  int64_t rows_from(size_t k) const {
    constexpr size_t kLookAhead = 32;
    int64_t n = 0;
    for (size_t end = std::min(order_.size(), k + kLookAhead); k < end; ++k) {
      if (op(k).kind != OpList::Op::Kind::Launch) continue;
      if (n == 0) n = op(k).n;
      if (n < limits_.min_rows || !limits_.multiples) break;
      if (op(k).n >= limits_.min_rows && n % op(k).n == 0) n = op(k).n;
    }
    return n;
  }

  // Finds the accesses of an operation. Returns false if they are unknown. Sets `own_row` to
  // whether, with n rows, row i accesses all written memory only at row i.
  bool look_at(const OpList::Op& o, int64_t n, bool& own_row) {
    touched_.clear();
    const bool launch = o.kind == OpList::Op::Kind::Launch;
    const int64_t rows = rows_of(o);
    own_row = launch ? !o.active && o.layout && !o.layout->of_builtin && o.layout->row_local &&
                           (limits_.multiples ? rows % n == 0 : rows == n)
                     : rows % n == 0 && o.n % 4 == 0;
    if (!touched_by(o, words_, accesses_, touched_)) return false;
    const auto factor = own_row ? static_cast<uint32_t>(rows / n) : 0;
    for (MemoryAccess& access : touched_) access.row_bytes *= factor;
    return true;
  }

  // Orders the operations from k on: those before a segment, the segment, and those after it.
  // Returns false, without a change, if no segment of at least two operations starts at k.
  bool grow(size_t k, int64_t n) {
    constexpr size_t kMaxApart = 16;
    segment_.clear();
    late_.clear();
    before_.clear();
    fused_.clear();
    after_.clear();
    size_t end = k;
    for (; end < order_.size(); ++end) {
      bool own_row = false;
      if (!look_at(op(end), n, own_row)) break;
      if (!late_.conflicts(touched_)) {
        if (own_row && segment_.add_fused(touched_)) {
          fused_.push_back(order_[end]);
          continue;
        }
        if (before_.size() < kMaxApart && !segment_.conflicts(touched_)) {
          before_.push_back(order_[end]);
          continue;
        }
      }
      if (after_.size() == kMaxApart) break;
      late_.add(touched_);
      after_.push_back(order_[end]);
    }
    if (fused_.size() < 2) return false;
    auto to = order_.begin() + static_cast<ptrdiff_t>(k);
    for (const auto* part : {&before_, &fused_, &after_})
      to = std::copy(part->begin(), part->end(), to);
    return true;
  }

  // Returns the end of a scan that begins at k, or k if none begins there. All launches of a scan
  // run the same kernel and access written memory at their own row only.
  size_t end_of_scan(size_t k) {
    if (limits_.min_scan == 0 || op(k).n == 0) return k;
    segment_.clear();
    size_t end = k;
    for (; end < order_.size() && end - k < kMostLaunches; ++end) {
      const OpList::Op& next = op(end);
      bool own_row = false;
      if (next.kind != OpList::Op::Kind::Launch || next.kernel != op(k).kernel ||
          next.n != op(k).n || !look_at(next, next.n, own_row) || !own_row ||
          !segment_.add_fused(touched_))
        break;
    }
    return end - k >= limits_.min_scan ? end : k;
  }

  // Chooses the rows of a block. The data of a block should stay in a core's cache over all
  // operations, and the threads should get similar shares. A block must not be so small that
  // launches cost more than memory.
  int64_t block_rows(int64_t n) const {
    constexpr uint64_t kCacheBytes = 768 << 10;
    constexpr int64_t kStep = 128, kMost = 1024, kBlocks = 8;
    const uint64_t bytes = std::max<uint64_t>(1, segment_.bytes_per_row());
    const auto fit = static_cast<int64_t>(kCacheBytes / bytes) / kStep * kStep;
    const int64_t share = (n / kBlocks + kStep - 1) / kStep * kStep;
    return std::clamp(std::min(fit, share), kStep, kMost);
  }

  std::span<const OpList::Op> ops_;
  std::span<const uint64_t> words_;
  std::span<const MemoryAccess> accesses_;
  const PlanLimits limits_;
  std::vector<uint32_t> order_;
  Footprint segment_, late_;
  std::vector<uint32_t> before_, fused_, after_;
  std::vector<MemoryAccess> touched_;  // accesses of the operation under inspection
};

}  // namespace

void mark_changing_tables(std::span<OpList::Op> ops, std::span<const uint64_t> words,
                          std::span<const MemoryAccess> accesses) {
  Footprint written;
  bool all_known = true;
  std::vector<MemoryAccess> touched;
  for (const OpList::Op& op : ops) {
    touched.clear();
    all_known = touched_by(op, words, accesses, touched) && all_known;
    std::erase_if(touched, [](const MemoryAccess& a) { return !a.write; });
    written.add(touched);
  }
  for (OpList::Op& op : ops) {
    if (op.layout == nullptr) continue;
    touched.clear();
    for (const MemoryAccess& access : accesses.subspan(op.first_access, op.access_count))
      if (is_table(op, words, access.begin)) touched.push_back(access);
    const uint64_t* arguments = words.data() + op.first_word;
    for (const RowLayout::Word& w : op.layout->indices)
      touched.push_back({arguments[w.word], arguments[w.word + 1] * w.row_bytes});
    op.tables_change = !touched.empty() && (!all_known || written.conflicts(touched));
  }
}

RunPlan plan_run(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses, const PlanLimits& limits) {
  return Planner(ops, words, accesses, limits).plan();
}

}  // namespace nova::detail
