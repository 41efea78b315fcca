// Plans the halo (blocks.h): which rows of sums go to which blocks, and which results must reach
// global memory before other blocks continue.
#include <algorithm>
#include <set>
#include <tuple>

#include "cluster/blocks.h"
#include "persistent_memory.h"

namespace novaphy::gpu {
namespace {

constexpr int32_t kRowWords = 4;  // words of a row of the halo
constexpr size_t kRowBytes = 16;
constexpr uint64_t kMostRows = 1 << 16;  // a send addresses rows with 16 bits
constexpr uint32_t kMostBlocks = 32;

class HaloPlanner {
 public:
  HaloPlanner(std::span<const novaphy_persistent_op> ops, uint32_t blocks, const ReadWords& read,
              const BlockPlan& plan)
      : ops_(ops), blocks_(blocks), read_(read), plan_(plan), spans_(phases_of(ops)) {
    for (const novaphy_persistent_op& o : ops) add_written(written_, o);
  }

  std::optional<BlockPlan> run() {
    for (size_t k = 1; k < spans_.size(); ++k)
      if (is_pair(k) && !find_arrays(k)) return std::nullopt;
    if (arrays_.empty() || blocks_ > kMostBlocks) return std::nullopt;
    for (Array& array : arrays_) {
      array.base = plan_.halo.rows;
      plan_.halo.rows += array.rows + 1;
    }
    receivers_.assign(spans_.size(), 0);
    for (size_t k = 0; k < spans_.size(); ++k) {
      plan_.phases[k].turns = plan_.halo.turns;
      if (plan_.phases[k].makes_items && !receive(k)) return std::nullopt;
      if (plan_.phases[k].sums_items && !send(k)) return std::nullopt;
    }
    if (!find_readers() || !make_sends()) return std::nullopt;
    find_fences();
    for (size_t k = 0; k + 1 < spans_.size(); ++k)
      plan_.phases[k].joined = (k == 0 || !plan_.phases[k - 1].joined) && may_join(k);
    return std::move(plan_);
  }

 private:
  struct Array {
    int32_t width;
    uint32_t rows, base = 0;
  };
  // A source or output of an operation, whenever it runs: chain, position in it, kernel, slot.
  using Slot = std::tuple<uint32_t, size_t, const novaphy_kernel*, size_t>;
  struct Written {
    size_t op;
    uint64_t bytes;
  };

  static Slot slot_of(const novaphy_persistent_op& o, size_t place, size_t slot) {
    return {o.chain, place, o.op.kernel, slot};
  }
  // Calls f(operation, its position in its chain).
  template <class F>
  void for_each_op(size_t phase, const F& f) const {
    size_t first = spans_[phase].first;
    for (size_t k = first; k < spans_[phase].last; ++k) {
      if (ops_[k].chain != ops_[first].chain) first = k;
      f(k, k - first);
    }
  }
  // Calls f(source, address of its rows, number of rows) for sources that are read by indices.
  template <class F>
  static void for_each_gathered(const novaphy_persistent_op& o, const F& f) {
    if (o.op.kernel == nullptr || is_builtin(o)) return;
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s) {
      const auto word = p.source_argument(s);
      if (rows_read(p, s) == Rows::Others) f(s, o.op.arguments[word], o.op.arguments[word + 1]);
    }
  }
  bool is_pair(size_t k) const {
    return plan_.phases[k].makes_items && plan_.phases[k - 1].sums_items;
  }
  std::map<uint64_t, Written> written_in(size_t phase) const {
    std::map<uint64_t, Written> written;
    for (size_t k = spans_[phase].first; k < spans_[phase].last; ++k)
      for_each_written(ops_[k], [&](uint64_t begin, uint64_t bytes, size_t) {
        written[begin] = {k, bytes};
      });
    return written;
  }

