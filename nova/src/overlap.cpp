#include "overlap.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "intervals.h"

namespace nova::detail {

namespace {

// All parts together may compute so many times the elements. Three times was still faster than to
// meet, with sixteen threads.
constexpr int64_t kMostTimes = 4;
constexpr uint64_t kApart = 128;  // bytes: processors fetch lines by two

// Sums that join their elements are shared out evenly, not by whole groups: a few rows more are
// many elements more. A part has a group at least, for less would be slow.
int64_t whole_sums(int64_t rows, uint32_t parts) {
  return rows < kGroupRows * parts ? kGroupRows : 1;
}

}  // namespace

class Overlap::Planner {
 public:
  Planner(Overlap& plan, std::span<const OpList::Op> ops, std::span<const uint64_t> words,
          std::span<const MemoryAccess> accesses, std::span<Chain> chains)
      : plan_(plan), ops_(ops), words_(words), accesses_(accesses), chains_(chains) {}

  void run() {
    for (uint32_t c = 0; c < chains_.size(); ++c)
      chain_of_.insert(chain_of_.end(), chains_[c].last - chains_[c].first, c);
    for (uint32_t k = 0; k < ops_.size(); ++k) see(k);
    for (const auto& [begin, memory] : memory_)
      if (!memory.mixed) find_values(begin, memory);
    for (const auto& [op, values] : gathered_) give_parts(op, values);
    if (elements_.empty()) return;
    for (const auto& [end, values] : others_) give_second_place(end, values);
    do {
      join();
    } while (withdraw());
    if (group_.back() == chains_.back().phase) {
      plan_.memory_.clear();
    } else {
      commit();
    }
  }

 private:
  // How an operation touches memory. What goes through an argument word can go elsewhere.
  struct Use {
    uint32_t op;
    bool write;
    bool fixed = true;
    uint32_t word = 0, row_bytes = 0;
    const RowLayout::Gathered* gathered = nullptr;
  };
  struct Memory {
    uint64_t end = 0;
    bool mixed = false;          // there are several views of its bytes
    std::vector<Use> uses = {};  // in the order of phases
  };
  // What was written there before something else was: the uses from its first write on.
  struct Value {
    uint64_t begin;
    std::span<const Use> uses;
  };
  // Elements whose values only sums gather, so that each part may have its own.
  struct Elements {
    uint32_t op, rows;
    std::vector<uint32_t> sums;
    bool active = true;
  };
  // An argument word that goes elsewhere: to memory of parts while these elements are active, or
  // (kSecondPlace) to the second place of a memory.
  struct Move {
    uint64_t begin;
    uint32_t word, memory, elements;
  };
  static constexpr uint32_t kSecondPlace = UINT32_MAX;
  // Which rows of the elements a sum needs: offsets, items, rows of the sum, bytes of an item and
  // of a row of the elements.
  using Needed = std::tuple<uint64_t, uint64_t, int64_t, uint32_t, uint32_t>;

  const uint64_t* arguments(uint32_t op) const { return words_.data() + ops_[op].first_word; }

  // Through which words the operation touches the memory that begins there; none: it needs it
  // there.
  std::vector<Use> uses_at(uint32_t op, uint64_t begin) const {
    const RowLayout* layout = ops_[op].layout;
    const Chain& chain = chains_[chain_of_[op]];
    std::vector<Use> uses;
    if (layout == nullptr || !layout->row_local || chain.parts != plan_.parts_ ||
        ops_[op].n != chain.rows)
      return uses;
    const auto at = [&](uint32_t word) { return arguments(op)[word] == begin; };
    for (const RowLayout::Word& w : layout->outputs)
      if (at(w.word)) uses.push_back({op, true, false, w.word, w.row_bytes});
    for (const RowLayout::Gathered& g : layout->gathered)
      if (at(g.source)) uses.push_back({op, false, false, g.source, g.row_bytes, &g});
    for (const auto* list : {&layout->inputs, &layout->shared})
      for (const RowLayout::Word& w : *list)
        if (at(w.word) && (uses.empty() || uses.back().word != w.word))
          uses.push_back({op, false, false, w.word, w.row_bytes});
    return uses;
  }

