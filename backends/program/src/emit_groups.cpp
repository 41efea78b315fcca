// The groups of rows in the text, especially the last group, and the columns of wide rows.
#include <algorithm>

#include "emitter.h"

namespace nova::ir {

void Emitter::groups_begin() {
  tail_ = may_run_again();
  line(tail_ ? "for (; i < last && last - begin >= LANES; i += LANES) {"
             : "for (; i + LANES <= last; i += LANES) {");
  ++depth_;
  if (tail_) {
    line("const int64_t done = i;");
    line("if (i + LANES > last) i = last - LANES;");
  }
  for (size_t o = 0; o < p_.outputs.size(); ++o) {
    const std::string k = str(static_cast<int64_t>(o)), bytes = output_bytes(o);
    if (tail_) line("char scratch" + k + "[LANES * " + bytes + "];");
    line("char* const o" + k + " = " +
         (tail_ ? "i == done ? out" + k + " : scratch" + k + " - " + bytes + " * i" : "out" + k) +
         ";");
  }
  prefetch_group();
}

void Emitter::groups_end() {
  for (size_t o = 0; o < p_.outputs.size() && tail_; ++o) {
    const std::string k = str(static_cast<int64_t>(o));
    line("if (i != done) copy_tail(out" + k + ", scratch" + k + ", " + output_bytes(o) +
         ", i, done);");
  }
  close();
}

std::string Emitter::output_bytes(size_t o) const {
  return str(static_cast<int64_t>(4 * p_.outputs[o].values.size()));
}

bool Emitter::may_run_again() const {
  std::vector<char> names_row(p_.instrs.size(), 0);
  for (size_t v = p_.instrs.size(); v-- > 0;) {
    const Instr& in = p_.instrs[v];
    if (is_load(in.op)) {
      names_row[at(in.b)] = 1;
      const bool own = p_.instrs[at(in.b)].op == Op::INDEX;
      const Type type = p_.sources[at(in.a)].type;
      const bool written = std::any_of(p_.outputs.begin(), p_.outputs.end(),
                                       [type](const Output& o) { return o.type == type; });
      if (own && names_row[v] && written) return false;
    } else if (names_row[v]) {
      for_each_operand(in, [&](Value o) { names_row[at(o)] = 1; });
    }
  }
  return true;
}

std::string Emitter::own_column(const std::string& array, int32_t width, int32_t column) {
  return array + " + " + str(4 * width) + " * i" + (column == 0 ? "" : " + " + str(4 * column));
}

int32_t Emitter::four_columns(int32_t column, int32_t width) {
  if (width <= 4 || column + 1 >= width) return -1;
  return std::min(column, width - 4);
}

std::string Emitter::columns(Value v, const LoadGroup& group, int32_t fresh, int32_t first,
                             int32_t count) {
  std::string targets, declared;
  for (int32_t c = first; c < first + count; ++c) {
    const Value d = c < fresh ? kNone : group.columns[at(c)];
    const std::string unused = "x" + str(v) + "_" + str(c) + (c < fresh ? "_again" : "");
    const std::string name = d != kNone ? text_.name(d) : unused;
    if (d == kNone || !is_declared(d)) declared += (declared.empty() ? "" : ", ") + name;
    targets += ", &" + name;
  }
  const std::string t = letter(p_.sources[at(group.source)].type);
  if (!declared.empty()) line("v" + t + " " + declared + ";");
  return targets;
}

}  // namespace nova::ir
