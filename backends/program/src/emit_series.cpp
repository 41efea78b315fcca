// The emitter's functions for series of launches.
#include <algorithm>

#include "emitter.h"

namespace nova::ir {

std::string Emitter::run_series(const std::string& function) {
  line("// The same for `count` launches, one after the other.");
  line("static int64_t " + function + "(const uint64_t* args, const uint64_t* launches,");
  line("                  int64_t count, int64_t begin, int64_t end, novaphy_error_sink* sink) {");
  ++depth_;
  arguments();
  before_the_rows();
  line("for (; i + LANES <= last; i += LANES) {");
  ++depth_;
  before_the_launches();
  const std::string width = str(static_cast<int64_t>(launch_words()));
  line("for (const uint64_t *launch = launches, *const stop = launches + " + width +
       " * count; launch != stop; launch += " + width + ") {");
  ++depth_;
  for (size_t k = 0; k < series_->varying.size(); ++k) {
    const int32_t source = series_->varying[k];
    line("const char* const s" + str(source) + " = (const char*)launch[" +
         str(static_cast<int64_t>(k)) + "];");
    fetch_early(k, p_.sources[at(source)].width, "0");
  }
  steps();
  stores();
  close();
  close();
  line("return i;");
  close();
  return std::move(out_);
}

bool Emitter::varies(int32_t source) const {
  return series_ && std::count(series_->varying.begin(), series_->varying.end(), source) != 0;
}

int32_t Emitter::carrier(int32_t source) const {
  if (!series_) return -1;
  const auto at_output = std::find(series_->carried.begin(), series_->carried.end(), source);
  return at_output == series_->carried.end()
             ? -1
             : static_cast<int32_t>(at_output - series_->carried.begin());
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
  for (const int32_t source : series_->carried) load_state(source);
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

void Emitter::fetch_early(size_t k, int32_t width, const char* write) {
  line("fetch_early(launch[" + str(static_cast<int64_t>(launch_words())) + " * LAUNCHES_AHEAD + " +
       str(static_cast<int64_t>(k)) + "], " + str(4 * width) + ", i, " + write + ");");
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
  loop_ = l;
  item_begin(l);
  slot(l);
  for (const Step& step : plan_.steps)
    if (step.kind == Step::Kind::Compute && held(step.value) && plan_.loop[at(step.value)] == l)
      hold(step.value);
  for (const Value v : values) line("held" + str(v) + "[r" + k + "] = " + text_.name(v) + ";");
  close();
  loop_ = -1;
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
