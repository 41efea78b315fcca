#include "novaphy/program/emit.h"

#include <cstdio>
#include <set>
#include <tuple>

#include "emit_kept.h"
#include "emit_plan.h"
#include "emit_values.h"

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }
std::string str(int64_t k) { return std::to_string(k); }

const char* access_name(Access access) {
  static constexpr const char* kNames[] = {"own row", "row 0 for all", "rows by index",
                                           "row of the CSR item", "row of the sum's step"};
  return kNames[static_cast<int>(access)];
}
const char* type_name(Type t) { return t == Type::F32 ? "f32" : "i32"; }
const char* letter(Type t) { return t == Type::F32 ? "f" : "i"; }

// A name in a comment must not end it or begin another line.
std::string one_line(const std::string& s) {
  std::string out;
  for (const char c : s) out += c == '\n' || c == '\r' || c == '\\' ? ' ' : c;
  return out;
}

class Emitter {
 public:
  explicit Emitter(const Program& program, bool device = false)
      : p_(program),
        plan_(make_emit_plan(program)),
        text_(program, plan_, device),
        device_(device),
        // A thread of a GPU has one row and few registers: there it is cheaper to compute again.
        kept_(device ? std::vector<KeptValues>{} : find_kept_values(program, plan_)),
        declared_(program.instrs.size(), 0),
        done_(program.instrs.size(), 0) {}

  std::string run(const std::string& function) {
    head(function);
    arguments();
    before_the_rows();
    line("for (; i + LANES <= last; i += LANES) {");
    ++depth_;
    steps();
    stores();
    close();
    line("return i;");
    close();
    return std::move(out_);
  }

  std::string run_device(const std::string& function) {
    head_comment();
    device_signature(function);
    loops_and_parameters();
    before_the_rows();
    steps();
    stores();
    close();
    return std::move(out_);
  }

 private:
  void line(const std::string& s) { out_.append(2 * at(depth_), ' ').append(s).append("\n"); }
  void close() {
    --depth_;
    line("}");
  }