  void see(uint32_t op) {
    touched_.emplace_back();
    touched_by(ops_[op], words_, accesses_, touched_.back());
    for (const MemoryAccess& access : touched_.back()) {
      if (access.bytes == 0) continue;
      Memory& memory = memory_of(access);
      const std::vector<Use> uses = uses_at(op, access.begin);
      if (uses.empty()) {
        memory.uses.push_back({op, access.write});
      } else if (memory.uses.empty() || memory.uses.back().op != op) {
        memory.uses.insert(memory.uses.end(), uses.begin(), uses.end());
      }
    }
  }
  Memory& memory_of(const MemoryAccess& access) {
    const uint64_t end = access.begin + access.bytes;
    auto at = first_from(memory_, access.begin);
    if (at == memory_.end() || at->first >= end) return memory_[access.begin] = {end};
    if (at->first == access.begin && at->second.end == end) return at->second;
    Memory all{end, true};  // another view of the same bytes
    const uint64_t begin = std::min(access.begin, at->first);
    for (; at != memory_.end() && at->first < end; at = memory_.erase(at))
      all.end = std::max(all.end, at->second.end);
    return memory_[begin] = std::move(all);
  }

  // The values of a memory, but for what was there before and what is written last.
  static std::vector<Value> values_of(uint64_t begin, const Memory& memory) {
    const std::span<const Use> uses = memory.uses;
    std::vector<size_t> first;  // uses that begin a value
    for (size_t k = 0; k < uses.size();) {
      size_t end = k;
      bool writes = false, reads = false;
      for (; end < uses.size() && uses[end].op == uses[k].op; ++end)
        (uses[end].write ? writes : reads) = true;
      if (writes && !reads) first.push_back(k);
      if (writes && first.empty()) return {};  // adds to what was there before
      k = end;
    }
    std::vector<Value> values;
    for (size_t v = 0; v + 1 < first.size(); ++v)
      values.push_back({begin, uses.subspan(first[v], first[v + 1] - first[v])});
    return values;
  }
  static bool fixed(const Value& value) {
    return std::any_of(value.uses.begin(), value.uses.end(), [](const Use& u) { return u.fixed; });
  }
  // Whether elements wrote it, by themselves, and nothing but sums reads it.
  bool for_sums(const Value& value) const {
    const Chain& chain = chains_[chain_of_[value.uses[0].op]];
    const auto sum = [](const Use& use) { return use.gathered != nullptr; };
    return !value.uses[0].fixed && chain.last - chain.first == 1 &&
           std::all_of(value.uses.begin() + 1, value.uses.end(), sum);
  }
  void find_values(uint64_t begin, const Memory& memory) {
    std::vector<Value> values = values_of(begin, memory);
    bool sums = false;
    for (const Value& value : values)
      if (for_sums(value)) {
        gathered_[value.uses[0].op].push_back(value);
        sums = true;
      }
    if (!sums && !values.empty()) others_.emplace_back(memory.end, std::move(values));
  }
  // Where no operation needs a value in the first place, it goes to another one than the next
  // value. The last of all stays in the first.
  void give_second_place(uint64_t end, const std::vector<Value>& values) {
    if (std::all_of(values.begin(), values.end(), fixed)) return;
    const uint64_t begin = values[0].begin;
    const uint32_t place = allocate(std::vector(plan_.parts_, Rows{0, 1}), end - begin, true);
    bool second = false;
    for (size_t v = values.size(); v-- > 0;) {
      second = !second && !fixed(values[v]);
      if (!second) continue;
      for (const Use& use : values[v].uses)
        moves_[use.op].push_back({begin, use.word, place, kSecondPlace});
    }
  }

