#include "emit_plan.h"

#include <algorithm>
#include <map>
#include <tuple>

#include "emit_sink.h"

namespace nova::ir {
namespace {

constexpr int32_t kTableLoadWeight = 8;

size_t at(int32_t k) { return static_cast<size_t>(k); }

class Planner {
 public:
  Planner(const Program& program, bool device, int32_t min_printed)
      : p_(program), device_(device), min_printed_(min_printed) {}

  EmitPlan run() {
    out_.steps = schedule(p_);
    if (!device_) out_.steps = sunk(p_, std::move(out_.steps));
    const size_t count = p_.instrs.size();
    out_.uniform.assign(count, 0);
    out_.once.assign(count, 0);
    out_.used.assign(count, 0);
    out_.escapes.assign(count, 0);
    out_.loop.assign(count, -1);
    out_.region.assign(count, -1);
    out_.group.assign(count, -1);
    out_.root.assign(count, kNone);
    locate();
    find_uniform();
    find_used();
    group_loads();
    weigh_regions();
    find_escapes();
    find_limited_roots();
    return std::move(out_);
  }

 private:
  // Finds the loop and the region of every value.
  void locate() {
    out_.region_of_step.assign(out_.steps.size(), -1);
    std::vector<std::pair<int32_t, int32_t>> open;  // (end step, region)
    int32_t loop = -1;
    for (size_t s = 0; s < out_.steps.size(); ++s) {
      while (!open.empty() && open.back().first <= static_cast<int32_t>(s)) open.pop_back();
      const Step& step = out_.steps[s];
      switch (step.kind) {
        case Step::Kind::LoopBegin:
          loop = step.value;
          break;
        case Step::Kind::LoopEnd:
          loop = -1;
          break;
        case Step::Kind::SkipIfNone: {
          Region region;
          region.parent = open.empty() ? -1 : open.back().second;
          region.cond = step.value;
          region.polarity = step.polarity;
          const auto number = static_cast<int32_t>(out_.regions.size());
          out_.regions.push_back(std::move(region));
          out_.region_of_step[s] = number;
          open.emplace_back(step.target, number);
          break;
        }
        case Step::Kind::Compute:
          out_.loop[at(step.value)] = loop;
          out_.region[at(step.value)] = open.empty() ? -1 : open.back().second;
          break;
      }
    }
  }

  // Finds values that are uniform or computed once. Operands precede their users, so one pass
  // suffices. A load cannot move, because its row may be valid only under a condition.
  void find_uniform() {
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const Instr& in = p_.instrs[v];
      bool uniform = in.op != Op::INDEX && in.op != Op::SLOT && in.op != Op::SUM;
      bool once = uniform && in.op != Op::REDUCE_INDEX;
      for_each_operand(in, [&](Value o) {
        uniform = uniform && out_.uniform[at(o)];
        once = once && out_.once[at(o)];
      });
      if (is_load(in.op) && (out_.region[v] >= 0 || out_.loop[v] >= 0)) once = false;
      out_.uniform[v] = uniform;
      out_.once[v] = uniform && once;
    }
  }

  void find_used() {
    const auto use = [&](Value v) { out_.used[at(v)] = 1; };
    for (const Output& o : p_.outputs)
      for (const Value v : o.values) use(v);
    for (const Loop& l : p_.loops)
      for (const Sum& s : l.sums) {
        use(s.init);
        use(s.term);
      }
    for (const Region& r : out_.regions) use(r.cond);
    for (size_t v = p_.instrs.size(); v-- > 0;) {
      const Instr& in = p_.instrs[v];
      // the own row is written as i
      const bool own_row = is_load(in.op) && p_.instrs[at(in.b)].op == Op::INDEX;
      if (out_.used[v] && !own_row) for_each_operand(in, use);
    }
  }

  // Merges loads of columns of one row, in the same loop and region, into one load at the first of
  // them.
  void group_loads() {
    std::map<std::tuple<int32_t, Value, int32_t, int32_t, bool>, int32_t> known;
    for (const Step& step : out_.steps) {
      if (step.kind != Step::Kind::Compute || !out_.used[at(step.value)]) continue;
      const Instr& in = p_.instrs[at(step.value)];
      if (!is_load(in.op)) continue;
      const size_t v = at(step.value);
      const auto [entry, fresh] = known.emplace(
          std::make_tuple(in.a, in.b, out_.loop[v], out_.region[v], out_.once[v] != 0),
          static_cast<int32_t>(out_.groups.size()));
      if (fresh) {
        out_.group[v] = entry->second;
        out_.groups.push_back(
            {in.a, in.b, std::vector<Value>(at(p_.sources[at(in.a)].width), kNone)});
      }
      Value& column = out_.groups[at(entry->second)].columns[at(in.c)];
      if (column == kNone) column = step.value;
    }
  }

