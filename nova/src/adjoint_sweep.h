// Internal: the reverse sweep over a traced Program, the core of adjoint generation.
#pragma once

#include <algorithm>
#include <iterator>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "derivative_rules.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/adjoint.h"
#include "novaphy/nova/trace.h"
#include "novaphy/program/ir.h"

namespace nova::detail {

using ir::Instr;
using ir::kNone;
using ir::Op;
using ir::Value;
using Kind = AdjointBinding::Kind;

inline bool is_item(const Instr& in) { return in.op == Op::SLOT || in.op == Op::REDUCE_INDEX; }

// Properties of the primal Program that all stages use.
struct Primal {
  const ir::Program& p;
  const AdjointMask& mask;
  std::vector<int32_t> section;
  std::vector<char>
      active;  // per value: a requested source is reachable through differentiable operands
  mutable ir::Guards guards;  // the sweep adds sides of selects that guard no instruction
  // Values outside of the loop that only one side of a select in the loop uses. Their gradient is a
  // sum over items, which no guard covers. The gradient may be 0 where the value is NaN.
  std::vector<char> perhaps_unneeded;

  Primal(const ir::Program& program, const AdjointMask& m)
      : p(program), mask(m), section(ir::sections(program)) {
    // Guards are found with all gradient columns, before `narrowed` removes some, so that
    // contributions are added in the same order for every mask.
    find_active(-1);
    find_guards();
    if (mask.narrowed >= 0 && !mask.gated) find_active(mask.narrowed);
  }

  void find_active(int32_t narrowed) {
    active.assign(p.instrs.size(), 0);
    for (size_t v = 0; v < p.instrs.size(); ++v) active[v] = is_active(p.instrs[v], narrowed);
  }

  bool is_active(const Instr& in, int32_t narrowed) const {
    if (in.op == Op::LOAD_F)
      return mask.wrt[in.a] && !(narrowed == in.a && (mask.unread >> in.c & 1) != 0);
    bool on = false;
    const auto look = [&](Value v, int = 0) { on = on || active[v] != 0; };
    if (in.op == Op::SUM) {
      look(p.loops[in.a].sums[in.b].init);
      look(p.loops[in.a].sums[in.b].term);
    }
    for_each_differentiable(in, look);
    return on;
  }

  // Finds the guard of each value: the sides of selects that all its uses lie on. Works as
  // ir::guards does, but ignores uses in conditions, because conditions carry no gradient. A value
  // that one side of a select uses thus has its gradient on that side only, even if a condition
  // also uses it. Guards also apply across sections, except from inside of the loop to outside.
  void find_guards() {
    constexpr int32_t kUnused = -1;
    guards.nodes.push_back({});
    guards.guard.assign(p.instrs.size(), kUnused);
    perhaps_unneeded.assign(p.instrs.size(), 0);
    const auto use = [&](Value v, int32_t guard) {
      int32_t& g = guards.guard[v];
      g = g == kUnused ? guard : guards.common(g, guard);
    };
    for (const ir::Output& o : p.outputs)
      for (const Value v : o.values) use(v, 0);
    for (const ir::Loop& l : p.loops)
      for (const ir::Sum& s : l.sums) {
        use(s.init, 0);
        use(s.term, 0);
      }
    for (size_t k = p.instrs.size(); k-- > 0;) {
      const Instr& in = p.instrs[k];
      const bool reached = active[k] && guards.guard[k] != kUnused;
      if (!reached || in.op == Op::SUM) guards.guard[k] = 0;
      if (!reached) continue;
      const int32_t guard = guards.guard[k];
      const auto use_here = [&](Value v, int32_t g) {
        const bool outward = section[k] == 1 && section[v] != 1;
        if (perhaps_unneeded[k] || (outward && g != 0)) perhaps_unneeded[v] = 1;
        use(v, outward ? 0 : g);
      };
      if (in.op == Op::SELECT_F) {
        use_here(in.b, guards.find_or_add(guard, in.a, true));
        use_here(in.c, guards.find_or_add(guard, in.a, false));
      } else {
        for_each_differentiable(in, [&](Value v, int) { use_here(v, guard); });
      }
    }
  }
};

// One stage of the adjoint: copies of primal values in a new Program, and the reverse sweep over
// them.
class Sweep {
 public:
  enum class Domain { Rows, CsrItems, FixedItems };

