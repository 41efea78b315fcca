#include "emit_held.h"

#include <algorithm>

namespace nova::ir {
namespace {

bool contains(const std::vector<int32_t>& sources, int32_t source) {
  return std::find(sources.begin(), sources.end(), source) != sources.end();
}

}  // namespace

std::vector<char> find_held_values(const Program& program, const EmitPlan& plan, const Scan& scan) {
  std::vector<char> held(program.instrs.size(), 0);
  const auto shared = [&](Value operand, int32_t loop) {
    const auto o = static_cast<size_t>(operand);
    const Instr& in = program.instrs[o];
    if (in.op == Op::SLOT || in.op == Op::REDUCE_INDEX) return in.a == loop;
    if (in.op == Op::SUM) return false;
    return in.op == Op::INDEX || is_leaf(in.op) || plan.once[o] || held[o] != 0;
  };
  for (size_t v = 0; v < program.instrs.size(); ++v) {
    const Instr& in = program.instrs[v];
    const int32_t loop = plan.loop[v];
    if (!plan.used[v] || plan.once[v] || is_leaf(in.op)) continue;
    // Data of items under a condition is not held, because launches with the condition would load
    // it anyway.
    if (plan.region[v] >= 0 && (loop < 0 || plan.escapes[v])) continue;
    if (loop >= 0 && program.loops[static_cast<size_t>(loop)].kind != LoopKind::Csr) continue;
    if (is_load(in.op) && (contains(scan.carried, in.a) || contains(scan.varying, in.a))) continue;
    bool all = true;
    for_each_operand(in, [&](Value o) { all = all && shared(o, loop); });
    held[v] = all;
  }
  return held;
}

}  // namespace nova::ir