  void give_parts(uint32_t op, const std::vector<Value>& values) {
    // A sum does its own rows, so it cannot be the elements of another one as well.
    if (values.size() != ops_[op].layout->outputs.size() || sums_.contains(op)) return;
    Elements elements{op, 0, {}};
    std::vector<Needed> needed;
    for (const Value& value : values)
      for (const Use& use : value.uses.subspan(1)) {
        if (value.uses[0].row_bytes % use.row_bytes != 0) return;  // items of several rows
        elements.sums.push_back(use.op);
        needed.emplace_back(arguments(use.op)[use.gathered->offsets],
                            arguments(use.op)[use.gathered->items], ops_[use.op].n, use.row_bytes,
                            value.uses[0].row_bytes);
      }
    std::sort(needed.begin(), needed.end());
    needed.erase(std::unique(needed.begin(), needed.end()), needed.end());
    elements.rows = set_of(needed, ops_[op].n);
    if (elements.rows == 0) return;
    const auto number = static_cast<uint32_t>(elements_.size());
    for (const Value& value : values) {
      const auto [known, is_new] = own_.try_emplace({value.begin, elements.rows}, 0);
      if (is_new)
        known->second = allocate(
            std::span(plan_.rows_).subspan((elements.rows - 1) * plan_.parts_, plan_.parts_),
            value.uses[0].row_bytes, false);
      for (const Use& use : value.uses)
        moves_[use.op].push_back({value.begin, use.word, known->second, number});
    }
    sums_.insert(elements.sums.begin(), elements.sums.end());
    elements_.push_back(std::move(elements));
  }
  // The rows that each part needs, as a number from 1 on; 0: it is not worth it, or not known.
  uint32_t set_of(const std::vector<Needed>& needed, int64_t n) {
    const auto [known, is_new] = sets_.try_emplace({needed, n}, 0);
    if (!is_new || needed.empty()) return known->second;
    std::vector<Rows> rows;
    std::vector<bool> covered(static_cast<size_t>(n));
    int64_t all = 0;
    for (uint32_t part = 0; part < plan_.parts_; ++part) {
      Rows r{n, 0};
      for (const auto& [offsets, items, sums, item_bytes, row_bytes] : needed) {
        const auto* const offset = reinterpret_cast<const int32_t*>(offsets);
        const auto* const item = reinterpret_cast<const int32_t*>(items);
        const int64_t whole = whole_sums(sums, plan_.parts_);
        const int32_t end = offset[part_begin(sums, part + 1, plan_.parts_, whole)];
        for (int32_t k = offset[part_begin(sums, part, plan_.parts_, whole)]; k < end; ++k) {
          const int64_t row = int64_t{item[k]} * item_bytes / row_bytes;
          if (item[k] < 0 || row >= n) return 0;
          r = {std::min(r.begin, row), std::max(r.end, row + 1)};
        }
      }
      if (r.begin >= r.end) return 0;
      r = {r.begin / kGroupRows * kGroupRows,
           std::min(n, (r.end + kGroupRows - 1) / kGroupRows * kGroupRows)};
      std::fill(covered.begin() + r.begin, covered.begin() + r.end, true);
      all += r.end - r.begin;
      rows.push_back(r);
    }
    // An element that no sum needs may still be one that fails.
    if (all > kMostTimes * n || std::find(covered.begin(), covered.end(), false) != covered.end())
      return 0;
    plan_.rows_.insert(plan_.rows_.end(), rows.begin(), rows.end());
    return known->second = static_cast<uint32_t>(plan_.rows_.size() / plan_.parts_);
  }

  // Memory for the rows of each part, or the same for all.
  uint32_t allocate(std::span<const Rows> rows, uint64_t row_bytes, bool shared) {
    const auto up = [](uint64_t bytes) { return (bytes + kApart - 1) / kApart * kApart; };
    const auto bytes = [&](const Rows& r) {  // the last row of three words is read as four
      return up(static_cast<uint64_t>(r.end - r.begin) * row_bytes + 4);
    };
    uint64_t all = kApart;
    for (const Rows& r : shared ? rows.first(1) : rows) all += bytes(r);
    plan_.memory_.push_back(std::make_unique<std::byte[]>(all));
    uint64_t at = up(reinterpret_cast<uint64_t>(plan_.memory_.back().get()));
    for (const Rows& r : rows) {
      bases_.push_back(at - static_cast<uint64_t>(r.begin) * row_bytes);
      if (!shared) at += bytes(r);
    }
    return static_cast<uint32_t>(plan_.memory_.size() - 1);
  }