  void weigh_regions() {
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const Op op = p_.instrs[v].op;
      if (!out_.is_line(v, op)) continue;
      const bool through_table = is_load(op) && p_.instrs[at(p_.instrs[v].b)].op != Op::INDEX;
      for (int32_t r = out_.region[v]; r >= 0; r = out_.regions[at(r)].parent)
        out_.regions[at(r)].weight += through_table ? kTableLoadWeight : weight(op);
    }
    // A compiler contracts a product and a sum only within one block of code. If contraction is
    // allowed, the text therefore has no conditional regions.
    for (Region& r : out_.regions) r.printed = !p_.contract && r.weight >= min_printed_;
  }

  bool inside(int32_t region, int32_t ancestor) const {
    while (region >= 0 && region != ancestor) region = out_.regions[at(region)].parent;
    return region == ancestor;
  }

  void find_escapes() {
    // For each value, finds the innermost printed region that contains the value and all its uses.
    constexpr int32_t kUnseen = -2;
    std::vector<int32_t> scope(p_.instrs.size(), kUnseen);
    const auto common = [&](int32_t a, int32_t b) {
      while (a >= 0 && !inside(b, a)) a = out_.printed_region(out_.regions[at(a)].parent);
      return a;
    };
    const auto use = [&](Value v, int32_t region) {
      int32_t& s = scope[at(v)];
      if (s == kUnseen) s = out_.printed_region(out_.region[at(v)]);
      s = common(s, out_.printed_region(region));
    };
    for (const Output& o : p_.outputs)
      for (const Value v : o.values) use(v, -1);
    for (const Loop& l : p_.loops)
      for (const Sum& s : l.sums) use(s.term, -1);
    for (const Region& r : out_.regions) use(r.cond, r.parent);
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (out_.used[v]) for_each_operand(p_.instrs[v], [&](Value o) { use(o, out_.region[v]); });
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      if (scope[v] == kUnseen || out_.once[v] || is_leaf(p_.instrs[v].op)) continue;
      int32_t child = out_.printed_region(out_.region[v]);
      if (child == scope[v]) continue;
      while (out_.printed_region(out_.regions[at(child)].parent) != scope[v])
        child = out_.printed_region(out_.regions[at(child)].parent);
      out_.regions[at(child)].escape.push_back(static_cast<Value>(v));
      out_.escapes[v] = 1;
    }
  }

  bool under(int32_t region, Value cond) const {
    for (; region >= 0; region = out_.regions[at(region)].parent)
      if (out_.regions[at(region)].cond == cond && out_.regions[at(region)].polarity) return true;
    return false;
  }

  void find_limited_roots() {
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const Instr& in = p_.instrs[v];
      const bool limit = in.op == Op::LT && p_.instrs[at(in.b)].op == Op::SQRT &&
                         (out_.once[at(in.a)] || is_constant(p_.instrs[at(in.a)].op)) &&
                         !out_.uniform[at(in.b)] && out_.loop[v] == out_.loop[at(in.b)] &&
                         out_.region[v] == out_.region[at(in.b)] && out_.root[at(in.b)] == kNone;
      if (limit && only_under(in.b, static_cast<Value>(v))) {
        out_.root[v] = in.b;
        out_.root[at(in.b)] = static_cast<Value>(v);
      }
    }
  }
  static bool is_constant(Op op) { return op == Op::CONST_F || op == Op::PARAM_F; }
  // Returns whether the value is used only by the comparison, and by values that are only needed if
  // the comparison holds.
  bool only_under(Value value, Value comparison) const {
    for (const Output& o : p_.outputs)
      for (const Value v : o.values)
        if (v == value) return false;
    for (const Loop& l : p_.loops)
      for (const Sum& s : l.sums)
        if (s.init == value || s.term == value) return false;
    for (size_t u = 0; u < p_.instrs.size(); ++u) {
      if (!out_.used[u] || u == at(comparison)) continue;
      bool uses = false;
      for_each_operand(p_.instrs[u], [&](Value o) { uses = uses || o == value; });
      if (uses && !under(out_.region[u], comparison)) return false;
    }
    return true;
  }

  const Program& p_;
  const bool device_;
  const int32_t min_printed_;
  EmitPlan out_;
};

}  // namespace

bool is_leaf(Op op) {
  switch (op) {
    case Op::CONST_F:
    case Op::CONST_I:
    case Op::CONST_B:
    case Op::PARAM_F:
    case Op::PARAM_I:
    case Op::REDUCE_INDEX:
    case Op::SLOT:
    case Op::SUM:
      return true;
    default:
      return false;
  }
}

int32_t weight(Op op) {
  const bool division = op == Op::DIV || op == Op::SQRT || op == Op::IDIV || op == Op::IMOD;
  return division ? 12 : 1;
}

EmitPlan make_emit_plan(const Program& program, bool device, int32_t min_printed) {
  return Planner(program, device, min_printed).run();
}

}  // namespace nova::ir
