// The text of scans of launches.
#include <algorithm>

#include "emitter.h"

namespace nova::ir {

std::string Emitter::run_scan(const std::string& function, const Program* primal) {
  primal_ = primal;
  const std::string parameters =
      "(const novaphy_native_launches* all, int64_t begin,\n"
      "                  int64_t end, novaphy_error_sink* sink";
  line("// The same for launches that follow each other. `large`: they have scratch memory or notes.");
  line("LANE_FN int64_t " + function + "_rows" + parameters + ", const int large) {");
  ++depth_;
  line("const uint64_t* const args = all->args;");
  line("const int streams = large && all->streams;");
  arguments();
  before_the_rows();
  line("for (; i + LANES <= last; i += LANES) {");
  ++depth_;
  before_the_launches();
  line("char* const scratch = large ? group_scratch(all, i) : NULL;");
  line("char* const noted = large ? group_notes(all, i) : NULL;");
  const std::string width = word(launch_words());
  line("for (const uint64_t *launch = all->table, *const stop = launch + " + width +
       " * all->count; launch != stop; launch += " + width + ") {");
  ++depth_;
  if (primal) quiet_launch();
  std::string acted = "0";
  for (const Value v : limits()) acted += " | " + acted_bit(v);
  line("unsigned char acted = " + acted + ";");
  launch_sources();
  steps();
  if (!primal) note();
  stores();
  close();
  close();
  line("return i;");
  close();
  line("static int64_t " + function + parameters + ") {");
  ++depth_;
  const auto rows = [&](const char* large) {
    return function + "_rows(all, begin, end, sink, " + large + ")";
  };
  line("return all->scratch != NULL || all->notes != NULL ? " + rows("1"));
  line("                                               : " + rows("0") + ";");
  close();
  return std::move(out_);
}

bool Emitter::varies(int32_t source) const {
  return scan_ && std::count(scan_->varying.begin(), scan_->varying.end(), source) != 0;
}

int32_t Emitter::carrier(int32_t source) const {
  if (!scan_) return -1;
  const auto at_output = std::find(scan_->carried.begin(), scan_->carried.end(), source);
  return at_output == scan_->carried.end()
             ? -1
             : static_cast<int32_t>(at_output - scan_->carried.begin());
}

std::string Emitter::state(int32_t source, int32_t column) {
  return "state" + str(source) + "_" + str(column);
}

void Emitter::before_the_launches() {
  for (const Step& step : plan_.steps)
    if (step.kind == Step::Kind::Compute && held(step.value) && plan_.loop[at(step.value)] < 0)
      hold(step.value);
  for (size_t l = 0; l < p_.loops.size(); ++l)
    if (p_.loops[l].kind == LoopKind::Csr) hold_items(static_cast<int32_t>(l));
  for (const int32_t source : scan_->carried) load_state(source);
}

void Emitter::load_state(int32_t source) {
  const int32_t width = p_.sources[at(source)].width;
  const std::string t = letter(p_.sources[at(source)].type), s = "s" + str(source);
  std::string names, targets;
  for (int32_t c = 0; c < width; ++c) {
    names += (c == 0 ? "" : ", ") + state(source, c);
    targets += ", &" + state(source, c);
  }
  line("v" + t + " " + names + ";");
  const std::string from = s + " + " + str(4 * width) + " * i";
  if (width >= 2 && width <= 4) {
    line("load" + str(width) + t + "(" + from + targets + ");");
    return;
  }
  for (int32_t c = 0; c < width; ++c)
    line(state(source, c) + " = load_column" + t + "(" + from + (c == 0 ? "" : " + " + str(4 * c)) +
         ", " + str(width) + ");");
}

void Emitter::launch_sources() {
  if (primal_)
    line("const char* const near = " +
         launch_scratch(scratch_bytes(*primal_, find_scan(*primal_)->carried)) + ";");
  for (size_t k = 0; k < scan_->varying.size(); ++k) {
    const int32_t source = scan_->varying[k];
    line("const char* const s" + str(source) + " = (const char*)launch[" + word(k) + "];");
    if (quiet_) continue;
    line((near_bytes(source) < 0 ? "" : "if (near == NULL) ") +
         prefetch_rows(k, p_.sources[at(source)].width, "0"));
  }
}

std::string Emitter::prefetch_rows(size_t k, int32_t width, const char* write) const {
  return "prefetch_rows(launch[" + word(launch_words()) + " * PREFETCH_LAUNCHES + " + word(k) +
         "], " + str(4 * width) + ", i, " + write + ");";
}

void Emitter::put(size_t o) {
  const Output& output = p_.outputs[o];
  const auto width = static_cast<int32_t>(output.values.size());
  const std::string to = "o" + word(o);
  const size_t k = scan_->varying.size() + o;
  line("char* const " + to + " = (char*)launch[" + word(k) + "];");
  line("if (" + to + " != NULL) {");
  ++depth_;
  if (handed_over(output.type, width)) {
    line("if (!streams) " + prefetch_rows(k, width, "1"));
    line("put3f(" + own_column(to, 3, 0) + ", streams, " + text_.lanes(output.values[0]) + ", " +
         text_.lanes(output.values[1]) + ", " + text_.lanes(output.values[2]) + ");");
  } else {
    line(prefetch_rows(k, width, "1"));
    store(output, to);
  }
  close();
}

void Emitter::hold(Value v) {
  compute(v);
  done_[at(v)] = 1;
}

void Emitter::hold_items(int32_t l) {
  const std::string k = str(l);
  csr_rows(l);
  line("if (csr" + k + ".longest > KEPT_ITEMS) return i;");
  const std::vector<Value> values = held_items(l);
  for (const Value v : values) line(text_.c_type(v) + " held" + str(v) + "[KEPT_ITEMS];");
  // A row out of range may belong to a condition that never holds. The caller therefore runs groups
  // with such rows.
  line("novaphy_error_sink probe" + k + " = {INT64_MAX, 0, 0, 0};");
  loop_ = l;
  probes_ = true;
  item_begin(l);
  slot(l);
  for (const Step& step : plan_.steps)
    if (step.kind == Step::Kind::Compute && held(step.value) && plan_.loop[at(step.value)] == l)
      hold(step.value);
  for (const Value v : values) line("held" + str(v) + "[r" + k + "] = " + text_.name(v) + ";");
  close();
  line("if (probe" + k + ".index != INT64_MAX) return i;");
  loop_ = -1;
  probes_ = false;
  std::erase_if(looked_, [l](const auto& key) { return std::get<2>(key) == l; });
}

std::vector<Value> Emitter::held_items(int32_t l) const {
  std::vector<char> read(p_.instrs.size(), 0);
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (plan_.used[v] && !held(static_cast<Value>(v)))
      for_each_operand(p_.instrs[v], [&](Value o) { read[at(o)] = 1; });
  for (const Region& r : plan_.regions) read[at(r.cond)] = 1;
  for (const Sum& s : p_.loops[at(l)].sums) read[at(s.term)] = 1;
  std::vector<Value> values;
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (read[v] && (is_slot(v, l) || (held(static_cast<Value>(v)) && plan_.loop[v] == l)))
      values.push_back(static_cast<Value>(v));
  return values;
}

}  // namespace nova::ir