  Sweep(const Primal& primal, Domain domain, const std::string& suffix)
      : primal_(primal), p_(primal.p), domain_(domain), trace_(p_.name + suffix) {
    ir::Program& out = trace_.program();
    out.sources = p_.sources;
    out.param_count = p_.param_count;
    out.contract = p_.contract;
    for (size_t s = 0; s < p_.sources.size(); ++s) {
      stage.sources.push_back({Kind::PrimalSource, static_cast<int32_t>(s)});
      if (domain != Domain::Rows) out.sources[s].access = ir::Access::Indexed;
    }
    for (auto& map : clones_) map.assign(p_.instrs.size(), kNone);
  }

  AdjointStage stage;

  Value add_source(const std::string& name, int32_t width, AdjointBinding binding,
                   ir::Access access) {
    trace_.program().sources.push_back({name, ir::Type::F32, width, access});
    stage.sources.push_back(binding);
    return static_cast<Value>(trace_.program().sources.size()) - 1;
  }
  Value load(int32_t source, Value row, int32_t column) {
    return trace_.emit({Op::LOAD_F, source, row, column});
  }
  Value load_row(int32_t table, int32_t column) {
    return trace_.emit({Op::LOAD_I, table, index(), column});
  }
  Value index() { return trace_.emit({Op::INDEX}); }
  Trace& trace() { return trace_; }

  // Returns a bit of AdjointGate for a source, as a value in the Program. Call after the sweep.
  Value gate(int32_t source, AdjointGate bit) {
    const auto at = std::find(stage.gates.begin(), stage.gates.end(), source);
    const auto number = static_cast<int32_t>(at - stage.gates.begin());
    if (at == stage.gates.end()) stage.gates.push_back(source);
    const int32_t first = p_.param_count + (stage.takes_row_count ? 1 : 0);
    trace_.program().param_count = first + static_cast<int32_t>(stage.gates.size());
    const Value bits = trace_.emit({Op::PARAM_I, first + number});
    const Value one = trace_.emit({Op::IAND, bits, trace_.constant(static_cast<int32_t>(bit))});
    return trace_.emit({Op::INE, one, trace_.constant(int32_t{0})});
  }

  // Returns the row of the primal that the present row or item belongs to.
  Value primal_row() {
    if (domain_ == Domain::Rows) return index();
    if (domain_ == Domain::FixedItems) return trace_.emit({Op::IMOD, index(), row_count()});
    if (row_of_item_source_ < 0) {
      trace_.program().sources.push_back({"row_of_item", ir::Type::I32, 1, ir::Access::Direct});
      stage.sources.push_back({Kind::RowOfItem, 0});
      row_of_item_source_ = static_cast<int32_t>(trace_.program().sources.size()) - 1;
    }
    return trace_.emit({Op::LOAD_I, row_of_item_source_, index(), 0});
  }
  Value primal_item() {
    return domain_ == Domain::CsrItems ? index() : trace_.emit({Op::IDIV, index(), row_count()});
  }

  // Returns the copy of a primal value in this Program. copy 0: in the loop of the primal or
  // outside; copy 1: in the loop that sums adjoints.
  Value clone(Value v, int copy) {
    if (primal_.section[v] % 2 == 0) copy = 0;
    Value& mapped = clones_[copy][v];
    if (mapped != kNone) return mapped;
    Instr in = p_.instrs[v];
    if (in.op == Op::INDEX) return mapped = primal_row();
    if (is_item(in)) return mapped = item(in, copy);
    if (in.op == Op::SUM) return mapped = clone_sum(in);
    if (in.op == Op::DETACH) return mapped = clone(in.a, copy);
    if (in.op == Op::PARTIAL) return mapped = clone(in.a, copy);
    const char* signature = ir::kOpSignatures[static_cast<int>(in.op)];
    auto is_value = [](char letter) { return letter != '#' && letter != '-'; };
    if (is_value(signature[1])) in.a = clone(in.a, copy);
    if (is_value(signature[2])) in.b = clone(in.b, copy);
    if (is_value(signature[3])) in.c = clone(in.c, copy);
    return mapped = trace_.emit(in);
  }

  // Adds `value` to the part of v's adjoint that holds under guard g of the primal.
  void contribute(Value v, int32_t g, Value value) {
    if (!primal_.active[v]) return;
    auto [entry, fresh] = adjoints_[v].try_emplace(g, value);
    if (!fresh) entry->second = add(entry->second, value);
  }

