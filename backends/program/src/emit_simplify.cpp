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

// What is no longer used would seem to need its operands, whatever the condition.
void drop_unused(Program& p) {
  std::vector<int32_t> uses = count_uses(p);
  for (size_t v = p.instrs.size(); v-- > 0;) {
    if (uses[v] != 0 || p.instrs[v].op == Op::SUM) continue;
    for_each_operand(p.instrs[v], [&](Value o) { --uses[at(o)]; });
    p.instrs[v] = {Op::CONST_F, 0};
  }
}

}  // namespace

Program simplified(Program p) {
  const std::vector<int32_t> uses = count_uses(p);
  for (Instr& in : p.instrs) {
    if (in.op != Op::ADD) continue;
    Value first = in.a, second = in.b;  // c ? 0 : a, and c ? b : 0
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
