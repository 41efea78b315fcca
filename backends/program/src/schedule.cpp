// Orders of a Program: its canonical order, its guards, and the schedule with regions that lanes
// may skip.
#include <algorithm>
#include <functional>
#include <utility>

#include "novaphy/program/ir.h"

namespace nova::ir {
namespace {

// Copies the values that the outputs need, depth first, into a new Program.
class Canonicaliser {
 public:
  Canonicaliser(const Program& from, bool strip)
      : from_(from), strip_(strip), map_(from.instrs.size(), kNone) {
    to_.name = from.name;
    to_.sources = from.sources;
    to_.param_count = from.param_count;
    to_.contract = from.contract;
    to_.primal = from.primal;
    loop_map_.assign(from.loops.size(), kNone);
    sum_map_.resize(from.loops.size());
    for (size_t l = 0; l < from.loops.size(); ++l)
      sum_map_[l].assign(from.loops[l].sums.size(), kNone);
  }

  Program run() {
    number_loops();
    for (const Output& o : from_.outputs) {
      Output copy = o;
      for (Value& v : copy.values) v = visit(v);
      to_.outputs.push_back(std::move(copy));
    }
    return std::move(to_);
  }

 private:
  // Loops keep their order. Loops that are not needed are removed.
  void number_loops() {
    std::vector<char> needed(from_.instrs.size(), 0);
    std::vector<char> loop_needed(from_.loops.size(), 0);
    std::vector<Value> stack;
    for (const Output& o : from_.outputs)
      stack.insert(stack.end(), o.values.begin(), o.values.end());
    while (!stack.empty()) {
      const Value v = stack.back();
      stack.pop_back();
      if (needed[v]) continue;
      needed[v] = 1;
      const Instr& in = from_.instrs[v];
      if (in.op == Op::SUM) {
        loop_needed[in.a] = 1;
        stack.push_back(from_.loops[in.a].sums[in.b].init);
        stack.push_back(from_.loops[in.a].sums[in.b].term);
      }
      if (strip_ && (in.op == Op::PARTIAL || in.op == Op::DETACH)) {
        stack.push_back(in.a);
      } else {
        for_each_operand(in, [&](Value o) { stack.push_back(o); });
      }
    }
    for (size_t l = 0; l < from_.loops.size(); ++l) {
      if (!loop_needed[l]) continue;
      loop_map_[l] = static_cast<int32_t>(to_.loops.size());
      to_.loops.push_back({from_.loops[l].kind, from_.loops[l].extent_param, {}});
    }
  }

  Value visit(Value v) {
    if (map_[v] != kNone) return map_[v];
    const Instr in = from_.instrs[v];
    if (strip_ && (in.op == Op::PARTIAL || in.op == Op::DETACH)) return map_[v] = visit(in.a);
    Instr copy = in;
    if (in.op == Op::SUM) {
      const Sum sum{visit(from_.loops[in.a].sums[in.b].init),
                    visit(from_.loops[in.a].sums[in.b].term)};
      Loop& loop = to_.loops[loop_map_[in.a]];
      copy.a = loop_map_[in.a];
      copy.b = static_cast<int32_t>(loop.sums.size());
      loop.sums.push_back(sum);
    } else if (in.op == Op::REDUCE_INDEX || in.op == Op::SLOT) {
      copy.a = loop_map_[in.a];
    } else {
      const char* s = kOpSignatures[static_cast<int>(in.op)];
      auto is_value = [](char letter) { return letter != '#' && letter != '-'; };
      if (is_value(s[1])) copy.a = visit(in.a);
      if (is_value(s[2])) copy.b = visit(in.b);
      if (is_value(s[3])) copy.c = visit(in.c);
    }
    to_.instrs.push_back(copy);
    return map_[v] = static_cast<Value>(to_.instrs.size()) - 1;
  }

  const Program& from_;
  bool strip_;
  Program to_;
  std::vector<Value> map_;
  std::vector<int32_t> loop_map_;
  std::vector<std::vector<int32_t>> sum_map_;
};

bool is_select(Op op) { return op == Op::SELECT_F || op == Op::SELECT_I || op == Op::SELECT_B; }

// A region with fewer steps costs less than the test whether it can be skipped.
constexpr int kMinRegion = 4;

class Scheduler {
 public:
  explicit Scheduler(const Program& p) : p_(p), section_(sections(p)), guards_(guards(p)) {
    emitted_.assign(p.instrs.size(), 0);
    memo_.assign(p.instrs.size(), 0);
    memo_stamp_.assign(p.instrs.size(), 0);
    flatten_small_guards();
  }

  std::vector<Step> run() {
    const auto section_count = static_cast<int32_t>(2 * p_.loops.size() + 1);
    for (int32_t s = 0; s < section_count; ++s) {
      if (s % 2 == 1) push({Step::Kind::LoopBegin, s / 2, true, -1});
      emit_region(s, 0);
      if (s % 2 == 1) push({Step::Kind::LoopEnd, s / 2, true, -1});
    }
    return std::move(steps_);
  }

 private:
  void push(Step step) { steps_.push_back(step); }

  bool inside(int32_t guard, int32_t ancestor) const {
    while (guard != -1 && guard != ancestor) guard = guards_.nodes[guard].parent;
    return guard == ancestor;
  }

  void flatten_small_guards() {
    std::vector<int> size(guards_.nodes.size(), 0);
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      for (int32_t g = guards_.guard[v]; g > 0; g = guards_.nodes[g].parent) ++size[g];
    for (int32_t& g : guards_.guard)
      while (g > 0 && size[g] < kMinRegion) g = guards_.nodes[g].parent;
    for (Guard& node : guards_.nodes)
      while (node.parent > 0 && size[node.parent] < kMinRegion)
        node.parent = guards_.nodes[node.parent].parent;
  }

