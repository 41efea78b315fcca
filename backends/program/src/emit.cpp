#include "novaphy/program/emit.h"

#include <algorithm>
#include <cstdio>

#include "emit_held.h"
#include "emit_order.h"
#include "emit_simplify.h"
#include "emitter.h"

namespace nova::ir {
namespace {

const char* access_name(Access access) {
  static constexpr const char* kNames[] = {"own row", "row 0 for all", "rows by index",
                                           "row of the CSR item", "row of the sum's step"};
  return kNames[static_cast<int>(access)];
}
const char* type_name(Type t) { return t == Type::F32 ? "f32" : "i32"; }

// Replaces characters that could end a comment or begin another line.
std::string one_line(const std::string& s) {
  std::string out;
  for (const char c : s) out += c == '\n' || c == '\r' || c == '\\' ? ' ' : c;
  return out;
}

// Elements have long formulas with prefetched rows. Regions split the code, and most are taken.
constexpr int32_t kMinElementRegion = 20;
EmitPlan plan_for(const Program& p, bool device, bool scan) {
  EmitPlan plan = make_emit_plan(p, device);
  const bool elements = !device && !scan && find_prefetched_gathers(p, plan).table >= 0;
  return elements ? ordered(p, make_emit_plan(p, device, kMinElementRegion)) : std::move(plan);
}

}  // namespace

Emitter::Emitter(const Program& program, bool device, const Scan* scan, std::vector<char> items)
    : original_(program),
      p_(device ? program : simplified(program)),
      plan_(plan_for(p_, device, scan != nullptr)),
      text_(p_, plan_, device),
      device_(device),
      scan_(scan),
      // A GPU thread has one row and few registers, so computing values again costs less.
      held_(scan ? find_held_values(p_, plan_, *scan) : std::vector<char>{}),
      kept_(device ? std::vector<KeptValues>{} : find_kept_values(p_, plan_)),
      items_(std::move(items)),
      declared_(program.instrs.size(), 0),
      done_(program.instrs.size(), 0),
      computed_(program.instrs.size(), 0),
      chosen_(program.instrs.size(), kNone) {
  for (KeptValues& kept : kept_)
    for (auto* values : {&kept.kept, &kept.equal})
      std::erase_if(*values, [this](const auto& pair) { return held(pair.first); });
  if (!device_) idle_ = find_idle_items(p_, plan_, kept_);
  if (!device_ && !scan_)
    for (FollowedItem& item : find_followed_items(p_, plan_))
      if (adds_nothing(item.idle)) followed_.push_back(std::move(item));
  // Prefetching reads rows of the next group before the results of this group are written.
  if (!device_ && !scan_ && may_run_again()) prefetch_ = find_prefetched_gathers(p_, plan_);
}

std::string Emitter::run(const std::string& function) {
  head(function);
  arguments();
  if (adds_rows_only()) {
    sums_of_rows();
  } else {
    before_the_rows();
    prefetch_begin();
    groups_begin();
    steps();
    stores();
    groups_end();
    line("return i;");
  }
  close();
  return std::move(out_);
}

std::string Emitter::run_device(const std::string& function) {
  head_comment();
  device_signature(function);
  loops_and_parameters();
  before_the_rows();
  steps();
  stores();
  close();
  return std::move(out_);
}

void Emitter::close() {
  --depth_;
  line("}");
}

void Emitter::head(const std::string& function) {
  head_comment();
  line("// Computes the rows [begin, end) in groups of LANES; returns the first that it left.");
  line("static int64_t " + function + "(const uint64_t* args, int64_t begin, int64_t end,");
  line("                  novaphy_error_sink* sink) {");
  ++depth_;
}

void Emitter::device_signature(const std::string& function) {
  std::string types = "class Args", values;
  const auto add = [&](const char* type, const char* value, size_t k) {
    const std::string number = str(static_cast<int64_t>(k));
    types += ", class " + (type + number);
    values += ", const " + (type + number) + " " + (value + number);
  };
  for (size_t s = 0; s < p_.sources.size(); ++s) add("S", "s", s);
  for (size_t o = 0; o < p_.outputs.size(); ++o) add("O", "o", o);
  if (!items_.empty()) {
    types += ", class Kept";
    values += ", const Kept& kept";
  }
  line("// Computes row i.");
  line("template <" + types + ">");
  line("LANE_FN void " + function + "(const Args args" + values + ", const int64_t i,");
  line("                  row_failure& sink) {");
  ++depth_;
}

void Emitter::head_comment() {
  char hash_text[24];
  std::snprintf(hash_text, sizeof(hash_text), "%016llx",
                static_cast<unsigned long long>(hash(original_)));
  line("// " + one_line(p_.name));
  line("// Program " + std::string(hash_text) + ", " + str(static_cast<int64_t>(p_.instrs.size())) +
       " instructions. Argument words:");
  const auto argument = [&](uint32_t word, const std::string& what) {
    line("//   " + str(word) + "  " + what);
  };
  for (size_t s = 0; s < p_.sources.size(); ++s) {
    const Source& source = p_.sources[s];
    argument(p_.source_argument(s), one_line(source.name) + ": " + type_name(source.type) + "{" +
                                        str(source.width) + "}, " + access_name(source.access) +
                                        "; " + str(p_.source_argument(s) + 1) + "  its rows");
  }
  for (size_t o = 0; o < p_.outputs.size(); ++o)
    argument(p_.output_argument(o),
             "out " + one_line(p_.outputs[o].name) + ": " + type_name(p_.outputs[o].type) + "{" +
                 str(static_cast<int64_t>(p_.outputs[o].values.size())) + "}");
  for (size_t l = 0; l < p_.loops.size(); ++l)
    if (p_.loops[l].kind == LoopKind::Csr)
      argument(p_.loop_argument(l), "sum " + str(static_cast<int64_t>(l)) + ": CSR offsets; " +
                                        str(p_.loop_argument(l) + 1) + "  its items");
  for (int32_t k = 0; k < p_.param_count; ++k)
    argument(p_.param_argument(at(k)), "parameter " + str(k) + extent_note(k));
}

std::string Emitter::extent_note(int32_t parameter) const {
  for (size_t l = 0; l < p_.loops.size(); ++l)
    if (p_.loops[l].kind == LoopKind::Fixed && p_.loops[l].extent_param == parameter)
      return ": the number of steps of sum " + str(static_cast<int64_t>(l));
  return {};
}

void Emitter::arguments() {
  std::vector<char> read(p_.sources.size(), 0), own(p_.sources.size(), 0);
  for (const LoadGroup& g : plan_.groups) {
    read[at(g.source)] = 1;
    if (p_.instrs[at(g.row)].op == Op::INDEX) own[at(g.source)] = 1;
  }
  for (size_t s = 0; s < p_.sources.size(); ++s) {
    if (!read[s]) continue;
    const std::string k = str(static_cast<int64_t>(s));
    if (!varies(static_cast<int32_t>(s)))
      line("const char* const s" + k + " = (const char*)args[" + str(p_.source_argument(s)) + "];");
    line("const int64_t n" + k + " = (int64_t)args[" + str(p_.source_argument(s) + 1) + "];");
  }
  for (size_t o = 0; o < p_.outputs.size() && !scan_; ++o)
    line("char* const out" + str(static_cast<int64_t>(o)) + " = (char*)args[" +
         str(p_.output_argument(o)) + "];");
  loops_and_parameters();
  for (const KeptValues& kept : kept_) {
    const std::string a = str(kept.loop), b = str(kept.earlier);
    line("const int same" + a + " = offsets" + a + " == offsets" + b + " && items" + a +
         " == items" + b + ";");
  }
  line("int64_t i = begin, last = end;");
  // The function stops at rows that a source lacks, and the caller computes these rows. Such a
  // launch is an error, unless no lane needs the missing rows.
  for (size_t s = 0; s < p_.sources.size(); ++s)
    if (own[s]) {
      const std::string n = "n" + str(static_cast<int64_t>(s));
      line("if (" + n + " < last) last = " + n + ";");
    }
}

void Emitter::loops_and_parameters() {
  for (size_t l = 0; l < p_.loops.size(); ++l) {
    const std::string k = str(static_cast<int64_t>(l));
    if (p_.loops[l].kind == LoopKind::Csr) {
      line("const int32_t* const offsets" + k + " = (const int32_t*)args[" +
           str(p_.loop_argument(l)) + "];");
      line("const int32_t* const items" + k + " = (const int32_t*)args[" +
           str(p_.loop_argument(l) + 1) + "];");
    } else {
      line("const int32_t extent" + k + " = uparam_i(args[" +
           str(p_.param_argument(at(p_.loops[l].extent_param))) + "]);");
    }
  }
  std::vector<char> known(at(p_.param_count) * 2, 0);
  for (size_t v = 0; v < p_.instrs.size(); ++v) {
    const Instr& in = p_.instrs[v];
    if (!plan_.used[v] || (in.op != Op::PARAM_F && in.op != Op::PARAM_I)) continue;
    const bool is_float = in.op == Op::PARAM_F;
    char& done = known[2 * at(in.a) + (is_float ? 1 : 0)];
    if (done) continue;
    done = 1;
    line(std::string(is_float ? "const float pf" : "const int32_t pi") + str(in.a) +
         (is_float ? " = uparam_f(args[" : " = uparam_i(args[") + str(p_.param_argument(at(in.a))) +
         "]);");
  }
}

void Emitter::before_the_rows() {
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (plan_.used[v] && plan_.once[v]) compute(static_cast<Value>(v));
  std::set<Value> limits;
  for (size_t v = 0; v < p_.instrs.size(); ++v)
    if (plan_.used[v] && plan_.root[v] != kNone && p_.instrs[v].op == Op::LT)
      limits.insert(p_.instrs[v].a);
  for (const Value v : limits)
    line("const float below" + str(v) + " = square_below(" + text_.name(v) + ");");
}

void Emitter::steps() {
  loads_first(-1);
  std::vector<std::pair<int32_t, int32_t>> closing;  // end step of each open `if`, region
  size_t begin = 0;                                  // first step of the current loop
  for (size_t s = 0; s <= plan_.steps.size(); ++s) {
    while (!closing.empty() && closing.back().first <= static_cast<int32_t>(s)) {
      prefetch_end(closing.back().second);
      closing.pop_back();
      close();
    }
    if (s == plan_.steps.size()) break;
    const Step& step = plan_.steps[s];
    switch (step.kind) {
      case Step::Kind::LoopBegin:
        if (quiet_) {  // in a quiet launch (emit_fast_path.cpp) all items are idle
          begin_sums(step.value);
          while (plan_.steps[s].kind != Step::Kind::LoopEnd) ++s;
          break;
        }
        begin = s;
        loop_begin(step.value);
        break;
      case Step::Kind::LoopEnd:
        loop_end(step.value);
        if (!in_items_) break;
        in_items_ = false;  // now for items that are not in registers
        looked_ = looked_before_;
        for (size_t v = 0; v < p_.instrs.size(); ++v)
          if (plan_.loop[v] == step.value) computed_[v] = 0, chosen_[v] = kNone;
        loop_begin(step.value);
        s = begin;
        break;
      case Step::Kind::SkipIfNone:
        if (region_begin(plan_.region_of_step[s])) {
          closing.emplace_back(step.target, plan_.region_of_step[s]);
          loads_first(plan_.region_of_step[s]);
        }
        break;
      case Step::Kind::Compute:
        if (plan_.used[at(step.value)] && !plan_.once[at(step.value)] && !done_[at(step.value)])
          quotients_together(step.value);
        if (plan_.used[at(step.value)] && !plan_.once[at(step.value)] && !done_[at(step.value)])
          compute(step.value), prefetch_line(step.value);
        break;
    }
  }
  prefetch_end(-1);
}

std::string Emitter::zero(Value v) const {
  const Type t = text_.type(v);
  if (text_.uniform(v)) return t == Type::F32 ? "0.0f" : "0";
  return t == Type::F32 ? "splatf(0.0f)" : t == Type::I32 ? "splati(0)" : "splatb(0)";
}

void Emitter::compute(Value v) {
  const Instr& in = p_.instrs[at(v)];
  if (is_leaf(in.op)) return;
  computed_[at(v)] = 1;
  if (chosen_[at(v)] != kNone) {
    line(declaration(v) + " = " + text_.name(chosen_[at(v)]) + ";");
    return;
  }
  if (is_load(in.op)) return load(v, in);
  if (plan_.root[at(v)] != kNone) return limited_root(v, in);
  line(declaration(v) + " = " + text_.expression(v) + ";");
}

void Emitter::limited_root(Value v, const Instr& in) {
  line((is_declared(v) ? "" : text_.c_type(v) + " ") + text_.name(v) + " = " + zero(v) + ";");
  if (in.op == Op::SQRT || quiet_) return;
  const Value root = plan_.root[at(v)];
  const std::string x = text_.lanes(p_.instrs[at(root)].a);
  const std::string question = "any(vlt(splatf(below" + str(in.a) + "), " + x + "))";
  if (scan_) line("acted &= ~" + acted_bit(v) + ";");
  line("if (" + (device_ ? question : "rarely(" + question + ")") + ") {");
  ++depth_;
  for (const Value k : {root, v}) line(text_.name(k) + " = " + text_.expression(k) + ";");
  if (scan_) line("acted |= " + acted_bit(v) + ";");
  close();
}

std::string Emitter::declaration(Value v) const {
  return is_declared(v) ? text_.name(v) : "const " + text_.c_type(v) + " " + text_.name(v);
}

std::string Emitter::need(Value v) const {
  std::string text;
  const auto also = [&](const std::string& s) {
    text = text.empty() ? s : "vand(" + text + ", " + s + ")";
  };
  if (in_csr_loop(plan_.loop[at(v)])) also("on" + str(plan_.loop[at(v)]));
  for (int32_t r = plan_.region[at(v)]; r >= 0; r = plan_.regions[at(r)].parent) {
    const Region& region = plan_.regions[at(r)];
    also(region.polarity ? text_.lanes(region.cond) : "vnot(" + text_.lanes(region.cond) + ")");
  }
  return text.empty() ? "splatb(1)" : text;
}

void Emitter::load(Value v, const Instr& in) {
  const int32_t number = plan_.group[at(v)];
  if (number < 0) {  // a column loaded with the first value of its group, or a repeated load
    const Value first = column_owner(v, in);
    if (first != v) line(declaration(v) + " = " + text_.name(first) + ";");
    return;
  }
  const LoadGroup& group = plan_.groups[at(number)];
  if (carrier(group.source) >= 0) {
    for (size_t c = 0; c < group.columns.size(); ++c)
      if (const Value d = group.columns[c]; d != kNone)
        line(declaration(d) + " = " + state(group.source, static_cast<int32_t>(c)) + ";");
    return;
  }
  const bool own = p_.instrs[at(group.row)].op == Op::INDEX;
  const bool scalar = text_.uniform(v);
  const int32_t width = p_.sources[at(group.source)].width;
  int32_t wanted = 0;
  for (const Value c : group.columns) wanted += c != kNone ? 1 : 0;
  const std::string s = "s" + str(group.source);
  // On a device, the emitted type of a source knows its number of rows. On the CPU, n is an argument.
  const std::string table = is_item(group.source) ? "source_item{kept." + s + " + r" + str(loop_) +
                                                        " * " + str(width) + "}"
                            : device_ ? s
                                      : s + ", n" + str(group.source);
  const std::string t = letter(p_.sources[at(group.source)].type);
  const std::string where = ", " + (probes_ ? "on" + str(loop_) : need(v)) + ", " +
                            str(group.source) + ", i, " +
                            (probes_ ? "&probe" + str(loop_) : "sink");
  if (const int32_t first = prefetch_column(group); first >= 0)
    return prefetch_load(v, group, first, where);
  if (scalar) {
    for (int32_t c = 0; c < width; ++c)
      if (const Value d = group.columns[at(c)]; d != kNone)
        line(declaration(d) + " = uload" + t + "(" + table + ", " + text_.name(group.row) + ", " +
             str(width) + ", " + str(c) + where + ");");
    return;
  }
  const std::string rows = own ? "" : rows_of(group.row, plan_.region[at(v)]);
  if (width >= 2 && width <= 4 && wanted >= 2) {
    const std::string targets = columns(v, group, 0, 0, width);
    if (const int32_t bytes = near_bytes(group.source); own && bytes >= 0) {
      line("take3f(" + own_column(s, 3, 0) + ", near, " + str(bytes) + " * LANES" + targets + ");");
      return;
    }
    line(own && device_ ? "own" + str(width) + t + "(" + s + where + targets + ");"
         : own
             ? "load" + str(width) + t + "(" + s + " + " + str(4 * width) + " * i" + targets + ");"
             : "gather" + str(width) + t + "(" + table + ", &" + rows + where + targets + ");");
    return;
  }
  for (int32_t c = 0; c < width; ++c) {
    const Value d = group.columns[at(c)];
    if (d == kNone) continue;
    if (const int32_t first = four_columns(c, width); own && !device_ && first >= 0) {
      const auto begin = group.columns.begin();
      if (std::count(begin + c, begin + first + 4, kNone) <= first + 2 - c) {  // at least two
        line("load_columns4" + t + "(" + own_column(s, width, first) + ", " + str(width) +
             columns(v, group, c, first, 4) + ");");
        c = first + 3;
        continue;
      }
    }
    line(declaration(d) + " = " +
         (own && device_
              ? "own_column" + t + "(" + s + ", " + str(width) + ", " + str(c) + where + ");"
          : own ? "load_column" + t + "(" + own_column(s, width, c) + ", " + str(width) + ");"
                : "gather_column" + t + "(" + table + ", &" + rows + ", " + str(width) + ", " +
                      str(c) + where + ");"));
  }
}

std::string Emitter::rows_of(Value row, int32_t region) {
  const auto name = [&](int32_t r) { return "rows" + str(row) + "_" + str(r + 1); };
  for (int32_t r = region;; r = plan_.regions[at(r)].parent) {
    if (looked_.count({row, r, loop_}) != 0) return name(r);
    if (r < 0) break;
  }
  looked_.emplace(row, region, loop_);
  line("const row_lanes " + name(region) + " = look_at_rows(" + text_.lanes(row) + ");");
  return name(region);
}

Value Emitter::column_owner(Value v, const Instr& in) const {
  for (const LoadGroup& g : plan_.groups) {
    if (g.source != in.a || g.row != in.b) continue;
    const Value owner = g.columns[at(in.c)];
    if (owner != kNone && plan_.loop[at(owner)] == plan_.loop[at(v)] &&
        plan_.region[at(owner)] == plan_.region[at(v)] &&
        plan_.once[at(owner)] == plan_.once[at(v)])
      return owner;
  }
  return v;
}

void Emitter::stores() {
  for (size_t o = 0; o < p_.outputs.size(); ++o) {
    const Output& output = p_.outputs[o];
    const auto width = static_cast<int32_t>(output.values.size());
    const std::string k = str(static_cast<int64_t>(o)), t = letter(output.type);
    if (device_) {
      for (int32_t c = 0; c < width; ++c)
        line("put_column" + t + "(o" + k + ", " + str(width) + ", " + str(c) + ", i, " +
             text_.lanes(output.values[at(c)]) + ");");
      continue;
    }
    if (scan_) {
      put(o);
      continue;
    }
    store(output, "o" + k);
  }
  if (!scan_) return;
  for (size_t o = 0; o < p_.outputs.size(); ++o)
    for (size_t c = 0; c < p_.outputs[o].values.size(); ++c)
      line(state(scan_->carried[o], static_cast<int32_t>(c)) + " = " +
           text_.lanes(p_.outputs[o].values[c]) + ";");
}

void Emitter::store(const Output& output, const std::string& array) {
  const auto width = static_cast<int32_t>(output.values.size());
  const std::string t = letter(output.type);
  const auto values = [&](int32_t first, int32_t count) {
    std::string list;
    for (int32_t c = first; c < first + count; ++c)
      list += ", " + text_.lanes(output.values[at(c)]);
    return list;
  };
  const bool corners = output.type == Type::F32 && (width == 9 || width == 12);
  if ((width >= 2 && width <= 4) || corners) {
    const std::string text =
        "store" + str(width) + t + "(" + own_column(array, width, 0) + values(0, width) + ");";
    const int32_t region = zero_without(output);
    if (region < 0) return line(text);
    line("if (took" + str(region) + ") {");
    line("  " + text);
    line("} else {");
    line("  store_zeros(" + own_column(array, width, 0) + ", " + str(width) + ");");
    line("}");
    return;
  }
  for (int32_t c = 0; c < width; ++c) {
    const int32_t first = four_columns(c, width);
    const std::string to = own_column(array, width, first < 0 ? c : first) + ", " + str(width);
    line(first < 0 ? "store_column" + t + "(" + to + values(c, 1) + ");"
                   : "store_columns4" + t + "(" + to + values(first, 4) + ");");
    if (first >= 0) c = first + 3;
  }
}

std::string c_function_name(const Program& program) {
  std::string name;
  for (const char c : program.name) {
    const bool legal = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
    name += legal ? c : '_';
  }
  if (name.size() > 60) name.resize(60);
  char hash_text[24];
  std::snprintf(hash_text, sizeof(hash_text), "_%016llx",
                static_cast<unsigned long long>(hash(program)));
  return "k_" + name + hash_text;
}

std::string emit_c(const Program& program, const std::string& function) {
  return Emitter(program).run(function.empty() ? c_function_name(program) : function);
}

std::string emit_c_scan(const Program& program, const Scan& scan, const std::string& function,
                        const Program* primal) {
  return Emitter(program, false, &scan).run_scan(function, primal);
}

std::string emit_device(const Program& program, const std::string& function,
                        const std::vector<char>& items) {
  return Emitter(program, true, nullptr, items).run_device(function);
}

}  // namespace nova::ir
