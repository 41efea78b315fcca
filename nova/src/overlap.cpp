#include "overlap.h"

#include <algorithm>
#include <cstring>
#include <functional>
#include <map>
#include <set>
#include <utility>

#include "intervals.h"

namespace nova::detail {

namespace {

constexpr uint64_t kApart = 128;  // bytes: processors fetch lines by two

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
    for (const auto& [op, values] : gathered_) consider(op, values);
    share_out();
    for (const Elements& e : candidates_) give_parts(e);
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
    uint32_t settled = 0;        // no operation from this one on writes there
    std::vector<Use> uses = {};  // in the order of phases
  };
  // What was written there before something else was: the uses from its first write on.
  struct Value {
    uint64_t begin;
    std::span<const Use> uses;
  };
  // Elements whose values only sums gather, so that each part may have its own.
  struct Elements {
    uint32_t op;
    std::vector<Value> values;
    std::vector<Gathering> gatherings;  // each once
    uint32_t lists = 0;
    bool active = true;
  };
  // An argument word that goes elsewhere: to memory of parts while these elements are active, or
  // (kSecondPlace) to the second place of a memory.
  struct Move {
    uint64_t begin;
    uint32_t word, memory, elements;
  };
  static constexpr uint32_t kSecondPlace = UINT32_MAX;
  static constexpr uint64_t kNowhere = 0;  // where it was recorded, it is read still
  // What elements read at their own rows.
  struct Input {
    uint64_t begin;
    uint32_t row_bytes, lists;
    auto operator<=>(const Input&) const = default;
  };

  const uint64_t* arguments(uint32_t op) const { return words_.data() + ops_[op].first_word; }

  // Through which words the operation touches the memory that begins there; none: it needs it
  // there.
  std::vector<Use> uses_at(uint32_t op, uint64_t begin) const {
    const RowLayout* layout = ops_[op].layout;
    const Chain& chain = chains_[chain_of_[op]];
    std::vector<Use> uses;
    if (layout == nullptr || !layout->row_local || ops_[op].active ||
        chain.shares.parts != plan_.parts_ || ops_[op].n != chain.rows)
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
      if (access.write) memory.settled = op + 1;
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
    // The last row of three words is read as four.
    const uint64_t bytes = end - begin + 4;
    const uint32_t place = allocate({&bytes, 1});
    bool second = false;
    for (size_t v = values.size(); v-- > 0;) {
      second = !second && !fixed(values[v]);
      if (!second) continue;
      for (const Use& use : values[v].uses)
        moves_[use.op].push_back({begin, use.word, place, kSecondPlace});
    }
  }