  // Emits the values of one section whose guard is exactly `guard`, in order. If a value needs a
  // deeper region, that region is emitted first, as one skippable block with all its ready values.
  void emit_region(int32_t section, int32_t guard) {
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (section_[v] == section && guards_.guard[v] == guard && !emitted_[v])
        emit(static_cast<Value>(v), section, guard);
  }

  void emit(Value v, int32_t section, int32_t guard) {
    for_each_operand(p_.instrs[v], [&](Value o) {
      if (section_[o] == section && !emitted_[o]) emit_child_of(o, section, guard);
    });
    emitted_[v] = 1;
    push({Step::Kind::Compute, v, true, -1});
  }

  // The value o is in a region inside of `guard`. Opens the child region of `guard` that contains
  // o.
  void emit_child_of(Value o, int32_t section, int32_t guard) {
    int32_t child = guards_.guard[o];
    while (guards_.nodes[child].parent != guard) child = guards_.nodes[child].parent;
    const Guard node = guards_.nodes[child];
    const size_t skip = steps_.size();
    push({Step::Kind::SkipIfNone, node.cond, node.polarity, -1});
    for (size_t v = 0; v < p_.instrs.size(); ++v)
      if (section_[v] == section && guards_.guard[v] == child && !emitted_[v] &&
          ready(static_cast<Value>(v), section, child))
        emit(static_cast<Value>(v), section, child);
    steps_[skip].target = static_cast<int32_t>(steps_.size());
  }

  // Returns whether v can be computed now, if all values inside of `guard` may be emitted with it.
  bool ready(Value v, int32_t section, int32_t guard) {
    ++stamp_;  // invalidates cached results, because emitted values change between calls
    return ready_inside(v, section, guard);
  }

  bool ready_inside(Value v, int32_t section, int32_t guard) {
    if (memo_stamp_[v] == stamp_) return memo_[v];
    bool result = true;
    for_each_operand(p_.instrs[v], [&](Value o) {
      if (!result || emitted_[o] || section_[o] != section) return;
      result = inside(guards_.guard[o], guard) && ready_inside(o, section, guard) &&
               cond_ready(o, section, guard);
    });
    memo_stamp_[v] = stamp_;
    memo_[v] = result;
    return result;
  }

  // Returns whether the conditions of the region of `o` inside of `guard` can be computed now.
  bool cond_ready(Value o, int32_t section, int32_t guard) {
    for (int32_t g = guards_.guard[o]; g != guard; g = guards_.nodes[g].parent) {
      const Value cond = guards_.nodes[g].cond;
      if (emitted_[cond] || section_[cond] != section) continue;
      if (!inside(guards_.guard[cond], guard) || !ready_inside(cond, section, guard)) return false;
    }
    return true;
  }

  const Program& p_;
  std::vector<int32_t> section_;
  Guards guards_;
  std::vector<char> emitted_, memo_;
  std::vector<int> memo_stamp_;
  int stamp_ = 0;
  std::vector<Step> steps_;
};

}  // namespace

Program canonicalise(const Program& program, bool strip_trace_ops) {
  return Canonicaliser(program, strip_trace_ops).run();
}

int32_t Guards::find_or_add(int32_t parent, Value cond, bool polarity) {
  for (size_t g = 1; g < nodes.size(); ++g)
    if (nodes[g].parent == parent && nodes[g].cond == cond && nodes[g].polarity == polarity)
      return static_cast<int32_t>(g);
  nodes.push_back({parent, cond, polarity});
  return static_cast<int32_t>(nodes.size()) - 1;
}

int32_t Guards::common(int32_t g, int32_t h) const {
  // A child has a larger number than its parent, so the larger number is never the ancestor.
  while (g != h) (g > h ? g : h) = nodes[std::max(g, h)].parent;
  return g;
}

Guards guards(const Program& p) {
  constexpr int32_t kUnused = -2;
  Guards result;
  result.nodes.push_back({});
  result.guard.assign(p.instrs.size(), kUnused);
  const std::vector<int32_t> section = sections(p);
  auto use = [&](Value v, int32_t guard) {
    int32_t& g = result.guard[v];
    g = g == kUnused ? guard : result.common(g, guard);
  };
  for (const Output& o : p.outputs)
    for (Value v : o.values) use(v, 0);
  for (const Loop& l : p.loops)
    for (const Sum& s : l.sums) {
      use(s.init, 0);
      use(s.term, 0);
    }
  for (size_t k = p.instrs.size(); k-- > 0;) {
    const Instr& in = p.instrs[k];
    int32_t& mine = result.guard[k];
    if (mine == kUnused) mine = 0;
    // Sums are computed by their loop. Leaves cost nothing, so they never need a region.
    if (in.op == Op::SUM) mine = 0;
    const int32_t guard = mine;
    auto use_here = [&](Value v, int32_t g) { use(v, section[v] == section[k] ? g : 0); };
    if (is_select(in.op)) {
      use_here(in.a, guard);
      use_here(in.b, result.find_or_add(guard, in.a, true));
      use_here(in.c, result.find_or_add(guard, in.a, false));
    } else {
      for_each_operand(in, [&](Value v) { use_here(v, guard); });
    }
  }
  return result;
}

std::vector<Step> schedule(const Program& program) { return Scheduler(program).run(); }

}  // namespace nova::ir
