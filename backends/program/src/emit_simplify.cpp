#include "emit_simplify.h"

#include <algorithm>
#include <utility>

namespace nova::ir {
namespace {

size_t at(Value v) { return static_cast<size_t>(v); }

bool is_zero(const Program& p, Value v) {
  return p.instrs[at(v)].op == Op::CONST_F && p.instrs[at(v)].a == 0;
}

std::vector<int32_t> count_uses(const Program& p) {
  std::vector<int32_t> uses(p.instrs.size(), 0);
  for (const Instr& in : p.instrs) for_each_operand(in, [&](Value v) { ++uses[at(v)]; });
  for (const Output& o : p.outputs)
    for (const Value v : o.values) ++uses[at(v)];
  for (const Loop& l : p.loops)
    for (const Sum& s : l.sums) ++uses[at(s.init)], ++uses[at(s.term)];
  return uses;
}

// Removes unused values, which would otherwise count as unconditional uses of their operands.
void drop_unused(Program& p) {
  std::vector<int32_t> uses = count_uses(p);
  for (size_t v = p.instrs.size(); v-- > 0;) {
    if (uses[v] != 0 || p.instrs[v].op == Op::SUM) continue;
    for_each_operand(p.instrs[v], [&](Value o) { --uses[at(o)]; });
    p.instrs[v] = {Op::CONST_F, 0};
  }
}

// Moves the sign of a factor into the sum that uses its product: c + (-a) b becomes c - a b.
class NegationFolder {
 public:
  explicit NegationFolder(Program& p) : p_(p), users_(p.instrs.size()), kept_(p.instrs.size(), 0) {
    for (size_t v = 0; v < p.instrs.size(); ++v)
      for_each_operand(p.instrs[v],
                       [&](Value o) { users_[at(o)].push_back(static_cast<Value>(v)); });
    for (const Output& o : p.outputs)
      for (const Value v : o.values) kept_[at(v)] = 1;
  }
  void run() {
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      if (p_.instrs[v].op != Op::NEG) continue;
      const Value positive = p_.instrs[v].a;
      const std::vector<Value> users = users_[v];
      for (const Value user : users) take_sign(user, static_cast<Value>(v), positive);
    }
  }

 private:
  static bool is_product(const Instr& in) { return in.op == Op::MUL || in.op == Op::DIV; }
  // Returns whether all users can take the negative of the value without an additional operation.
  // If a product uses the value, it must be the only user, because two products could meet in one
  // sum.
  bool flips(Value v) const {
    const std::vector<Value>& users = users_[at(v)];
    return kept_[at(v)] == 0 && std::all_of(users.begin(), users.end(), [&](Value user) {
             return (users.size() == 1 || !is_product(p_.instrs[at(user)])) &&
                    takes_negative(user, v);
           });
  }
  bool takes_negative(Value user, Value v) const {
    const Instr& in = p_.instrs[at(user)];
    const bool once = (in.a == v) != (in.b == v);
    if (is_product(in)) return once && flips(user);
    return once && (in.op == Op::ADD || (in.op == Op::SUB && in.b == v));
  }
  void flip(Value v) {
    for (const Value user : users_[at(v)]) {
      Instr& in = p_.instrs[at(user)];
      if (is_product(in)) {
        flip(user);
      } else if (in.op == Op::SUB) {
        in.op = Op::ADD;
      } else {
        in = {Op::SUB, in.a == v ? in.b : in.a, v};
      }
    }
  }
  // Lets `user` read `positive` instead of `negative`, if that needs no additional operation.
  void take_sign(Value user, Value negative, Value positive) {
    if (!takes_negative(user, negative)) return;
    Instr& in = p_.instrs[at(user)];
    if (is_product(in)) {
      flip(user);
      (in.a == negative ? in.a : in.b) = positive;
    } else {
      in = in.op == Op::SUB ? Instr{Op::ADD, in.a, positive}
                            : Instr{Op::SUB, in.a == negative ? in.b : in.a, positive};
    }
    std::erase(users_[at(negative)], user);
    users_[at(positive)].push_back(user);
  }

  Program& p_;
  std::vector<std::vector<Value>> users_;
  std::vector<char> kept_;  // per value: whether an output reads it
};

}  // namespace

Program simplified(Program p) {
  if (p.loops.empty()) NegationFolder(p).run();
  const std::vector<int32_t> uses = count_uses(p);
  for (Instr& in : p.instrs) {
    if (in.op != Op::ADD) continue;
    Value first = in.a, second = in.b;  // the two selects are (c ? 0 : a) and (c ? b : 0)
    const auto halves = [&] {
      const Instr &x = p.instrs[at(first)], &y = p.instrs[at(second)];
      return x.op == Op::SELECT_F && y.op == Op::SELECT_F && x.a == y.a && is_zero(p, x.b) &&
             is_zero(p, y.c);
    };
    if (!halves()) std::swap(first, second);
    if (!halves()) continue;
    const Instr x = p.instrs[at(first)], y = p.instrs[at(second)];
    const Value last = std::max(first, second);
    if (x.c == y.b) {
      in = {Op::ADD, x.c, x.b};
    } else if (uses[at(last)] == 1) {
      p.instrs[at(last)] = {Op::SELECT_F, x.a, y.b, x.c};
      in = {Op::ADD, last, x.b};
    }
  }
  drop_unused(p);
  return p;
}

bool is_no_negative_zero(const Program& p, Value v) {
  const Instr& in = p.instrs[at(v)];
  if (in.op == Op::CONST_F) return in.a != INT32_MIN;
  return in.op == Op::ADD && (is_zero(p, in.a) || is_zero(p, in.b));
}

}  // namespace nova::ir