  // Finds the arrays of the previous sums that elements of a phase read.
  bool find_arrays(size_t k) {
    const std::map<uint64_t, Written> written = written_in(k - 1);
    std::map<uint64_t, size_t> here;
    bool fits = true;
    for_each_op(k, [&](size_t o, size_t place) {
      for_each_gathered(ops_[o], [&](size_t s, uint64_t begin, uint64_t rows) {
        const auto from = written.find(begin);
        if (from == written.end()) return;
        const int32_t width = ops_[o].op.kernel->program.sources[s].width;
        const novaphy_persistent_op& sum = ops_[from->second.op];
        if (width > kRowWords || rows >= kMostRows || sum.n != sum.rows ||
            static_cast<uint64_t>(sum.n) != rows ||
            from->second.bytes != rows * static_cast<uint64_t>(width) * sizeof(int32_t)) {
          fits = false;
          return;
        }
        const Slot source = slot_of(ops_[o], place, s);
        const auto known = sources_.find(source);
        const size_t next = known != sources_.end() ? known->second : arrays_.size();
        const size_t array = here.try_emplace(begin, next).first->second;
        if (array == arrays_.size()) arrays_.push_back({width, static_cast<uint32_t>(rows)});
        fits = fits && sources_.try_emplace(source, array).first->second == array &&
               arrays_[array].width == width && arrays_[array].rows == rows;
      });
    });
    std::set<size_t> different;
    for (const auto& [begin, array] : here) fits = fits && different.insert(array).second;
    for_each_op(k - 1, [&](size_t o, size_t place) {
      for_each_written(ops_[o], [&](uint64_t begin, uint64_t, size_t output) {
        const auto array = here.find(begin);
        if (array == here.end() || written.at(begin).op != o) return;
        const Slot slot = slot_of(ops_[o], place, output);
        fits = fits && outputs_.try_emplace(slot, array->second).first->second == array->second;
      });
    });
    return fits;
  }

  // Finds halo arrays that elements read. Arrays not written by the previous sums come from memory.
  bool receive(size_t k) {
    const std::map<uint64_t, Written> written =
        k > 0 && plan_.phases[k - 1].sends ? written_in(k - 1) : std::map<uint64_t, Written>{};
    std::map<size_t, uint64_t> memory;  // address of each array
    bool fits = true;
    for_each_op(k, [&](size_t o, size_t place) {
      for_each_gathered(ops_[o], [&](size_t s, uint64_t begin, uint64_t rows) {
        const auto source = sources_.find(slot_of(ops_[o], place, s));
        if (source == sources_.end()) return;
        const Array& array = arrays_[source->second];
        const bool fresh = memory.try_emplace(source->second, begin).second;
        fits = fits && memory.at(source->second) == begin && rows == array.rows;
        plan_.operations[o].receives[s] = array.base;
        if (!fresh || written.contains(begin)) return;
        plan_.phases[k].fills.push_back({begin, array.base, array.rows, array.width});
      });
    });
    receivers_[k] = memory.empty() ? 0 : 1;
    return fits;
  }

  bool send(size_t k) {
    std::set<size_t> sent;
    bool once = true;
    for_each_op(k, [&](size_t o, size_t place) {
      for_each_written(ops_[o], [&](uint64_t, uint64_t, size_t output) {
        const auto array = outputs_.find(slot_of(ops_[o], place, output));
        if (array == outputs_.end()) return;
        plan_.operations[o].sends[output] = arrays_[array->second].base;
        once = once && sent.insert(array->second).second;
        senders_.insert({plan_.phases[k].layout, ops_[o].chain});
      });
    });
    if (sent.empty()) return true;
    plan_.phases[k].sends = true;
    ++plan_.halo.turns;
    // All rows are sent in one turn, each time by the same threads. Before sending, a block waits
    // for the rows that other blocks sent.
    return once && sent.size() == arrays_.size() &&
           std::all_of(senders_.begin(), senders_.end(),
                       [&](const auto& s) { return s.first == senders_.begin()->first; }) &&
           (plan_.phases[k].turns == 0 || receivers_[k - 1] != 0);
  }

