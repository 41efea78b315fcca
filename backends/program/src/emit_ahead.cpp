#include "emit_ahead.h"

#include <algorithm>
#include <map>

#include "emitter.h"

namespace nova::ir {
namespace {

// One gather alone is not worth the room that it takes.
constexpr size_t kFewestGathers = 2;

bool has(const auto& list, const auto& item) {
  return std::find(list.begin(), list.end(), item) != list.end();
}

// The group of loads, at the own row whatever holds, that the value is a column of; -1: of none.
int32_t table_of(const Program& p, const EmitPlan& plan, Value v) {
  for (size_t g = 0; g < plan.groups.size(); ++g) {
    const LoadGroup& group = plan.groups[g];
    const int32_t width = p.sources[at(group.source)].width;
    if (width >= 2 && width <= 4 && p.sources[at(group.source)].type == Type::I32 &&
        p.instrs[at(group.row)].op == Op::INDEX && plan.region[at(v)] < 0 && has(group.columns, v))
      return static_cast<int32_t>(g);
  }
  return -1;
}

// Where most of the arithmetic is: a printed region, or -1, and its weight.
void find_scope(const Program& p, const EmitPlan& plan, AheadGathers& out) {
  std::map<int32_t, int32_t> weights;
  for (size_t v = 0; v < p.instrs.size(); ++v)
    if (const int32_t region = plan.printed_region(plan.region[v]);
        plan.is_line(v, p.instrs[v].op) &&
        (region < 0 || plan.printed_region(plan.regions[at(region)].parent) < 0))
      weights[region] += weight(p.instrs[v].op);
  for (const auto& [region, total] : weights)
    if (total > out.weight) out.scope = region, out.weight = total;
}

// Whether the group is loaded wherever the scope is computed. Others wait for their own condition,
// as velocities do that only a damping needs.
bool in_scope(const EmitPlan& plan, const LoadGroup& group, int32_t scope) {
  const Value first =
      *std::find_if(group.columns.begin(), group.columns.end(), [](Value v) { return v != kNone; });
  const int32_t region = plan.printed_region(plan.region[at(first)]);
  return region < 0 || region == scope;
}

}  // namespace

AheadGathers find_ahead_gathers(const Program& p, const EmitPlan& plan) {
  AheadGathers out;
  if (!p.loops.empty()) return out;
  find_scope(p, plan, out);
  for (const LoadGroup& group : plan.groups) {
    const Source& source = p.sources[at(group.source)];
    if (source.type != Type::F32 || source.width != 3) continue;
    const int32_t table = table_of(p, plan, group.row);
    if (table < 0 || (out.table >= 0 && out.table != table)) continue;
    if (!in_scope(plan, group, out.scope)) continue;
    out.table = table;
    if (!has(out.rows, group.row)) out.rows.push_back(group.row);
    if (const std::pair gather{group.source, group.row}; !has(out.gathers, gather))
      out.gathers.push_back(gather);
  }
  if (out.gathers.size() < kFewestGathers) return {};
  return out;
}

int32_t Emitter::ahead_column(const LoadGroup& group) const {
  const auto& gathers = ahead_.gathers;
  const auto found = std::find(gathers.begin(), gathers.end(), std::pair{group.source, group.row});
  return found == gathers.end() ? -1 : 3 * static_cast<int32_t>(found - gathers.begin());
}

// Row k is where the next group begins.
void Emitter::ahead_begin() {
  if (ahead_.table < 0) return;
  const LoadGroup& table = plan_.groups[at(ahead_.table)];
  const int32_t width = p_.sources[at(table.source)].width;
  std::string targets, names;
  for (int32_t c = 0; c < width; ++c) {
    const Value d = table.columns[at(c)];
    const std::string name = d != kNone ? "next" + str(d) : "unused" + str(c);
    targets += ", &" + name;
    names += (names.empty() ? "" : ", ") + name;
    if (d != kNone) done_[at(d)] = 1;
  }
  ahead_text_.push_back("load" + str(width) + "i(s" + str(table.source) + " + " + str(4 * width) +
                        " * k" + targets + ");");
  for (const Value row : ahead_.rows)
    ahead_text_.push_back("odd |= look_ahead(&ahead" + str(row) + ", next" + str(row) +
                          ", limit);");
  std::string rows = "rows_ahead ", separator, sources;
  for (const Value row : ahead_.rows) rows += separator + "ahead" + str(row), separator = ", ";
  std::vector<int32_t> gathered;
  for (const auto& [source, row] : ahead_.gathers) {
    const std::string c = str(ahead_column({source, row, {}}));
    ahead_text_.push_back("gather3f_ahead(s" + str(source) + ", &ahead" + str(row) + ", next + " +
                          c + ");");
    if (!has(gathered, source)) gathered.push_back(source);
  }
  const std::string count = str(static_cast<int64_t>(3 * ahead_.gathers.size()));
  line(
      "// Rows through the table are gathered one group ahead: [here] is this one's, [next] the "
      "one's at k.");
  line("int64_t fewest = n" + str(gathered[0]) + ";");
  for (const int32_t source : gathered)
    if (source != gathered[0])
      line("if (n" + str(source) + " < fewest) fewest = n" + str(source) + ";");
  line("const int32_t limit = limit_ahead(fewest);");
  line("if (limit < 0) last = begin;");
  line("vf gathered[2][" + count + "], *here = gathered[0], *next = gathered[1];");
  line("vi " + names + ";");
  line(rows + ";");
  line("int odd = 0;");
  line("int64_t k = i;");
  line("if (last - begin >= LANES) {");
  ++depth_;
  for (const std::string& s : ahead_text_) line(s);
  close();
}

void Emitter::ahead_group() {
  if (ahead_.table < 0) return;
  line("vf* const now = next;");
  line("next = here, here = now;");
  for (const Value d : plan_.groups[at(ahead_.table)].columns)
    if (d != kNone) line(declaration(d) + " = next" + str(d) + ";");
  line("if (rarely(odd)) {");
  ++depth_;
  line("odd = 0;");
  for (const auto& [source, row] : ahead_.gathers) {
    const std::string s = str(source);
    line("if (!gather3f_again(here + " + str(ahead_column({source, row, {}})) + ", s" + s + ", n" +
         s + ", " + text_.name(row) + ")) return done;");
  }
  close();
  line("k = i + 2 * LANES <= last ? i + LANES : last - LANES;");
}

void Emitter::ahead_line(Value v) {
  if (ahead_.table < 0 || plan_.printed_region(plan_.region[at(v)]) != ahead_.scope) return;
  ahead_weight_ += weight(p_.instrs[at(v)].op);
  const auto due = at(ahead_weight_) * ahead_text_.size() / at(ahead_.weight);
  while (ahead_written_ < due) line(ahead_text_[ahead_written_++]);
}

// Where the scope ends. A region that no lane takes must not keep the next group waiting.
void Emitter::ahead_end(int32_t scope) {
  if (ahead_.table < 0 || scope != ahead_.scope) return;
  while (ahead_written_ < ahead_text_.size()) line(ahead_text_[ahead_written_++]);
  if (scope < 0) return;
  --depth_;
  line("} else {");
  ++depth_;
  for (const std::string& s : ahead_text_) line(s);
}

}  // namespace nova::ir
