#include "emit_kept.h"

#include <algorithm>
#include <map>
#include <tuple>

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }

// With fewer operations per kept value, computing the values again costs less.
constexpr size_t kMinOperationsPerValue = 3;

class Finder {
 public:
  Finder(const Program& program, const EmitPlan& plan, int32_t loop, int32_t earlier)
      : p_(program), plan_(plan), equal_(program.instrs.size(), kNone) {
    found_.loop = loop;
    found_.earlier = earlier;
  }

  KeptValues run() {
    find_equal();
    drop_split_loads();
    for (size_t v = 0; v < equal_.size(); ++v)
      if (in(found_.loop, v) && equal_[v] != kNone)
        found_.equal.emplace_back(static_cast<Value>(v), equal_[v]);
    find_read();
    return std::move(found_);
  }

 private:
  // Returns whether the value is computed for every item of the loop, without a condition.
  bool in(int32_t loop, size_t v) const {
    return plan_.is_line(v, p_.instrs[v].op) && plan_.loop[v] == loop && plan_.region[v] == -1;
  }
  static auto key(Op op, Value a, Value b, Value c) { return std::make_tuple(op, a, b, c); }

  // Finds equal values by value numbering: in a formula of the later loop, operands are replaced by
  // their equals in the earlier loop.
  void find_equal() {
    std::map<std::tuple<Op, Value, Value, Value>, Value> earlier;
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const Instr& i = p_.instrs[v];
      if (in(found_.earlier, v)) earlier.emplace(key(i.op, i.a, i.b, i.c), static_cast<Value>(v));
    }
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const Instr& i = p_.instrs[v];
      if (i.op == Op::SLOT || i.op == Op::REDUCE_INDEX) {  // both loops are at the same item
        if (i.a == found_.loop) equal_[v] = counter(i.op);
        continue;
      }
      if (!in(found_.loop, v)) continue;
      const auto known = earlier.find(renamed(i));
      if (known != earlier.end()) equal_[v] = known->second;
    }
  }
  Value counter(Op op) const {
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (p_.instrs[v].op == op && p_.instrs[v].a == found_.earlier) return static_cast<Value>(v);
    return kNone;
  }
  std::tuple<Op, Value, Value, Value> renamed(const Instr& i) const {
    Instr r = i;
    for_each_operand(i, [&](const Value& v) {
      Value& operand = &v == &i.a ? r.a : &v == &i.b ? r.b : r.c;
      if (equal_[at(v)] != kNone) operand = equal_[at(v)];
    });
    return key(r.op, r.a, r.b, r.c);
  }

  // Columns of a row are loaded together, so either all columns have equals or no column has one. A
  // value that depends on a column without an equal then has no equal either.
  void drop_split_loads() {
    for (bool changed = true; changed;) {
      changed = false;
      for (const LoadGroup& group : plan_.groups) {
        const auto has = [&](bool equal) {
          return std::any_of(group.columns.begin(), group.columns.end(), [&](Value v) {
            return v != kNone && in(found_.loop, at(v)) && (equal_[at(v)] != kNone) == equal;
          });
        };
        if (!has(true) || !has(false)) continue;
        changed = true;
        for (const Value v : group.columns)
          if (v != kNone) equal_[at(v)] = kNone;
      }
      for (size_t v = 0; v < equal_.size(); ++v) {
        if (equal_[v] == kNone || !in(found_.loop, v)) continue;
        for_each_operand(p_.instrs[v], [&](Value o) {
          if (in(found_.loop, at(o)) && equal_[at(o)] == kNone && equal_[v] != kNone) {
            equal_[v] = kNone;
            changed = true;
          }
        });
      }
    }
  }

  void find_read() {
    std::vector<char> read(equal_.size(), 0);
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (plan_.used[v] && !(in(found_.loop, v) && equal_[v] != kNone))
        for_each_operand(p_.instrs[v], [&](Value o) { read[at(o)] = 1; });
    for (const Region& r : plan_.regions) read[at(r.cond)] = 1;
    for (const Sum& s : p_.loops[at(found_.loop)].sums) read[at(s.term)] = 1;
    for (const auto& pair : found_.equal)
      if (read[at(pair.first)]) found_.kept.push_back(pair);
  }

  const Program& p_;
  const EmitPlan& plan_;
  std::vector<Value> equal_;  // per value of the later loop: its equal in the earlier loop, or
                              // kNone
  KeptValues found_;
};

}  // namespace

std::vector<KeptValues> find_kept_values(const Program& program, const EmitPlan& plan) {
  std::vector<KeptValues> all;
  for (size_t later = 1; later < program.loops.size(); ++later) {
    if (program.loops[later].kind != LoopKind::Csr) continue;
    for (size_t earlier = 0; earlier < later; ++earlier) {
      if (program.loops[earlier].kind != LoopKind::Csr) continue;
      KeptValues found =
          Finder(program, plan, static_cast<int32_t>(later), static_cast<int32_t>(earlier)).run();
      if (found.equal.size() < kMinOperationsPerValue * found.kept.size() || found.kept.empty())
        continue;
      all.push_back(std::move(found));
      break;
    }
  }
  return all;
}

}  // namespace nova::ir
