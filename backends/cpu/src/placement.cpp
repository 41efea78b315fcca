// Register allocation by linear scan: values whose lifetimes do not overlap share a register. The
// registers of a block then fit into the cache.
#include <algorithm>
#include <functional>

#include "lowering.h"

namespace novaphy::cpu {
namespace {

class Placer {
 public:
  Placer(Lowered& lowered, bool scalar_form) : l_(lowered), scalar_form_(scalar_form) {
    first_.assign(l_.place.size(), kNever);
    last_.assign(l_.place.size(), kNever);
  }

  void run() {
    if (!scalar_form_) find_prologue();
    find_lives();
    std::vector<std::vector<ValueId>> dying(l_.items.size() + 1);
    std::vector<std::vector<ValueId>> born(l_.items.size() + 1);
    for (size_t v = 0; v < first_.size(); ++v) {
      if (first_[v] == kNever || !shares(static_cast<ValueId>(v))) continue;
      born[static_cast<size_t>(first_[v]) + 1].push_back(static_cast<ValueId>(v));
      const int32_t end = std::max(first_[v], last_[v]);
      if (end < static_cast<int32_t>(l_.items.size()))
        dying[static_cast<size_t>(end) + 1].push_back(static_cast<ValueId>(v));
    }
    // Position 0 in the lists of starts and ends means "before the first item", where the row
    // number is set.
    for (size_t at = 0; at <= l_.items.size(); ++at) {
      // Only a plain operation reads its operands of a lane before it writes the lane. Its result
      // may therefore replace an operand.
      const bool in_place = at > 0 && l_.items[at - 1].kind == Item::Kind::Op;
      if (in_place) {
        release(dying[at], static_cast<int32_t>(at) - 1, false);
        take(born[at]);
        release(dying[at], static_cast<int32_t>(at) - 1, true);
      } else {
        take(born[at]);
        release(dying[at], static_cast<int32_t>(at) - 1, false);
        release(dying[at], static_cast<int32_t>(at) - 1, true);
      }
    }
  }

 private:
  static constexpr int32_t kNever = -2;
  static constexpr int32_t kBefore = -1;  // defined before the first item

  // Scalars of the block form do not share memory, because a scalar takes only four bytes.
  bool shares(ValueId v) const {
    return scalar_form_ || l_.place[static_cast<size_t>(v)].uniform == 0;
  }

  // Finds the uniform items outside of loops and regions that depend only on such items. They run
  // once per launch.
  void find_prologue() {
    std::vector<char> early(l_.place.size(), 0);
    const auto known = [&](ValueId v) {
      return v == kNoValue || l_.place[static_cast<size_t>(v)].slot >= 0 ||
             early[static_cast<size_t>(v)] != 0;
    };
    for (size_t k = 0; k < l_.items.size(); ++k) {
      const Item& item = l_.items[k];
      if (item.kind != Item::Kind::Op && item.kind != Item::Kind::Load) continue;
      if (!item.uniform || item.loop >= 0 || item.region >= 0) continue;
      if (!known(item.a) || !known(item.b) || !known(item.c)) continue;
      l_.prologue.push_back(static_cast<int32_t>(k));
      if (item.kind == Item::Kind::Op) early[static_cast<size_t>(item.d)] = 1;
      if (item.kind == Item::Kind::Load) {
        for (const ValueId v : l_.groups[static_cast<size_t>(item.group)].targets)
          early[static_cast<size_t>(v)] = 1;
      }
    }
  }

  void def(ValueId v, int32_t at) {
    if (v == kNoValue) return;
    int32_t& first = first_[static_cast<size_t>(v)];
    if (first == kNever) first = at;
    if (!shares(v) && l_.place[static_cast<size_t>(v)].slot < 0)
      l_.place[static_cast<size_t>(v)].slot = l_.scalar_count++;
  }

  void use(ValueId v, int32_t at) {
    if (v == kNoValue || l_.place[static_cast<size_t>(v)].slot >= 0)
      return;  // a constant or a parameter
    // A loop reads a value from before the loop in every iteration.
    const int32_t first = first_[static_cast<size_t>(v)];
    for (const LoopValues& loop : l_.loops) {
      if (at > loop.begin && at <= loop.end && first < loop.begin) at = loop.end;
    }
    last_[static_cast<size_t>(v)] = std::max(last_[static_cast<size_t>(v)], at);
  }

  void find_lives() {
    if (scalar_form_ || l_.index_used) def(l_.index_value, kBefore);
    for (size_t k = 0; k < l_.items.size(); ++k) {
      const Item& item = l_.items[k];
      const auto at = static_cast<int32_t>(k);
      switch (item.kind) {
        case Item::Kind::Op:
          use(item.a, at);
          use(item.b, at);
          use(item.c, at);
          def(item.d, at);
          break;
        case Item::Kind::Load:
          if (item.a != l_.index_value) use(item.a, at);
          for (const ValueId v : l_.groups[static_cast<size_t>(item.group)].targets) def(v, at);
          break;
        case Item::Kind::Skip:
          use(item.a,
              std::max(at, item.target - 1));  // loads inside the region read the condition
          break;
        case Item::Kind::LoopBegin: {
          const LoopValues& loop = l_.loops[static_cast<size_t>(item.loop)];
          for (const ValueId v : loop.inits) use(v, at);
          for (const ValueId v : loop.accumulators) def(v, at);
          for (const ValueId v : {loop.reduce, loop.slot, loop.start, loop.length, loop.active})
            def(v, at);
          break;
        }
        case Item::Kind::LoopEnd: {
          const LoopValues& loop = l_.loops[static_cast<size_t>(item.loop)];
          for (const ValueId v : loop.terms) use(v, at);
          for (const ValueId v : loop.accumulators) use(v, at);
          for (const ValueId v : {loop.reduce, loop.slot, loop.start, loop.length, loop.active}) {
            if (v != kNoValue)
              last_[static_cast<size_t>(v)] = std::max(last_[static_cast<size_t>(v)], at);
          }
          break;
        }
      }
    }
    for (const auto& values : l_.outputs) {
      for (const ValueId v : values) use(v, static_cast<int32_t>(l_.items.size()));
    }
    if (scalar_form_)
      // the interpreter's loop over rows sets the index
      use(l_.index_value, static_cast<int32_t>(l_.items.size()));
  }

  void take(const std::vector<ValueId>& values) {
    int32_t& count = scalar_form_ ? l_.scalar_count : l_.register_count;
    for (const ValueId v : values) {
      Operand& place = l_.place[static_cast<size_t>(v)];
      if (free_.empty()) {
        place.slot = count++;
      } else {
        place.slot = free_.back();
        free_.pop_back();
      }
    }
  }

  void release(const std::vector<ValueId>& values, int32_t at, bool born_here) {
    for (const ValueId v : values) {
      if ((first_[static_cast<size_t>(v)] == at) == born_here)
        free_.push_back(l_.place[static_cast<size_t>(v)].slot);
    }
  }

  Lowered& l_;
  const bool scalar_form_;
  std::vector<int32_t> first_, last_;
  std::vector<int32_t> free_;
};

}  // namespace

void place_values(Lowered& lowered, bool scalar_form) { Placer(lowered, scalar_form).run(); }

}  // namespace novaphy::cpu
