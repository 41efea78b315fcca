// The operations of a persistent kernel: their phases, and the memory that they read and write.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "module.h"
#include "row_use.h"

namespace novaphy::gpu {

// Returns the operations of the phase that begins with operation `first`.
inline std::span<const novaphy_persistent_op> phase_at(std::span<const novaphy_persistent_op> ops,
                                                       size_t first) {
  size_t last = first;
  while (last < ops.size() && ops[last].phase == ops[first].phase) ++last;
  return ops.subspan(first, last - first);
}

// A phase as a range of operation indices.
struct PhaseSpan {
  size_t first, last;
};
inline std::vector<PhaseSpan> phases_of(std::span<const novaphy_persistent_op> ops) {
  std::vector<PhaseSpan> phases;
  for (size_t first = 0; first < ops.size(); first = phases.back().last)
    phases.push_back({first, first + phase_at(ops, first).size()});
  return phases;
}

// A set of memory ranges.
class Pieces {
 public:
  void add(uint64_t begin, uint64_t bytes) {
    uint64_t& end = ends_[begin];
    end = std::max(end, begin + bytes);
    longest_ = std::max(longest_, bytes);
  }
  bool touch(uint64_t begin, uint64_t bytes) const {
    for (auto at = ends_.lower_bound(begin + bytes); at != ends_.begin();) {
      --at;
      if (at->second > begin) return true;
      if (at->first + longest_ <= begin) break;
    }
    return false;
  }

 private:
  std::map<uint64_t, uint64_t> ends_;
  uint64_t longest_ = 0;
};

inline uint64_t address(const void* p) { return reinterpret_cast<uint64_t>(p); }
// Returns whether a launch runs a builtin. Operations without a kernel are copies and fills.
inline bool is_builtin(const novaphy_persistent_op& o) {
  return o.op.kernel->program.instrs.empty();
}

// A sum of rows of CSR items: the builtin, or a Program that adds such rows to its own row. The own
// row must exist. The members are indices of argument words. The word of the items follows that of
// the offsets.
struct CsrSum {
  int32_t source = -1;  // -1: the operation is not such a sum
  int32_t offsets = 1, init = 3, out = 4;
  int32_t width = 1;
  bool has_init = false;
  bool is_there() const { return source >= 0; }
};
inline CsrSum csr_sum(const novaphy_persistent_op& o) {
  if (o.op.kernel == nullptr) return {};
  if (is_builtin(o)) {
    CsrSum sum;
    if (o.op.arguments[sum.offsets] == 0) return {};
    sum.source = 0;
    sum.width = static_cast<int32_t>(o.op.arguments[5]);
    sum.has_init = o.op.arguments[sum.init] != 0;
    return sum;
  }
  const nova::ir::Program& p = o.op.kernel->program;
  const auto [init, source] = nova::ir::added_rows(p);
  if (source < 0) return {};
  const auto word = [&](int32_t s) { return p.source_argument(static_cast<size_t>(s)); };
  if (!is_there(p, static_cast<size_t>(init), o.op.arguments[word(init) + 1],
                static_cast<uint64_t>(o.n)))
    return {};
  return {static_cast<int32_t>(word(source)),
          static_cast<int32_t>(p.loop_argument(0)),
          static_cast<int32_t>(word(init)),
          static_cast<int32_t>(p.output_argument(0)),
          p.sources[static_cast<size_t>(source)].width,
          true};
}

// Calls f(address of the offsets) for each CSR table of an operation.
template <class F>
void for_each_table(const novaphy_persistent_op& o, const F& f) {
  if (o.op.kernel == nullptr) return;
  if (is_builtin(o)) {
    if (o.op.arguments[1] != 0) f(o.op.arguments[1]);
    return;
  }
  const nova::ir::Program& p = o.op.kernel->program;
  for (size_t l = 0; l < p.loops.size(); ++l)
    if (p.loops[l].kind == nova::ir::LoopKind::Csr) f(o.op.arguments[p.loop_argument(l)]);
}

// Calls f(begin, bytes, output) for each range of memory that an operation writes.
template <class F>
void for_each_written(const novaphy_persistent_op& o, const F& f) {
  const auto rows = static_cast<uint64_t>(o.n) * sizeof(int32_t);
  if (o.op.kernel == nullptr) {
    f(address(o.op.target), rows, size_t{0});
  } else if (is_builtin(o)) {
    f(o.op.arguments[4], rows * o.op.arguments[5], size_t{0});
  } else {
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t k = 0; k < p.outputs.size(); ++k)
      f(o.op.arguments[p.output_argument(k)], rows * p.outputs[k].values.size(), k);
  }
}
inline void add_written(Pieces& written, const novaphy_persistent_op& o) {
  for_each_written(o, [&](uint64_t begin, uint64_t bytes, size_t) { written.add(begin, bytes); });
}
// Calls f(begin, bytes, argument word) for each range of memory that an operation reads.
template <class F>
void for_each_read(const novaphy_persistent_op& o, const F& f) {
  const auto rows = static_cast<uint64_t>(o.n) * sizeof(int32_t);
  if (o.op.kernel == nullptr) {
    if (o.op.source != nullptr) f(address(o.op.source), rows, -1);
  } else if (is_builtin(o)) {
    f(o.op.arguments[0], o.source_bytes, 0);
    if (o.op.arguments[3] != 0) f(o.op.arguments[3], rows * o.op.arguments[5], 3);
  } else {
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const auto word = static_cast<int32_t>(p.source_argument(s));
      f(o.op.arguments[word],
        o.op.arguments[word + 1] * static_cast<uint64_t>(p.sources[s].width) * sizeof(int32_t),
        word);
    }
  }
}

}  // namespace novaphy::gpu