  void head(const std::string& function) {
    head_comment();
    line("// Computes the rows [begin, end) in groups of LANES; returns the first that it left.");
    line("static int64_t " + function + "(const uint64_t* args, int64_t begin, int64_t end,");
    line("                  novaphy_error_sink* sink) {");
    ++depth_;
  }
  // How sources and outputs are reached is a type: memory, or the registers of the thread.
  void device_signature(const std::string& function) {
    std::string types, values;
    const auto add = [&](const char* type, const char* value, size_t k) {
      const std::string number = str(static_cast<int64_t>(k));
      types += (types.empty() ? "class " : ", class ") + (type + number);
      values += ", const " + (type + number) + " " + (value + number);
    };
    for (size_t s = 0; s < p_.sources.size(); ++s) add("S", "s", s);
    for (size_t o = 0; o < p_.outputs.size(); ++o) add("O", "o", o);
    line("// Computes row i.");
    line("template <" + types + ">");
    line("LANE_FN void " + function + "(const uint64_t* args" + values + ", const int64_t i,");
    line("                  row_failure& sink) {");
    ++depth_;
  }
  void head_comment() {
    char hash_text[24];
    std::snprintf(hash_text, sizeof(hash_text), "%016llx",
                  static_cast<unsigned long long>(hash(p_)));
    line("// " + one_line(p_.name));
    line("// Program " + std::string(hash_text) + ", " +
         str(static_cast<int64_t>(p_.instrs.size())) + " instructions. Argument words:");
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
  std::string extent_note(int32_t parameter) const {
    for (size_t l = 0; l < p_.loops.size(); ++l)
      if (p_.loops[l].kind == LoopKind::Fixed && p_.loops[l].extent_param == parameter)
        return ": the number of steps of sum " + str(static_cast<int64_t>(l));
    return {};
  }

  void arguments() {
    std::vector<char> read(p_.sources.size(), 0), own(p_.sources.size(), 0);
    for (const LoadGroup& g : plan_.groups) {
      read[at(g.source)] = 1;
      if (p_.instrs[at(g.row)].op == Op::INDEX) own[at(g.source)] = 1;
    }
    for (size_t s = 0; s < p_.sources.size(); ++s) {
      if (!read[s]) continue;
      const std::string k = str(static_cast<int64_t>(s));
      line("const char* const s" + k + " = (const char*)args[" + str(p_.source_argument(s)) + "];");
      line("const int64_t n" + k + " = (int64_t)args[" + str(p_.source_argument(s) + 1) + "];");
    }
    for (size_t o = 0; o < p_.outputs.size(); ++o)
      line("char* const o" + str(static_cast<int64_t>(o)) + " = (char*)args[" +
           str(p_.output_argument(o)) + "];");
    loops_and_parameters();
    for (const KeptValues& kept : kept_) {
      const std::string a = str(kept.loop), b = str(kept.earlier);
      line("const int same" + a + " = offsets" + a + " == offsets" + b + " && items" + a +
           " == items" + b + ";");
    }
    line("int64_t i = begin, last = end;");
    // Rows that a source lacks are left to the caller: a launch that runs into them is an error,
    // unless no lane needs them.
    for (size_t s = 0; s < p_.sources.size(); ++s)
      if (own[s]) {
        const std::string n = "n" + str(static_cast<int64_t>(s));
        line("if (" + n + " < last) last = " + n + ";");
      }
  }
  void loops_and_parameters() {
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
           (is_float ? " = uparam_f(args[" : " = uparam_i(args[") +
           str(p_.param_argument(at(in.a))) + "]);");
    }
  }

  void before_the_rows() {
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (plan_.used[v] && plan_.once[v]) compute(static_cast<Value>(v));
  }

  void steps() {
    std::vector<int32_t> closing;  // step at which each open `if` ends
    for (size_t s = 0; s <= plan_.steps.size(); ++s) {
      while (!closing.empty() && closing.back() <= static_cast<int32_t>(s)) {
        closing.pop_back();
        close();
      }
      if (s == plan_.steps.size()) break;
      const Step& step = plan_.steps[s];
      switch (step.kind) {
        case Step::Kind::LoopBegin:
          loop_begin(step.value);
          break;
        case Step::Kind::LoopEnd:
          loop_end(step.value);
          break;
        case Step::Kind::SkipIfNone:
          if (region_begin(plan_.regions[at(plan_.region_of_step[s])]))
            closing.push_back(step.target);
          break;
        case Step::Kind::Compute:
          if (plan_.used[at(step.value)] && !plan_.once[at(step.value)] && !done_[at(step.value)])
            compute(step.value);
          break;
      }
    }
  }

  bool in_csr_loop(int32_t l) const { return l >= 0 && p_.loops[at(l)].kind == LoopKind::Csr; }

  bool region_begin(const Region& region) {
    if (!region.printed) return false;
    for (const Value v : region.escape)
      line(text_.c_type(v) + " " + text_.name(v) + " = " + zero(v) + ";");
    std::string question = text_.name(region.cond);
    if (text_.uniform(region.cond)) {
      line("if (" + std::string(region.polarity ? "" : "!") + question + ") {");
    } else {
      if (!region.polarity) question = "vnot(" + question + ")";
      if (in_csr_loop(loop_)) question = "vand(" + question + ", on" + str(loop_) + ")";
      line("if (any(" + question + ")) {");
    }
    ++depth_;
    return true;
  }
  std::string zero(Value v) const {
    const Type t = text_.type(v);
    if (text_.uniform(v)) return t == Type::F32 ? "0.0f" : "0";
    return t == Type::F32 ? "splatf(0.0f)" : t == Type::I32 ? "splati(0)" : "splatb(0)";
  }

  void loop_begin(int32_t l) {
    loop_ = l;
    const std::string k = str(l);
    const Loop& loop = p_.loops[at(l)];
    for (size_t s = 0; s < loop.sums.size(); ++s)
      line("vf sum" + k + "_" + str(static_cast<int64_t>(s)) + " = " +
           text_.lanes(loop.sums[s].init) + ";");
    if (loop.kind == LoopKind::Csr) {
      csr_rows(l);
      line("for (int32_t r" + k + " = 0; r" + k + " < csr" + k + ".longest; ++r" + k + ") {");
      ++depth_;
      line("const vb on" + k + " = csr_on(&csr" + k + ", r" + k + ");");
      for (size_t v = 0; v < p_.instrs.size(); ++v)
        if (plan_.used[v] && p_.instrs[v].op == Op::SLOT && p_.instrs[v].a == l) {
          line("const vi slot" + k + " = csr_slot(&csr" + k + ", items" + k + ", r" + k + ", on" +
               k + ");");
          break;
        }
      for (const KeptValues& kept : kept_)
        if (kept.loop == l) read_kept(kept);
    } else {
      line("for (int32_t r" + k + " = 0; r" + k + " < extent" + k + "; ++r" + k + ") {");
      ++depth_;
    }
  }

  // Where this loop begins, and whether one that follows reads what this one computes.
  void csr_rows(int32_t l) {
    const std::string k = str(l);
    std::string begin = "csr_begin(offsets" + k + ", i)";
    for (const KeptValues& kept : kept_)
      if (kept.loop == l) begin = "same" + k + " ? csr" + str(kept.earlier) + " : " + begin;
    line("const csr_rows csr" + k + " = " + begin + ";");
    for (const KeptValues& kept : kept_) {
      if (kept.earlier != l) continue;
      const std::string later = str(kept.loop);
      line("const int keep" + later + " = same" + later + " && CAN_KEEP(csr" + k + ");");
      for (const auto& [value, equal] : kept.kept)
        line(text_.c_type(value) + " kept" + str(value) + "[KEPT_ITEMS];");
    }
  }
  void write_kept(const KeptValues& kept) {
    line("if (keep" + str(kept.loop) + ") {");
    ++depth_;
    for (const auto& [value, equal] : kept.kept)
      line("kept" + str(value) + "[r" + str(kept.earlier) + "] = " + text_.name(equal) + ";");
    close();
  }
  // What an earlier loop has kept for the item, or else all of it once more.
  void read_kept(const KeptValues& kept) {
    for (const auto& [value, equal] : kept.kept) {
      line(text_.c_type(value) + " " + text_.name(value) + ";");
      declared_[at(value)] = 1;
    }
    line("if (keep" + str(kept.loop) + ") {");
    ++depth_;
    for (const auto& [value, equal] : kept.kept)
      line(text_.name(value) + " = kept" + str(value) + "[r" + str(kept.loop) + "];");
    --depth_;
    line("} else {");
    ++depth_;
    const auto in_sight = looked_;
    for (const auto& [value, equal] : kept.equal) {
      compute(value);
      done_[at(value)] = 1;
    }
    looked_ = in_sight;
    close();
  }

  void loop_end(int32_t l) {
    const std::string k = str(l);
    const Loop& loop = p_.loops[at(l)];
    for (const KeptValues& kept : kept_)
      if (kept.earlier == l) write_kept(kept);
    for (size_t s = 0; s < loop.sums.size(); ++s) {
      const std::string sum = "sum" + k + "_" + str(static_cast<int64_t>(s));
      const std::string added = sum + " + " + text_.name(loop.sums[s].term);
      line(sum + " = " +
           (loop.kind == LoopKind::Csr ? "vselectf(on" + k + ", " + added + ", " + sum + ")"
                                       : added) +
           ";");
    }
    close();
    loop_ = -1;
  }

  void compute(Value v) {
    const Instr& in = p_.instrs[at(v)];
    if (is_leaf(in.op)) return;
    if (is_load(in.op)) return load(v, in);
    if (plan_.root[at(v)] != kNone) return limited_root(v, in);
    line(declaration(v) + " = " + text_.expression(v) + ";");
  }
  // c < sqrt(x) is false wherever x <= 0.999 c c: a group of such lanes needs no root.
  void limited_root(Value v, const Instr& in) {
    line((is_declared(v) ? "" : text_.c_type(v) + " ") + text_.name(v) + " = " + zero(v) + ";");
    if (in.op == Op::SQRT) return;
    const Value root = plan_.root[at(v)];
    const std::string x = text_.lanes(p_.instrs[at(root)].a);
    line("if (any(vlt(splatf(square_below(" + text_.name(in.a) + ")), " + x + "))) {");
    ++depth_;
    for (const Value k : {root, v}) line(text_.name(k) + " = " + text_.expression(k) + ";");
    close();
  }
  std::string declaration(Value v) const {
    return is_declared(v) ? text_.name(v) : "const " + text_.c_type(v) + " " + text_.name(v);
  }
  bool is_declared(Value v) const { return plan_.escapes[at(v)] || declared_[at(v)]; }

  // The lanes that need a load: those for which every condition around it holds.
  std::string need(Value v) const {
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

  void load(Value v, const Instr& in) {
    const int32_t number = plan_.group[at(v)];
    if (number < 0) {  // a column that its group's first value has loaded, or the same once more
      const Value first = column_owner(v, in);
      if (first != v) line(declaration(v) + " = " + text_.name(first) + ";");
      return;
    }
    const LoadGroup& group = plan_.groups[at(number)];
    const bool own = p_.instrs[at(group.row)].op == Op::INDEX;
    const bool scalar = text_.uniform(v);
    const int32_t width = p_.sources[at(group.source)].width;
    int32_t wanted = 0;
    for (const Value c : group.columns) wanted += c != kNone ? 1 : 0;
    const std::string s = "s" + str(group.source) + (device_ && !own ? ".p" : "");
    const std::string n = device_ ? "s" + str(group.source) + ".rows" : "n" + str(group.source);
    const std::string t = letter(p_.sources[at(group.source)].type);
    const std::string where = ", " + need(v) + ", " + str(group.source) + ", i, sink";
    if (scalar) {
      for (int32_t c = 0; c < width; ++c)
        if (const Value d = group.columns[at(c)]; d != kNone)
          line(declaration(d) + " = uload" + t + "(" + s + ", " + n + ", " + text_.name(group.row) +
               ", " + str(width) + ", " + str(c) + where + ");");
      return;
    }
    const std::string rows = own ? "" : rows_of(group.row, plan_.region[at(v)]);
    if (width >= 2 && width <= 4 && wanted >= 2) {
      std::string targets, fresh;
      for (int32_t c = 0; c < width; ++c) {
        const Value d = group.columns[at(c)];
        const std::string name = d != kNone ? text_.name(d) : "x" + str(v) + "_" + str(c);
        if (d == kNone || !is_declared(d)) fresh += (fresh.empty() ? "" : ", ") + name;
        targets += ", &" + name;
      }
      if (!fresh.empty()) line("v" + t + " " + fresh + ";");
      line(own && device_ ? "own" + str(width) + t + "(" + s + where + targets + ");"
           : own ? "load" + str(width) + t + "(" + s + " + " + str(4 * width) + " * i" + targets +
                       ");"
                 : "gather" + str(width) + t + "(" + s + ", " + n + ", &" + rows + where + targets +
                       ");");
      return;
    }
    for (int32_t c = 0; c < width; ++c) {
      const Value d = group.columns[at(c)];
      if (d == kNone) continue;
      line(declaration(d) + " = " +
           (own && device_
                ? "own_column" + t + "(" + s + ", " + str(width) + ", " + str(c) + where + ");"
            : own ? "load_column" + t + "(" + s + " + " + str(4 * width) + " * i" +
                        (c == 0 ? "" : " + " + str(4 * c)) + ", " + str(width) + ");"
                  : "gather_column" + t + "(" + s + ", " + n + ", &" + rows + ", " + str(width) +
                        ", " + str(c) + where + ");"));
    }
  }

  // The variable that says how the rows of a load lie: one that is in sight, else a new one.
  std::string rows_of(Value row, int32_t region) {
    const auto name = [&](int32_t r) { return "rows" + str(row) + "_" + str(r + 1); };
    for (int32_t r = region;; r = plan_.regions[at(r)].parent) {
      if (looked_.count({row, r, loop_}) != 0) return name(r);
      if (r < 0) break;
    }
    looked_.emplace(row, region, loop_);
    line("const row_lanes " + name(region) + " = look_at_rows(" + text_.lanes(row) + ");");
    return name(region);
  }

  Value column_owner(Value v, const Instr& in) const {
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

  void stores() {
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
      const std::string to = "o" + k + " + " + str(4 * width) + " * i";
      if (width >= 2 && width <= 4) {
        std::string values;
        for (const Value v : output.values) values += ", " + text_.lanes(v);
        line("store" + str(width) + t + "(" + to + values + ");");
        continue;
      }
      for (int32_t c = 0; c < width; ++c)
        line("store_column" + t + "(" + to + (c == 0 ? "" : " + " + str(4 * c)) + ", " +
             str(width) + ", " + text_.lanes(output.values[at(c)]) + ");");
    }
  }

  const Program& p_;
  const EmitPlan plan_;
  const ValueText text_;
  const bool device_;
  const std::vector<KeptValues> kept_;
  std::vector<char> declared_, done_;  // per value: before its computation; it too
  std::string out_;
  int32_t depth_ = 0, loop_ = -1;
  std::set<std::tuple<Value, int32_t, int32_t>> looked_;  // row, region, loop
};

}  // namespace

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

std::string emit_device(const Program& program, const std::string& function) {
  return Emitter(program, true).run_device(function);
}

}  // namespace nova::ir