  // Adds the adjoint of a loop's sum to the term of the sum, once per item, even if the term does
  // not depend on the item.
  void contribute_term(Value term, Value value) {
    if (primal_.section[term] == 1) {
      contribute(term, 0, value);
    } else if (primal_.active[term]) {
      give_outward(term, 0, value, 1);
    }
  }

  // Differentiates the values of one section in reverse order.
  void sweep(int32_t section, int copy) {
    for (size_t k = p_.instrs.size(); k-- > 0;)
      if (primal_.section[k] == section && primal_.active[k])
        reverse(static_cast<Value>(k), section, copy);
  }

  // Returns the adjoint of v under the guard `to`, or kNone. An adjoint under a deeper guard is
  // replaced by a select between the adjoint and 0, and then added.
  Value gather_adjoint(Value v, int32_t to, int copy) {
    auto found = adjoints_.find(v);
    if (found == adjoints_.end()) return kNone;
    auto& by_guard = found->second;
    while (!by_guard.empty()) {
      const auto deepest =
          std::prev(by_guard.end());  // children have larger indices than their parents
      const int32_t g = deepest->first;
      Value value = deepest->second;
      if (g == to) return value;
      const ir::Guard& guard = primal_.guards.nodes[g];
      const Value cond = clone(guard.cond, copy);
      const Value zero = trace_.constant(0.0f);
      value = guard.polarity ? trace_.emit({Op::SELECT_F, cond, value, zero})
                             : trace_.emit({Op::SELECT_F, cond, zero, value});
      by_guard.erase(deepest);
      auto [entry, fresh] = by_guard.try_emplace(guard.parent, value);
      if (!fresh) entry->second = add(entry->second, value);
    }
    return kNone;
  }

  // The adjoint of a load outside and inside of the loop, without guards; kNone means no adjoint.
  // The two stay separate, because they are added to the gradient one after the other.
  struct LoadAdjoint {
    Value outside = kNone, loop = kNone;
  };
  std::map<Value, LoadAdjoint> load_adjoints;  // keyed by the load in the primal

  // Called after the sweep over the loop's section. Turns the contributions of the loop's body to
  // values outside into sums of a new loop. The sum for a load starts from 0, other sums start from
  // the present adjoint.
  void close_adjoint_loop() {
    ir::Program& out = trace_.program();
    for (auto& [v, value] : from_body_) {
      const bool is_load = p_.instrs[v].op == Op::LOAD_F;
      const Value so_far = is_load ? kNone : gather_adjoint(v, 0, 0);
      out.loops[adjoint_loop_].sums.push_back(
          {so_far == kNone ? trace_.constant(0.0f) : so_far, value});
      const auto number = static_cast<int32_t>(out.loops[adjoint_loop_].sums.size()) - 1;
      const Value sum = trace_.emit({Op::SUM, adjoint_loop_, number});
      if (is_load) {
        load_adjoints[v].loop = sum;
      } else {
        adjoints_[v][0] = sum;
      }
    }
    from_body_.clear();
    in_body_ = false;
  }
  void open_adjoint_loop(const ir::Loop& loop) {
    ensure_primal_loop();
    trace_.program().loops.push_back({loop.kind, loop.extent_param, {}});
    adjoint_loop_ = static_cast<int32_t>(trace_.program().loops.size()) - 1;
    in_body_ = true;
  }

 private:
  Value row_count() {  // the row count is one more parameter after those of the primal
    stage.takes_row_count = true;
    trace_.program().param_count = p_.param_count + 1;
    return trace_.emit({Op::PARAM_I, p_.param_count});
  }

  Value item(const Instr& in, int copy) {
    if (domain_ == Domain::Rows) {
      if (copy == 0) ensure_primal_loop();
      return trace_.emit({in.op, copy == 0 ? primal_loop_ : adjoint_loop_});
    }
    novaphy::require(
        domain_ == Domain::FixedItems || in.op == Op::SLOT, novaphy::ErrorKind::NotImplemented,
        "kernel '", p_.name,
        "': the position in a CSR row is used where a gradient of a loop source is wanted");
    return primal_item();
  }