  const RowLayout& layout(uint32_t op) const { return *ops_[op].layout; }
  Gathering gathering(const Use& use, const Value& value) const {
    const auto table = [&](uint32_t word) {
      return reinterpret_cast<const int32_t*>(arguments(use.op)[word]);
    };
    return {table(use.gathered->offsets), table(use.gathered->items), ops_[use.op].n,
            static_cast<int32_t>(value.uses[0].row_bytes / use.row_bytes)};
  }
  // Whether a copy can stand for what an operation reads at its own row there from now on.
  bool is_settled(uint32_t op, const RowLayout::Word& input) const {
    const auto memory = memory_.find(arguments(op)[input.word]);
    return memory != memory_.end() && !memory->second.mixed && memory->second.settled <= op &&
           arguments(op)[input.word + 1] >= static_cast<uint64_t>(ops_[op].n);
  }
  void consider(uint32_t op, const std::vector<Value>& values) {
    const RowLayout& own = layout(op);
    if (values.size() != own.outputs.size() || !own.tables.empty() || !own.gathered.empty() ||
        !std::all_of(own.inputs.begin(), own.inputs.end(),
                     [&](const RowLayout::Word& w) { return is_settled(op, w); }))
      return;
    Elements elements{op, values, {}};
    std::map<uint32_t, std::vector<Gathering>> sums;  // by operation
    for (const Value& value : values)
      for (const Use& use : value.uses.subspan(1)) {
        if (value.uses[0].row_bytes % use.row_bytes != 0) return;  // items of several rows
        if (ops_[use.op].tables_change) return;
        sums[use.op].push_back(gathering(use, value));
      }
    for (const auto& [sum, all] : sums) {
      // Its items get other numbers: those of all that it gathers, in the same way.
      if (all.size() != layout(sum).gathered.size() || all[0].items == nullptr ||
          std::adjacent_find(all.begin(), all.end(), std::not_equal_to<>()) != all.end())
        return;
      elements.gatherings.push_back(all[0]);
    }
    std::sort(elements.gatherings.begin(), elements.gatherings.end());
    const auto end = std::unique(elements.gatherings.begin(), elements.gatherings.end());
    elements.gatherings.erase(end, elements.gatherings.end());
    if (elements.gatherings.empty()) return;
    for (const RowLayout::Word& w : own.inputs) ++readers_[arguments(op)[w.word]];
    candidates_.push_back(std::move(elements));
  }
  // Sums that join their elements are shared out evenly, not by whole groups: a few rows more are
  // many elements more. A part has a group at least, for less would be slow.
  void share_out() {
    std::map<std::pair<Gathering, int64_t>, int64_t> weights;
    for (const Elements& e : candidates_)
      for (const Gathering& g : e.gatherings) weights[{g, ops_[e.op].n}] += layout(e.op).operations;
    std::map<int64_t, std::vector<Demand>> demands;
    for (const auto& [key, weight] : weights)
      demands[key.first.sums].push_back({key.first, key.second, weight});
    for (const auto& [sums, all] : demands) {
      const int64_t whole = sums < kGroupRows * plan_.parts_ ? kGroupRows : 1;
      shares_[sums] = even_shares(all, {plan_.parts_, whole});
    }
  }
  void give_parts(Elements elements) {
    elements.lists = lists_of(elements.gatherings, ops_[elements.op].n);
    if (elements.lists == 0) return;
    const auto number = static_cast<uint32_t>(elements_.size());
    const Lists& lists = plan_.lists_[elements.lists - 1];
    const auto move = [&](uint32_t op, uint64_t begin, uint32_t word, uint32_t memory) {
      std::vector<Move>& moves = moves_[op];
      const auto same = [&](const Move& m) { return m.word == word; };  // items of two sums
      if (std::none_of(moves.begin(), moves.end(), same))
        moves.push_back({begin, word, memory, number});
    };
    for (const Value& value : elements.values) {
      const uint32_t memory =
          rows_in({value.begin, value.uses[0].row_bytes, elements.lists}, lists);
      for (const Use& use : value.uses) {
        move(use.op, value.begin, use.word, memory);
        if (use.gathered != nullptr)
          move(use.op, kNowhere, use.gathered->items,
               items_in(gathering(use, value), elements.lists, lists));
      }
    }
    for (const RowLayout::Word& w : layout(elements.op).inputs)
      move(elements.op, kNowhere, w.word, rows_in(place_of(elements, w), lists));
    elements_.push_back(std::move(elements));
  }
  // The rows that each part needs, as a number from 1 on; 0: it is not worth it, or not known.
  uint32_t lists_of(const std::vector<Gathering>& gatherings, int64_t n) {
    const auto [known, is_new] = sets_.try_emplace({gatherings, n}, 0);
    if (!is_new) return known->second;
    std::vector<Shares> shares;
    for (const Gathering& g : gatherings) shares.push_back(shares_[g.sums]);
    Lists lists = rows_needed(gatherings, shares, n);
    if (lists.empty()) return 0;
    plan_.lists_.push_back(std::move(lists));
    return known->second = static_cast<uint32_t>(plan_.lists_.size());
  }
  // Where the copy of an input stands. What only one operation reads, as the activations of a step,
  // stands where that of another step did: `begin` is then no address, but the number of the input.
  Input place_of(const Elements& elements, const RowLayout::Word& input) const {
    const uint64_t begin = arguments(elements.op)[input.word];
    const bool once = readers_.at(begin) == 1;
    return {once ? 1 + input.word : begin, input.row_bytes, elements.lists};
  }
  // Memory for what stands in these rows. Compiled code reads a group ahead.
  uint32_t rows_in(const Input& input, const Lists& lists) {
    const auto [known, is_new] = own_.try_emplace(input, 0);
    if (!is_new) return known->second;
    std::vector<uint64_t> bytes;
    for (const auto& list : lists) bytes.push_back((list.size() + kGroupRows) * input.row_bytes);
    return known->second = allocate(bytes);
  }
  // The items of the sums of each part.
  uint32_t items_in(const Gathering& gathering, uint32_t number, const Lists& lists) {
    const auto [known, is_new] = items_.try_emplace({gathering, number}, 0);
    if (!is_new) return known->second;
    const Shares& shares = shares_[gathering.sums];
    std::vector<std::vector<int32_t>> items;
    std::vector<uint64_t> bytes;
    for (uint32_t part = 0; part < plan_.parts_; ++part) {
      items.push_back(items_among(gathering, shares.begin(gathering.sums, part),
                                  shares.begin(gathering.sums, part + 1), lists[part]));
      bytes.push_back(items.back().size() * sizeof(int32_t));
    }
    known->second = allocate(bytes);
    for (uint32_t part = 0; part < plan_.parts_; ++part) {
      uint64_t& base = bases_[size_t{known->second} * plan_.parts_ + part];
      std::copy(items[part].begin(), items[part].end(), reinterpret_cast<int32_t*>(base));
      const int32_t first = gathering.offsets[shares.begin(gathering.sums, part)];
      base -= static_cast<uint64_t>(first) * sizeof(int32_t);
    }
    return known->second;
  }

