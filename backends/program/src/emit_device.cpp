// What the emitter writes for a device, where a thread has one row and one lane.
#include "emitter.h"

namespace nova::ir {

bool Emitter::in_batches(int32_t l) const {
  constexpr int32_t kFewSteps = 16;
  if (!device_ || !items_.empty()) return false;
  int32_t steps = 0;
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (plan_.used[v] && plan_.loop[v] == l) steps += plan_.region[v] >= 0 ? kFewSteps : 1;
  return steps < kFewSteps;
}

void Emitter::device_items(int32_t l) {
  const std::string k = str(l), r = "r" + k, batch = "b" + k;
  const bool again = items_done_ == l, batches = !again && in_batches(l);
  if (batches) {
    line("csr_batch csr" + k + " = csr_first(args, " + str(p_.loop_argument(at(l))) + ", " + k +
         ", i);");
  } else if (!again) {
    csr_rows(l);
  }
  std::string on = "splatb(1)";  // a lane that is off has left
  if (again) {
    line("for (int32_t " + r + " = kept.count; " + r + " < csr" + k + ".longest; ++" + r + ") {");
  } else if (!items_.empty()) {
    items_done_ = l;
    in_items_ = true;
    looked_before_ = looked_;
    out_ += "#pragma unroll\n";
    line("for (int32_t " + r + " = 0; " + r + " < KEPT_ITEMS; ++" + r + ") {");
    on = r + " < kept.count";
  } else if (batches) {
    line("for (int32_t " + batch + " = 0; " + batch + " < csr" + k + ".longest; " + batch +
         " += CSR_BATCH) {");
    ++depth_;
    line("if (" + batch + " > 0) csr_load(&csr" + k + ", items" + k + ", " + batch + ");");
    out_ += "#pragma unroll\n";
    line("for (int32_t " + r + " = 0; " + r + " < CSR_BATCH; ++" + r + ") {");
    on = "csr_on(&csr" + k + ", " + batch + " + " + r + ")";
  } else {
    line("for (int32_t " + r + " = 0; " + r + " < csr" + k + ".longest; ++" + r + ") {");
  }
  ++depth_;
  line("const vb on" + k + " = " + on + ";");
  slot(l);
}

void Emitter::loads_first(int32_t region) {
  if (!device_ || loop_ >= 0) return;
  for (const Step& step : plan_.steps) {
    const size_t v = at(step.value);
    if (step.kind != Step::Kind::Compute || !is_load(p_.instrs[v].op)) continue;
    if (!plan_.used[v] || plan_.once[v] || done_[v]) continue;
    if (plan_.loop[v] >= 0 || plan_.region[v] != region) continue;
    const size_t row = at(p_.instrs[v].b);
    if (p_.instrs[row].op != Op::INDEX && !is_leaf(p_.instrs[row].op) && !computed_[row]) continue;
    compute(step.value);
    done_[v] = 1;
  }
}

std::string Emitter::without(Value v, const Region& region) {
  if (!device_ || text_.uniform(v)) return zero(v);
  Value select = kNone;
  int32_t uses = 0;
  for (size_t u = 0; u < p_.instrs.size(); ++u)
    for_each_operand(p_.instrs[u], [&](Value operand) {
      if (operand != v || !plan_.used[u]) return;
      if (plan_.region[u] >= 0 && &plan_.regions[at(plan_.region[u])] == &region) return;
      ++uses;
      select = static_cast<Value>(u);
    });
  for (const Loop& loop : p_.loops)
    for (const auto& sum : loop.sums) uses += sum.term == v || sum.init == v ? 2 : 0;
  for (const Output& output : p_.outputs)
    for (const Value o : output.values) uses += o == v ? 2 : 0;
  if (uses != 1) return zero(v);
  const Instr& in = p_.instrs[at(select)];
  const bool is_select = in.op == Op::SELECT_F || in.op == Op::SELECT_I || in.op == Op::SELECT_B;
  if (!is_select || in.a != region.cond || (region.polarity ? in.b : in.c) != v) return zero(v);
  const Value other = region.polarity ? in.c : in.b;
  if (other == v || (!is_leaf(p_.instrs[at(other)].op) && !computed_[at(other)])) return zero(v);
  chosen_[at(select)] = v;
  return text_.lanes(other);
}

}  // namespace nova::ir