  // Calls f(block, thread, row) for the rows of a chain.
  template <class F>
  void for_each_row(size_t phase, uint32_t chain, const F& f) const {
    const BlockPlan::Phase& p = plan_.phases[phase];
    const BlockPlan::Chain& warps = p.chains[chain];
    for (uint32_t block = 0; block < blocks_; ++block)
      for (uint32_t k = 0; k < warps.warps * kWarp; ++k) {
        const uint32_t thread = warps.first_warp * kWarp + k;
        const uint32_t word = plan_.layouts[p.layout][size_t{block} * plan_.threads + thread];
        if ((word & BlockPlan::kOn) != 0)
          f(block, thread, word & ~(BlockPlan::kOn | BlockPlan::kOwns));
      }
  }

  // Finds the blocks that read each row. The readers must be the same in each turn, and a change of
  // indices between two runs would stay unnoticed. The indices must therefore be the elements'
  // points, which the tables of the sums also have and which do not change: see persistent_create.
  bool find_readers() {
    using Named = std::vector<std::pair<uint64_t, int32_t>>;  // tables of indices, and columns
    std::set<std::vector<uint64_t>> known;
    for (size_t k = 0; k < spans_.size(); ++k) {
      if (receivers_[k] == 0) continue;
      const bool after_turn = k > 0 && plan_.phases[k - 1].sends;
      std::vector<uint64_t> key = {plan_.phases[k].layout, after_turn ? uint64_t{1} : 0};
      std::vector<std::pair<size_t, Named>> named;
      for (size_t o = spans_[k].first; o < spans_[k].last; ++o) {
        for (const auto& [source, base] : plan_.operations[o].receives) {
          Named by;
          if (!find_indices(ops_[o], source, by)) return false;
          key.push_back(ops_[o].chain);
          for (const auto& [table, column] : by)
            key.insert(key.end(), {table, static_cast<uint64_t>(column)});
          named.push_back({o, std::move(by)});
        }
      }
      for (size_t o = spans_[k + 1].first; o < spans_[k + 1].last; ++o)
        if (plan_.operations[o].sum) key.push_back(ops_[o].op.arguments[csr_sum(ops_[o]).offsets]);
      if (!known.insert(std::move(key)).second) continue;
      const Touching touching = elements_at_points(k);
      std::vector<std::set<uint32_t>> readers(arrays_[0].rows);
      bool inside = true;  // a read of a row that does not exist must be reported
      for (const auto& [o, by] : named)
        for (const auto& [table, column] : by) {
          const int32_t width = table_width_.at(table);
          const std::vector<int32_t>& indices = tables_.at(table);
          for_each_row(k, ops_[o].chain, [&](uint32_t block, uint32_t, uint32_t row) {
            const size_t at =
                size_t{row} * static_cast<size_t>(width) + static_cast<size_t>(column);
            const int32_t index = indices[at];
            if (index < 0) return;
            const auto point = static_cast<uint32_t>(index);
            inside = inside && touching.contains({ops_[o].chain, row, point});
            if (inside) readers[point].insert(block);
          });
        }
      if (!inside) return false;
      if (!after_turn) continue;
      if (readers_.empty()) readers_ = readers;
      if (readers_ != readers) return false;
    }
    return !readers_.empty();
  }
  using Touching = std::set<std::tuple<uint32_t, uint32_t, uint32_t>>;  // chain, element, point
  Touching elements_at_points(size_t makers) {
    const std::map<uint64_t, Written> made = written_in(makers);
    Touching touching;
    for (size_t o = spans_[makers + 1].first; o < spans_[makers + 1].last; ++o) {
      if (!plan_.operations[o].sum) continue;
      const CsrSum sum = csr_sum(ops_[o]);
      const uint64_t* const words = ops_[o].op.arguments;
      const Written& from = made.at(words[sum.source]);
      const novaphy_persistent_op& maker = ops_[from.op];
      const auto corners =
          static_cast<uint32_t>(from.bytes / (static_cast<uint64_t>(maker.n) * sizeof(int32_t)) /
                                static_cast<uint64_t>(sum.width));
      const auto& offsets = words_at(words[sum.offsets], static_cast<size_t>(ops_[o].n) + 1);
      const auto count = static_cast<size_t>(offsets.empty() ? 0 : offsets.back());
      const uint64_t items = words[sum.offsets + 1];
      for (uint32_t point = 0; point + 1 < offsets.size(); ++point)
        for (auto k = static_cast<size_t>(offsets[point]);
             k < static_cast<size_t>(offsets[point + 1]); ++k) {
          const uint32_t item = items == 0 ? static_cast<uint32_t>(k)
                                           : static_cast<uint32_t>(words_at(items, count).at(k));
          touching.insert({maker.chain, item / corners, point});
        }
    }
    return touching;
  }
  const std::vector<int32_t>& words_at(uint64_t begin, size_t words) {
    const auto [known, fresh] = tables_.try_emplace(begin);
    if (fresh) known->second = read_(begin, words);
    return known->second;
  }
  // Finds the index tables that select the rows of a source in a Program. The Program must read
  // them at its own row, and no operation may write them.
  bool find_indices(const novaphy_persistent_op& o, size_t source,
                    std::vector<std::pair<uint64_t, int32_t>>& by) {
    using nova::ir::Op;
    const nova::ir::Program& p = o.op.kernel->program;
    if (o.n != o.rows) return false;
    for (const nova::ir::Instr& in : p.instrs) {
      if ((in.op != Op::LOAD_F && in.op != Op::LOAD_I) || in.a != static_cast<int32_t>(source))
        continue;
      const nova::ir::Instr& index = p.instrs[static_cast<size_t>(in.b)];
      if (index.op != Op::LOAD_I || p.instrs[static_cast<size_t>(index.b)].op != Op::INDEX)
        return false;
      const auto table = static_cast<size_t>(index.a);
      const auto word = p.source_argument(table);
      const uint64_t begin = o.op.arguments[word], rows = o.op.arguments[word + 1];
      const int32_t width = p.sources[table].width;
      const uint64_t words = rows * static_cast<uint64_t>(width);
      if (rows < static_cast<uint64_t>(o.n) || written_.touch(begin, words * sizeof(int32_t)))
        return false;
      if (words_at(begin, words).size() != words ||
          table_width_.try_emplace(begin, width).first->second != width)
        return false;
      by.push_back({begin, index.c});
    }
    return true;
  }

