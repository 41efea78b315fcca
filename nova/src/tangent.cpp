#include "novaphy/nova/tangent.h"

#include <string>

#include "derivative_rules.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/trace.h"

namespace nova {
namespace {

using detail::DerivativeRules;
using ir::Instr;
using ir::kNone;
using ir::Op;
using ir::Value;

// Generates a tangent in one pass over the primal. Every value is copied, and gets a tangent if it
// depends on a source that has one.
class Push {
 public:
  Push(const ir::Program& primal, const std::vector<bool>& wrt)
      : p_(primal), trace_(primal.name + ".tangent"), tangent_source_(primal.sources.size(), -1) {
    ir::Program& out = trace_.program();
    out.sources = p_.sources;
    out.param_count = p_.param_count;
    out.contract = p_.contract;
    for (const ir::Loop& l : p_.loops) out.loops.push_back({l.kind, l.extent_param, {}});
    for (size_t s = 0; s < p_.sources.size(); ++s) {
      if (!wrt[s]) continue;
      tangent_source_[s] = static_cast<int32_t>(out.sources.size());
      out.sources.push_back(p_.sources[s]);
      out.sources.back().name = "tangent_" + p_.sources[s].name;
    }
    copies_.assign(p_.instrs.size(), kNone);
    tangents_.assign(p_.instrs.size(), kNone);
  }

  ir::Program run() {
    for (size_t k = 0; k < p_.instrs.size(); ++k) {
      const auto v = static_cast<Value>(k);
      copies_[k] = copy(p_.instrs[k]);
      tangents_[k] = tangent(v, p_.instrs[k]);
    }
    for (const ir::Output& o : p_.outputs) {
      ir::Output out{"tangent_" + o.name, o.type, {}};
      for (const Value v : o.values) out.values.push_back(tangent_or_zero(v));
      trace_.program().outputs.push_back(std::move(out));
    }
    return ir::canonicalise(trace_.program(), true);
  }

 private:
  Value copy(Instr in) {
    switch (in.op) {
      case Op::DETACH:
      case Op::PARTIAL:
        return copies_[in.a];
      case Op::SUM: {
        const ir::Sum& sum = p_.loops[in.a].sums[in.b];
        return add_sum(in.a, copies_[sum.init], copies_[sum.term]);
      }
      default:
        break;
    }
    const char* signature = ir::kOpSignatures[static_cast<int>(in.op)];
    const auto is_value = [](char letter) { return letter != '#' && letter != '-'; };
    if (is_value(signature[1])) in.a = copies_[in.a];
    if (is_value(signature[2])) in.b = copies_[in.b];
    if (is_value(signature[3])) in.c = copies_[in.c];
    return trace_.emit(in);
  }

  // Returns the tangent of a value; kNone means 0.
  Value tangent(Value v, const Instr& in) {
    if (in.op == Op::LOAD_F) {
      const int32_t source = tangent_source_[in.a];
      return source < 0 ? kNone : trace_.emit({Op::LOAD_F, source, copies_[in.b], in.c});
    }
    if (in.op == Op::SUM) {
      const ir::Sum& sum = p_.loops[in.a].sums[in.b];
      if (tangents_[sum.init] == kNone && tangents_[sum.term] == kNone) return kNone;
      return add_sum(in.a, tangent_or_zero(sum.init), tangent_or_zero(sum.term));
    }
    if (in.op == Op::SELECT_F) {
      if (tangents_[in.b] == kNone && tangents_[in.c] == kNone) return kNone;
      return rules_.choose(copies_[in.a], tangent_or_zero(in.b), tangent_or_zero(in.c));
    }
    const auto at = [this](Value primal) { return copies_[primal]; };
    Value total = kNone;
    detail::for_each_differentiable(in, [&](Value operand, int position) {
      if (tangents_[operand] == kNone) return;
      const Value part = rules_.apply(p_, v, position, tangents_[operand], at);
      total = total == kNone ? part : rules_.add(total, part);
    });
    return total;
  }

  Value add_sum(int32_t loop, Value init, Value term) {
    auto& sums = trace_.program().loops[loop].sums;
    sums.push_back({init, term});
    return trace_.emit({Op::SUM, loop, static_cast<int32_t>(sums.size()) - 1});
  }
  Value tangent_or_zero(Value v) { return tangents_[v] == kNone ? rules_.zero() : tangents_[v]; }

  const ir::Program& p_;
  Trace trace_;
  DerivativeRules rules_{trace_};
  std::vector<int32_t> tangent_source_;  // per source of the primal: its tangent's source, or -1
  std::vector<Value> copies_, tangents_;
};

}  // namespace

TangentPlan make_tangent(const ir::Program& program, const std::vector<bool>& wrt) {
  novaphy::require(wrt.size() == program.sources.size(), novaphy::ErrorKind::Value, "kernel '",
                   program.name, "', wrt: expected ", program.sources.size(), " entries, got ",
                   wrt.size());
  for (size_t s = 0; s < wrt.size(); ++s)
    novaphy::require(!wrt[s] || program.sources[s].type == ir::Type::F32, novaphy::ErrorKind::Value,
                     "kernel '", program.name, "', source '", program.sources[s].name,
                     "': integers have no tangent");
  TangentPlan plan{Push(program, wrt).run(), std::vector<bool>(program.sources.size(), false)};
  if (const std::string why = ir::validate(plan.program); !why.empty())
    novaphy::fail(novaphy::ErrorKind::Runtime, "nova: tangent of '", program.name,
                  "' is malformed: ", why);
  for (const Instr& in : plan.program.instrs)
    if ((in.op == Op::LOAD_F || in.op == Op::LOAD_I) &&
        static_cast<size_t>(in.a) < plan.loads_value.size())
      plan.loads_value[in.a] = true;
  return plan;
}

}  // namespace nova
