#include "emit_prefetch.h"

#include <algorithm>
#include <functional>
#include <map>

#include "emitter.h"

namespace nova::ir {
namespace {

// A single gather per group does not pay off.
constexpr int64_t kFewestGathers = 2;

bool has(const auto& list, const auto& item) {
  return std::find(list.begin(), list.end(), item) != list.end();
}

// Returns the group of unconditional loads at the own row that has this value as a column; -1:
// none.
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

// Finds the printed region that has most of the arithmetic, and its weight. -1 means no region.
void find_scope(const Program& p, const EmitPlan& plan, PrefetchedGathers& out) {
  std::map<int32_t, int32_t> weights;
  for (size_t v = 0; v < p.instrs.size(); ++v)
    if (const int32_t region = plan.printed_region(plan.region[v]);
        plan.is_line(v, p.instrs[v].op) &&
        (region < 0 || plan.printed_region(plan.regions[at(region)].parent) < 0))
      weights[region] += weight(p.instrs[v].op);
  for (const auto& [region, total] : weights)
    if (total > out.weight) out.scope = region, out.weight = total;
}

// Returns the only printed region inside of the scope that needs the group. Returns -1 if the group
// is loaded wherever the scope is computed.
int32_t only_region(const EmitPlan& plan, const LoadGroup& group, int32_t scope) {
  const Value first =
      *std::find_if(group.columns.begin(), group.columns.end(), [](Value v) { return v != kNone; });
  const int32_t region = plan.printed_region(plan.region[at(first)]);
  return region == scope ? -1 : region;
}

auto find_gather(auto& gathers, const LoadGroup& group) {
  return std::find_if(gathers.begin(), gathers.end(), [&group](const PrefetchedGather& g) {
    return g.source == group.source && g.row == group.row;
  });
}

}  // namespace

PrefetchedGathers find_prefetched_gathers(const Program& p, const EmitPlan& plan) {
  PrefetchedGathers out;
  if (!p.loops.empty()) return out;
  find_scope(p, plan, out);
  for (const LoadGroup& group : plan.groups) {
    const Source& source = p.sources[at(group.source)];
    if (source.type != Type::F32 || source.width != 3) continue;
    const int32_t table = table_of(p, plan, group.row);
    if (table < 0 || (out.table >= 0 && out.table != table)) continue;
    out.table = table;
    if (!has(out.rows, group.row)) out.rows.push_back(group.row);
    const int32_t region = only_region(plan, group, out.scope);
    if (const auto known = find_gather(out.gathers, group); known == out.gathers.end())
      out.gathers.push_back({group.source, group.row, region});
    else if (region < 0)
      known->region = -1;
  }
  const auto sure = std::count_if(out.gathers.begin(), out.gathers.end(),
                                  [](const PrefetchedGather& g) { return g.region < 0; });
  return sure < kFewestGathers ? PrefetchedGathers() : out;
}

int32_t Emitter::prefetch_column(const LoadGroup& group) const {
  const auto found = find_gather(prefetch_.gathers, group);
  if (found == prefetch_.gathers.end()) return -1;
  if (found->region >= 0 && found->region != only_region(plan_, group, prefetch_.scope)) return -1;
  return 3 * static_cast<int32_t>(found - prefetch_.gathers.begin());
}

std::vector<int32_t> Emitter::prefetch_regions() const {
  std::vector<int32_t> regions;
  for (const PrefetchedGather& g : prefetch_.gathers)
    if (g.region >= 0 && !has(regions, g.region)) regions.push_back(g.region);
  return regions;
}

std::string Emitter::prefetch_gather(const PrefetchedGather& g, int32_t column) const {
  return "gather3f_prefetched(s" + str(g.source) + ", &prefetch" + str(g.row) + ", next + " + str(column) +
         ");";
}

// Emits the start of the prefetch. In the emitted code, k is the first row of the next lanes.
void Emitter::prefetch_begin() {
  if (prefetch_.table < 0) return;
  const LoadGroup& table = plan_.groups[at(prefetch_.table)];
  const int32_t width = p_.sources[at(table.source)].width;
  std::string targets, names;
  for (int32_t c = 0; c < width; ++c) {
    const Value d = table.columns[at(c)];
    const std::string name = d != kNone ? "next" + str(d) : "unused" + str(c);
    targets += ", &" + name;
    names += (names.empty() ? "" : ", ") + name;
    if (d != kNone) done_[at(d)] = 1;
  }
  prefetch_text_.push_back("load" + str(width) + "i(s" + str(table.source) + " + " + str(4 * width) +
                        " * k" + targets + ");");
  for (const Value row : prefetch_.rows)
    prefetch_text_.push_back("odd |= prefetch_look(&prefetch" + str(row) + ", next" + str(row) +
                          ", limit);");
  std::string rows = "rows_prefetched ", separator, sources;
  for (const Value row : prefetch_.rows) rows += separator + "prefetch" + str(row), separator = ", ";
  std::vector<int32_t> gathered;
  int32_t column = 0;
  for (const PrefetchedGather& g : prefetch_.gathers) {
    if (g.region < 0) prefetch_text_.push_back(prefetch_gather(g, column));
    column += 3;
    if (!has(gathered, g.source)) gathered.push_back(g.source);
  }
  const std::string count = str(static_cast<int64_t>(3 * prefetch_.gathers.size()));
  line(
      "// Rows through the table are prefetched by one group: [here] is this one's, [next] the "
      "one's at k.");
  line("int64_t fewest = n" + str(gathered[0]) + ";");
  for (const int32_t source : gathered)
    if (source != gathered[0])
      line("if (n" + str(source) + " < fewest) fewest = n" + str(source) + ";");
  line("const int32_t limit = prefetch_limit(fewest);");
  line("if (limit < 0) last = begin;");
  line("vf gathered[2][" + count + "], *here = gathered[0], *next = gathered[1];");
  line("vi " + names + ";");
  line(rows + ";");
  line("int odd = 0;");
  for (const int32_t region : prefetch_regions()) {
    const std::string r = str(region);
    line("int took" + r + " = 0, fetch" + r + " = 0, ready" + r + " = 0;");
  }
  line("int64_t k = i;");
  line("if (last - begin >= LANES) {");
  ++depth_;
  for (const std::string& s : prefetch_text_) line(s);
  close();
}

void Emitter::prefetch_group() {
  if (prefetch_.table < 0) return;
  line("vf* const now = next;");
  line("next = here, here = now;");
  for (const Value d : plan_.groups[at(prefetch_.table)].columns)
    if (d != kNone) line(declaration(d) + " = next" + str(d) + ";");
  for (const int32_t region : prefetch_regions()) {
    const std::string r = str(region);
    line("ready" + r + " = fetch" + r + ", fetch" + r + " = took" + r + ", took" + r + " = 0;");
  }
  line("if (rarely(odd)) {");
  ++depth_;
  line("odd = 0;");
  int32_t column = 0;
  for (const PrefetchedGather& g : prefetch_.gathers) {
    const std::string s = str(g.source);
    line("if (" + (g.region < 0 ? "" : "ready" + str(g.region) + " && ") +
         "!gather3f_again(here + " + str(column) + ", s" + s + ", n" + s + ", limit, " +
         text_.name(g.row) + ")) return done;");
    column += 3;
  }
  close();
  line("k = i + 2 * LANES <= last ? i + LANES : last - LANES;");
}

void Emitter::prefetch_line(Value v) {
  if (prefetch_.table < 0 || plan_.printed_region(plan_.region[at(v)]) != prefetch_.scope) return;
  prefetch_weight_ += weight(p_.instrs[at(v)].op);
  const auto due = at(prefetch_weight_) * prefetch_text_.size() / at(prefetch_.weight);
  while (prefetch_written_ < due) line(prefetch_text_[prefetch_written_++]);
}

// For example, gradients with respect to velocities are zero without damping.
int32_t Emitter::zero_without(const Output& output) const {
  const auto scope_of = [&](int32_t r) {
    return plan_.printed_region(plan_.regions[at(r)].parent);
  };
  for (const int32_t taken : prefetch_regions()) {
    // Regions with the same parent and condition are taken together.
    const auto taken_too = [&](int32_t r) {
      const Region &a = plan_.regions[at(r)], &b = plan_.regions[at(taken)];
      return a.cond == b.cond && a.polarity == b.polarity && scope_of(r) == scope_of(taken);
    };
    const auto inside = [&](Value v) {
      int32_t r = plan_.printed_region(plan_.region[at(v)]);
      while (r >= 0 && !taken_too(r)) r = scope_of(r);
      return r >= 0;
    };
    const std::function<bool(Value)> zero = [&](Value v) {
      const Instr& in = p_.instrs[at(v)];
      if (in.op == Op::CONST_F) return in.a == 0;
      return inside(v) || (in.op == Op::SELECT_F && zero(in.b) && zero(in.c));
    };
    if (std::all_of(output.values.begin(), output.values.end(), zero)) return taken;
  }
  return -1;
}

void Emitter::prefetch_region(int32_t region) {
  if (has(prefetch_regions(), region)) line("took" + str(region) + " = 1;");
}

// Writes the code that reads a group of loaded columns from the prefetched memory. If the columns
// belong to a region that the prefetch did not predict, the code gathers the columns now.
void Emitter::prefetch_load(Value v, const LoadGroup& group, int32_t first, const std::string& where) {
  const PrefetchedGather& g = prefetch_.gathers[at(first / 3)];
  const std::string targets = g.region < 0 ? "" : columns(v, group, 0, 0, 3);
  const auto take = [&] {
    for (int32_t c = 0; c < 3; ++c)
      if (const Value d = group.columns[at(c)]; d != kNone)
        line((g.region < 0 ? declaration(d) : text_.name(d)) + " = here[" + str(first + c) + "];");
  };
  if (g.region < 0) return take();
  line("if (ready" + str(g.region) + ") {");
  ++depth_;
  take();
  --depth_;
  line("} else {");
  ++depth_;
  line("const row_lanes rows = look_at_rows(" + text_.lanes(group.row) + ");");
  line("gather3f(s" + str(g.source) + ", n" + str(g.source) + ", &rows" + where + targets + ");");
  close();
}

// Ends the scope. Writes the remaining prefetches even if no lane took a region.
void Emitter::prefetch_end(int32_t scope) {
  if (prefetch_.table < 0 || scope != prefetch_.scope) return;
  while (prefetch_written_ < prefetch_text_.size()) line(prefetch_text_[prefetch_written_++]);
  // All prefetches come in one place, because a branch between the lines would split the block of
  // code for the compiler.
  for (const int32_t region : prefetch_regions()) {
    line("if (fetch" + str(region) + ") {");
    ++depth_;
    for (size_t g = 0; g < prefetch_.gathers.size(); ++g)
      if (prefetch_.gathers[g].region == region)
        line(prefetch_gather(prefetch_.gathers[g], 3 * static_cast<int32_t>(g)));
    close();
  }
  if (scope < 0) return;
  --depth_;
  line("} else {");
  ++depth_;
  for (const int32_t region : prefetch_regions()) line("fetch" + str(region) + " = 0;");
  for (const std::string& s : prefetch_text_) line(s);
}

}  // namespace nova::ir