  bool make_sends() {
    BlockPlan::Halo& halo = plan_.halo;
    const uint32_t first = plan_.maker_warps * kWarp, threads = plan_.threads - first;
    const size_t sender =
        static_cast<size_t>(std::find_if(plan_.phases.begin(), plan_.phases.end(),
                                         [](const BlockPlan::Phase& p) { return p.sends; }) -
                            plan_.phases.begin());
    if (plan_.phases[sender].layout != senders_.begin()->first) return false;
    std::map<uint32_t, std::vector<uint32_t>> of_warp;  // sends of each warp
    bool fits = true;
    halo.bytes.assign(blocks_, 0);
    for (const auto& [layout, chain] : senders_) {
      std::vector<int> sent(readers_.size(), 0);
      for_each_row(sender, chain, [&](uint32_t block, uint32_t thread, uint32_t row) {
        fits = fits && thread >= first && row < sent.size();
        if (!fits) return;
        ++sent[row];
        for (const uint32_t to : readers_[row])
          of_warp[(block * threads + thread - first) / kWarp].push_back(
              row | to << BlockPlan::Halo::kBlockShift | BlockPlan::Halo::kSends |
              thread % kWarp << BlockPlan::Halo::kLaneShift);
      });
      fits = fits && std::all_of(sent.begin(), sent.end(), [](int count) { return count == 1; });
    }
    for (const std::set<uint32_t>& blocks : readers_)
      for (const uint32_t block : blocks)
        halo.bytes[block] += static_cast<uint32_t>(arrays_.size() * kRowBytes);
    for (const auto& [warp, sends] : of_warp)
      halo.rounds =
          std::max(halo.rounds, static_cast<uint32_t>((sends.size() + kWarp - 1) / kWarp));
    halo.sends.assign(size_t{blocks_} * halo.rounds * threads, 0);
    for (const auto& [warp, sends] : of_warp)
      for (size_t k = 0; k < sends.size(); ++k) {
        const size_t block = warp / (threads / kWarp), in_block = warp % (threads / kWarp);
        halo.sends[(block * halo.rounds + k / kWarp) * threads + in_block * kWarp + k % kWarp] =
            sends[k];
      }
    return fits && std::all_of(arrays_.begin(), arrays_.end(),
                               [&](const Array& a) { return a.rows == readers_.size(); });
  }