  bool active(const Move& move) const {
    return move.elements == kSecondPlace || elements_[move.elements].active;
  }
  // What other parts may see of what an operation touches.
  void outside(uint32_t op, std::vector<MemoryAccess>& touched) const {
    const auto moves = moves_.find(op);
    for (MemoryAccess access : touched_[op]) {
      bool own = false;
      if (moves != moves_.end())
        for (const Move& move : moves->second) {
          if (move.begin != access.begin || !active(move)) continue;
          own = move.elements != kSecondPlace;
          access.begin = bases_[size_t{move.memory} * plan_.parts_];
          break;
        }
      if (!own) touched.push_back(access);
    }
  }
  // Whether the chains from `last` to `end` can follow on those from `first` on, part by part.
  bool can_join(uint32_t first, uint32_t last, uint32_t end) {
    before_.clear();
    after_.clear();
    for (uint32_t c = first; c < end; ++c) {
      if (chains_[c].parts != plan_.parts_) return false;
      for (uint32_t k = chains_[c].first; k < chains_[c].last; ++k)
        outside(k, c < last ? before_ : after_);
    }
    for (const MemoryAccess& b : before_)
      for (const MemoryAccess& a : after_)
        if ((a.write || b.write) && share_bytes(a, b)) return false;
    return true;
  }
  // Groups phases: each goes to the one before it when it can.
  void join() {
    const auto count = static_cast<uint32_t>(chains_.size());
    group_.resize(count);
    uint32_t first = 0, group = 0;
    for (uint32_t c = 0; c < count;) {
      uint32_t end = c;
      while (end < count && chains_[end].phase == chains_[c].phase) ++end;
      if (c != 0 && !can_join(first, c, end)) {
        first = c;
        ++group;
      }
      for (; c < end; ++c) group_[c] = group;
    }
  }
  // Elements and sums that are in different phases after all stay as they were recorded.
  bool withdraw() {
    bool any = false;
    for (Elements& e : elements_) {
      const auto joined = [&](uint32_t sum) {
        return group_[chain_of_[sum]] == group_[chain_of_[e.op]];
      };
      if (!e.active || std::all_of(e.sums.begin(), e.sums.end(), joined)) continue;
      e.active = false;
      any = true;
    }
    return any;
  }
  void commit() {
    for (const Elements& e : elements_)
      if (e.active) {
        plan_.changes_[e.op].rows = e.rows;
        for (const uint32_t sum : e.sums) {
          Chain& chain = chains_[chain_of_[sum]];
          chain.whole = whole_sums(chain.rows, chain.parts);
        }
      }
    for (const auto& [op, moves] : moves_) {
      Change& change = plan_.changes_[op];
      change.first = static_cast<uint32_t>(plan_.moved_.size());
      for (const bool shared : {true, false}) {
        for (const Move& move : moves)
          if (active(move) && (move.elements == kSecondPlace) == shared)
            plan_.moved_.push_back({move.word, move.memory});
        (shared ? change.shared : change.words) =
            static_cast<uint32_t>(plan_.moved_.size()) - change.first;
      }
    }
    for (uint32_t part = 0; part < plan_.parts_; ++part)
      for (size_t memory = 0; memory < plan_.memory_.size(); ++memory)
        plan_.bases_.push_back(bases_[memory * plan_.parts_ + part]);
    for (size_t c = 1; c < chains_.size(); ++c)
      if (group_[c] == group_[c - 1] && chains_[c].phase != chains_[c - 1].phase)
        plan_.joint_[group_[c]] = true;
    for (size_t c = 0; c < chains_.size(); ++c) chains_[c].phase = group_[c];
  }

  Overlap& plan_;
  const std::span<const OpList::Op> ops_;
  const std::span<const uint64_t> words_;
  const std::span<const MemoryAccess> accesses_;
  const std::span<Chain> chains_;
  std::vector<uint32_t> chain_of_;                   // by operation
  std::vector<std::vector<MemoryAccess>> touched_;   // by operation
  std::map<uint64_t, Memory> memory_;                // by its begin
  std::map<uint32_t, std::vector<Value>> gathered_;  // by nothing but sums; by who wrote them
  std::vector<std::pair<uint64_t, std::vector<Value>>> others_;  // and where their memory ends
  std::vector<Elements> elements_;
  std::set<uint32_t> sums_;                      // of elements
  std::map<uint32_t, std::vector<Move>> moves_;  // by operation
  std::map<std::pair<std::vector<Needed>, int64_t>, uint32_t> sets_;
  std::map<std::pair<uint64_t, uint32_t>, uint32_t> own_;  // memory, by its begin and the rows
  std::vector<uint64_t> bases_;                            // of each part, memory by memory
  std::vector<uint32_t> group_;                            // by chain
  std::vector<MemoryAccess> before_, after_;
};

Overlap::Overlap(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses, std::span<Chain> chains, uint32_t parts)
    : parts_(parts), joint_(chains.size()), changes_(ops.size()) {
  if (parts > 1) Planner(*this, ops, words, accesses, chains).run();
}

}  // namespace nova::detail
