// The text of the emitter for a device, where a thread has one row in one lane.
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
  std::string on = "splatb(1)";  // inactive threads have already returned
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

bool Emitter::is_quotient(Value v) const {
  const Op op = p_.instrs[at(v)].op;
  return (op == Op::DIV || op == Op::SQRT) && plan_.root[at(v)] == kNone && chosen_[at(v)] == kNone;
}

bool Emitter::can_be_there(Value v, int32_t region) const {
  const Instr& in = p_.instrs[at(v)];
  if (in.op == Op::SUM) return false;  // the loop of the sum may come later
  if (is_leaf(in.op) || computed_[at(v)]) return true;
  if (is_load(in.op) || is_quotient(v) || plan_.root[at(v)] != kNone || chosen_[at(v)] != kNone ||
      plan_.once[at(v)] || plan_.loop[at(v)] >= 0 ||
      plan_.printed_region(plan_.region[at(v)]) != region)
    return false;
  bool all = true;
  for_each_operand(in, [&](Value o) { all = all && can_be_there(o, region); });
  return all;
}

void Emitter::make_it_there(Value v) {
  if (is_leaf(p_.instrs[at(v)].op) || computed_[at(v)]) return;
  for_each_operand(p_.instrs[at(v)], [&](Value o) { make_it_there(o); });
  compute(v);
  done_[at(v)] = 1;
}

void Emitter::quotients_together(Value v) {
  constexpr size_t kMost = 12;  // more values would take registers from other values
  if (!device_ || loop_ >= 0 || p_.contract || !is_quotient(v)) return;
  const int32_t region = plan_.printed_region(plan_.region[at(v)]);
  std::vector<Value> together = {v};
  for (const Step& step : plan_.steps) {
    const Value u = step.value;
    if (step.kind != Step::Kind::Compute || u == v || !is_quotient(u)) continue;
    if (!plan_.used[at(u)] || computed_[at(u)] || plan_.once[at(u)] || plan_.loop[at(u)] >= 0 ||
        plan_.printed_region(plan_.region[at(u)]) != region)
      continue;
    bool ready = together.size() < kMost;
    for_each_operand(p_.instrs[at(u)], [&](Value o) { ready = ready && can_be_there(o, region); });
    if (ready) together.push_back(u);
  }
  if (together.size() < 2) return;
  for (const Value u : together)
    for_each_operand(p_.instrs[at(u)], [&](Value o) { make_it_there(o); });
  const auto call = [&](Value u, const char* div, const char* sqrt, const std::string& last) {
    const Instr& in = p_.instrs[at(u)];
    line(text_.name(u) + " = " +
         (in.op == Op::DIV ? std::string(div) + "(" + text_.lanes(in.a) + ", " + text_.lanes(in.b)
                           : std::string(sqrt) + "(" + text_.lanes(in.a)) +
         last + ");");
  };
  const std::string magnitudes = "magnitudes" + str(v);
  line("magnitudes " + magnitudes + " = kNoMagnitudes;");
  for (const Value u : together) {
    if (!is_declared(u)) line(text_.c_type(u) + " " + text_.name(u) + ";");
    call(u, "quick_div", "quick_sqrt", ", " + magnitudes);
    computed_[at(u)] = done_[at(u)] = 1;
  }
  line("if (!are_moderate(" + magnitudes + ")) {");
  ++depth_;
  for (const Value u : together) call(u, "divided", "rooted", "");
  close();
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