  // Finds the phases whose results no other block reads from global memory.
  void find_fences() {
    struct Left {
      uint64_t bytes;
      int64_t rows;
      size_t phase;
      uint32_t chain;
    };
    std::map<uint64_t, Left> left;
    uint64_t longest = 0;
    for (BlockPlan::Phase& phase : plan_.phases) phase.fences = !phase.sends;
    // Marks earlier phases that wrote this memory as in need of a fence, unless is_safe(access).
    const auto touch = [&](uint64_t begin, uint64_t bytes, const auto& is_safe) {
      for (auto at = left.lower_bound(begin + bytes); at != left.begin();) {
        --at;
        if (at->first + longest <= begin) break;
        if (at->first + at->second.bytes > begin && !is_safe(at->first, at->second))
          plan_.phases[at->second.phase].fences = true;
      }
    };
    for (size_t k = 0; k < spans_.size(); ++k) {
      for (const BlockPlan::Fill& fill : plan_.phases[k].fills)
        touch(fill.from, uint64_t{fill.rows} * static_cast<uint64_t>(fill.width) * sizeof(int32_t),
              [](uint64_t, const Left&) { return false; });
      for (size_t o = spans_[k].first; o < spans_[k].last; ++o) {
        for_each_read(ops_[o], [&](uint64_t begin, uint64_t bytes, int32_t word) {
          if (is_received(o, word)) return;
          const bool own = reads_own(ops_[o], word);
          bool mine = own;
          touch(begin, bytes, [&](uint64_t at, const Left& l) {
            const bool same = own && at == begin && l.bytes == bytes && l.rows == ops_[o].n;
            mine = mine && same && same_threads(l.phase, l.chain, k, ops_[o].chain);
            return same && same_blocks(l.phase, l.chain, k, ops_[o].chain);
          });
          if (mine) plan_.operations[o].mine.insert(word);
        });
      }
      for (size_t o = spans_[k].first; o < spans_[k].last; ++o)
        for_each_written(ops_[o], [&](uint64_t begin, uint64_t bytes, size_t) {
          const Left here{bytes, ops_[o].n, k, ops_[o].chain};
          // Writes of other threads to the same memory must also stay in order.
          touch(begin, bytes, [&](uint64_t at, const Left& l) {
            return at == begin && l.bytes == bytes && l.rows == here.rows &&
                   ops_[o].n == ops_[o].rows && same_blocks(l.phase, l.chain, k, here.chain);
          });
          left.insert_or_assign(begin, here);
          longest = std::max(longest, bytes);
        });
    }
  }
  bool is_received(size_t o, int32_t word) const {
    const int32_t source = source_at(ops_[o], word);
    return source >= 0 && plan_.operations[o].receives.contains(static_cast<size_t>(source));
  }
  // Returns whether blocks may sum their items while other blocks still make items. The sums must
  // not access an array that elements read or write. (Sums begin when the elements of their block
  // are done, and these elements have waited for the previous phase.)
  bool may_join(size_t k) const {
    if (!plan_.phases[k].makes_items || !plan_.phases[k + 1].sums_items) return false;
    for (const BlockPlan::Chain& chain : plan_.phases[k].chains)
      if (chain.first_warp >= plan_.maker_warps) return false;
    Pieces read, made;
    for (size_t o = spans_[k].first; o < spans_[k].last; ++o) {
      for_each_read(ops_[o], [&](uint64_t begin, uint64_t bytes, int32_t word) {
        if (!is_received(o, word)) read.add(begin, bytes);
      });
      add_written(made, ops_[o]);
    }
    bool fits = true;
    for (size_t o = spans_[k + 1].first; o < spans_[k + 1].last; ++o) {
      const int32_t items = plan_.operations[o].sum ? csr_sum(ops_[o]).source : -1;
      for_each_read(ops_[o], [&](uint64_t begin, uint64_t bytes, int32_t word) {
        fits = fits && ((items >= 0 && word == items) || !made.touch(begin, bytes));
      });
      for_each_written(ops_[o], [&](uint64_t begin, uint64_t bytes, size_t) {
        fits = fits && !read.touch(begin, bytes) && !made.touch(begin, bytes);
      });
    }
    return fits;
  }
  // Returns the source of a Program to which an argument word belongs; -1: none.
  static int32_t source_at(const novaphy_persistent_op& o, int32_t word) {
    if (o.op.kernel == nullptr || is_builtin(o)) return -1;
    const nova::ir::Program& p = o.op.kernel->program;
    for (size_t s = 0; s < p.sources.size(); ++s)
      if (static_cast<int32_t>(p.source_argument(s)) == word) return static_cast<int32_t>(s);
    return -1;
  }
  // Returns whether an operation reads a source only at its own row, and has one row per chain row.
  static bool reads_own(const novaphy_persistent_op& o, int32_t word) {
    if (o.n != o.rows || o.op.kernel == nullptr) return false;
    if (is_builtin(o)) return word == CsrSum{}.init;
    const int32_t source = source_at(o, word);
    return source >= 0 && rows_read(o.op.kernel->program, static_cast<size_t>(source)) == Rows::Own;
  }
  bool same_blocks(size_t a, uint32_t a_chain, size_t b, uint32_t b_chain) {
    const auto [known, fresh] =
        same_.try_emplace({plan_.phases[a].layout, a_chain, plan_.phases[b].layout, b_chain}, true);
    if (!fresh) return known->second;
    std::map<uint32_t, uint32_t> block_of;
    for_each_row(a, a_chain,
                 [&](uint32_t block, uint32_t, uint32_t row) { block_of[row] = block; });
    for_each_row(b, b_chain, [&](uint32_t block, uint32_t, uint32_t row) {
      const auto writer = block_of.find(row);
      known->second = known->second && writer != block_of.end() && writer->second == block;
    });
    return known->second;
  }