  void ensure_primal_loop() {
    if (primal_loop_ >= 0 || p_.loops.empty()) return;
    const ir::Loop& loop = p_.loops[0];
    trace_.program().loops.push_back({loop.kind, loop.extent_param, {}});
    primal_loop_ = static_cast<int32_t>(trace_.program().loops.size()) - 1;
  }

  Value clone_sum(const Instr& in) {
    novaphy::require(domain_ == Domain::Rows, novaphy::ErrorKind::Runtime,
                     "nova: a sum inside of its own loop");
    ensure_primal_loop();
    const ir::Sum& sum = p_.loops[in.a].sums[in.b];
    const Value init = clone(sum.init, 0), term = clone(sum.term, 0);
    auto& sums = trace_.program().loops[primal_loop_].sums;
    sums.push_back({init, term});
    return trace_.emit({Op::SUM, primal_loop_, static_cast<int32_t>(sums.size()) - 1});
  }

  Value add(Value a, Value b) { return rules_.add(a, b); }

  void reverse(Value v, int32_t section, int copy) {
    const int32_t guard = primal_.guards.guard[v];
    const Instr& in = p_.instrs[v];
    if (in.op == Op::LOAD_F) {
      if (const Value g = gather_adjoint(v, 0, copy); g != kNone) load_adjoints[v].outside = g;
      return;
    }
    const Value g = gather_adjoint(v, guard, copy);
    if (g == kNone) return;
    auto give = [&](Value operand, int32_t under, Value value) {
      if (!primal_.active[operand]) return;
      if (primal_.section[operand] == section) {
        contribute(operand, under, value);
      } else {  // to a value of an earlier section
        give_outward(operand, under, value, copy);
      }
    };
    differentiate(v, in, g, guard, copy, give);
  }

  template <class Give>
  void differentiate(Value v, const Instr& in, Value g, int32_t guard, int copy, const Give& give) {
    switch (in.op) {
      case Op::SELECT_F:
        // Each side gets its gradient under its own guard. Where the guard ends, gather_adjoint
        // replaces it by a select.
        give(in.b, primal_.guards.find_or_add(guard, in.a, true), g);
        give(in.c, primal_.guards.find_or_add(guard, in.a, false), g);
        break;
      case Op::SUM:  // passes to the initial value; the caller handles the terms
        sum_adjoints[{in.a, in.b}] = gather_adjoint(v, 0, copy);
        give(p_.loops[in.a].sums[in.b].init, 0, sum_adjoints[{in.a, in.b}]);
        break;
      default: {
        const auto at = [&](Value operand) { return clone(operand, copy); };
        for_each_differentiable(in, [&](Value operand, int position) {
          if (primal_.active[operand])
            give(operand, guard,
                 rules_.apply(p_, v, position, g, at, primal_.perhaps_unneeded[v] != 0));
        });
      }
    }
  }

  // Contributes to a value outside of the loop. Inside of the loop, all guards are first replaced
  // by selects, and the value then collects one term per item.
  void give_outward(Value operand, int32_t guard, Value value, int copy) {
    // in the epilogue of a loop
    if (!in_body_) return contribute(operand, guard, value);
    for (int32_t g = guard; g != 0; g = primal_.guards.nodes[g].parent)
      value = wrap(g, value, copy);
    auto [entry, fresh] = from_body_.try_emplace(operand, value);
    if (!fresh) entry->second = add(entry->second, value);
  }
  Value wrap(int32_t g, Value value, int copy) {
    const ir::Guard& guard = primal_.guards.nodes[g];
    const Value cond = clone(guard.cond, copy), zero = rules_.zero();
    return guard.polarity ? rules_.choose(cond, value, zero) : rules_.choose(cond, zero, value);
  }

 public:
  std::map<std::pair<int32_t, int32_t>, Value>
      sum_adjoints;  // (loop, sum) -> adjoint of its result

 private:
  const Primal& primal_;
  const ir::Program& p_;
  Domain domain_;
  Trace trace_;
  DerivativeRules rules_{trace_};
  std::vector<Value> clones_[2];
  std::map<Value, std::map<int32_t, Value>> adjoints_;  // value -> guard -> adjoint
  std::map<Value, Value> from_body_;
  int32_t row_of_item_source_ = -1;
  int32_t primal_loop_ = -1, adjoint_loop_ = -1;
  bool in_body_ = false;
};

}  // namespace nova::detail