  // Memory of so many bytes for each part, or the same for all.
  uint32_t allocate(std::span<const uint64_t> bytes) {
    const auto up = [](uint64_t b) { return (b + kApart - 1) / kApart * kApart; };
    uint64_t all = kApart;
    for (const uint64_t b : bytes) all += up(b);
    plan_.memory_.push_back(std::make_unique<std::byte[]>(all));
    uint64_t at = up(reinterpret_cast<uint64_t>(plan_.memory_.back().get()));
    for (uint32_t part = 0; part < plan_.parts_; ++part) {
      bases_.push_back(at);
      if (bytes.size() > 1) at += up(bytes[part]);
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
      if (chains_[c].shares.parts != plan_.parts_) return false;
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
      const auto joined = [&](const Value& value) {
        return std::all_of(value.uses.begin(), value.uses.end(), [&](const Use& use) {
          return group_[chain_of_[use.op]] == group_[chain_of_[e.op]];
        });
      };
      if (!e.active || std::all_of(e.values.begin(), e.values.end(), joined)) continue;
      e.active = false;
      any = true;
    }
    return any;
  }
  // Of what these elements are the first to read.
  void add_copies(const Elements& e) {
    Change& change = plan_.changes_[e.op];
    change.first_copy = static_cast<uint32_t>(plan_.copies_.size());
    for (const RowLayout::Word& w : layout(e.op).inputs) {
      const uint64_t begin = arguments(e.op)[w.word];
      const uint32_t memory = own_.at(place_of(e, w));
      if (copied_.insert({begin, w.row_bytes, e.lists}).second)
        plan_.copies_.push_back({begin, w.row_bytes, e.lists, memory});
    }
    change.copies = static_cast<uint32_t>(plan_.copies_.size()) - change.first_copy;
  }
  void commit() {
    for (const Elements& e : elements_)
      if (e.active) {
        plan_.changes_[e.op].lists = e.lists;
        add_copies(e);
        for (const Value& value : e.values)
          for (const Use& use : value.uses.subspan(1)) {
            Chain& chain = chains_[chain_of_[use.op]];
            chain.shares = shares_[chain.rows];
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
  std::vector<Elements> candidates_, elements_;
  std::map<int64_t, Shares> shares_;             // of the rows of sums, by their number
  std::map<uint32_t, std::vector<Move>> moves_;  // by operation
  std::map<std::pair<std::vector<Gathering>, int64_t>, uint32_t> sets_;
  std::map<Input, uint32_t> own_;  // memory
  std::map<std::pair<Gathering, uint32_t>, uint32_t> items_;
  std::set<Input> copied_;
  std::map<uint64_t, uint32_t> readers_;  // elements that read there at their own rows
  std::vector<uint64_t> bases_;           // of each part, memory by memory
  std::vector<uint32_t> group_;           // by chain
  std::vector<MemoryAccess> before_, after_;
};

Overlap::Overlap(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses, std::span<Chain> chains, uint32_t parts)
    : parts_(parts), joint_(chains.size()), changes_(ops.size()) {
  if (parts > 1) Planner(*this, ops, words, accesses, chains).run();
}

void Overlap::copy_rows(std::span<const Copy> copies, uint32_t part) const {
  for (const auto& [from, row_bytes, lists, memory] : copies) {
    auto* to = reinterpret_cast<std::byte*>(bases_[part * memory_.size() + memory]);
    for (const int32_t row : lists_[lists - 1][part]) {
      std::memcpy(to, reinterpret_cast<const std::byte*>(from) + int64_t{row} * row_bytes,
                  row_bytes);
      to += row_bytes;
    }
  }
}

}  // namespace nova::detail