  bool same_threads(size_t a, uint32_t a_chain, size_t b, uint32_t b_chain) const {
    const BlockPlan::Phase &p = plan_.phases[a], &q = plan_.phases[b];
    return p.layout == q.layout && p.sums_items && q.sums_items &&
           p.chains[a_chain].first_warp == q.chains[b_chain].first_warp;
  }

  const std::span<const novaphy_persistent_op> ops_;
  const uint32_t blocks_;
  const ReadWords& read_;
  BlockPlan plan_;
  const std::vector<PhaseSpan> spans_;
  Pieces written_;
  std::vector<Array> arrays_;
  std::map<Slot, size_t> sources_, outputs_;         // indices into arrays_
  std::vector<char> receivers_;                      // one per phase
  std::set<std::pair<uint32_t, uint32_t>> senders_;  // pairs of layout and chain
  std::map<uint64_t, std::vector<int32_t>> tables_;
  std::map<uint64_t, int32_t> table_width_;
  std::vector<std::set<uint32_t>> readers_;  // reading blocks of each row
  std::map<std::tuple<uint32_t, uint32_t, uint32_t, uint32_t>, bool> same_;
};

}  // namespace

bool plan_halo(std::span<const novaphy_persistent_op> ops, uint32_t blocks, const ReadWords& read,
               BlockPlan& plan) {
  std::optional<BlockPlan> made = HaloPlanner(ops, blocks, read, plan).run();
  if (made) plan = std::move(*made);
  return made.has_value();
}

}  // namespace novaphy::gpu
