#include "lowering.h"

#include <algorithm>
#include <map>
#include <tuple>

namespace novaphy::cpu {
namespace {

namespace ir = nova::ir;
using ir::Op;

CpuOp cpu_op(Op op) {
  switch (op) {
    case Op::NEG:
      return NEG;
    case Op::ABS:
      return ABS;
    case Op::SIGN:
      return SIGN;
    case Op::SQRT:
      return SQRT;
    case Op::FLOOR:
      return FLOOR;
    case Op::NOT:
      return NOT;
    case Op::F_TO_I:
      return F_TO_I;
    case Op::I_TO_F:
      return I_TO_F;
    case Op::ADD:
      return ADD;
    case Op::SUB:
      return SUB;
    case Op::MUL:
      return MUL;
    case Op::DIV:
      return DIV;
    case Op::MIN:
      return MIN;
    case Op::MAX:
      return MAX;
    case Op::IADD:
      return IADD;
    case Op::ISUB:
      return ISUB;
    case Op::IMUL:
      return IMUL;
    case Op::IDIV:
      return IDIV;
    case Op::IMOD:
      return IMOD;
    case Op::IMIN:
      return IMIN;
    case Op::IMAX:
      return IMAX;
    case Op::IAND:
    case Op::AND:
      return IAND;  // bools are masks of all 0 or all 1 bits
    case Op::IOR:
    case Op::OR:
      return IOR;
    case Op::IXOR:
      return IXOR;
    case Op::ISHL:
      return ISHL;
    case Op::ISHR:
      return ISHR;
    case Op::IUSHR:
      return IUSHR;
    case Op::LT:
      return LT;
    case Op::LE:
      return LE;
    case Op::EQ:
      return EQ;
    case Op::NE:
      return NE;
    case Op::ILT:
      return ILT;
    case Op::ILE:
      return ILE;
    case Op::IEQ:
      return IEQ;
    case Op::INE:
      return INE;
    case Op::FMA:
      return FMA;
    case Op::SELECT_F:
    case Op::SELECT_I:
    case Op::SELECT_B:
      return SELECT;
    // The switch has no default, so that the compiler reports a missing new operation. The cases
    // below are leaves, loads, aliases and trace operations.
    case Op::CONST_F:
    case Op::CONST_I:
    case Op::CONST_B:
    case Op::PARAM_F:
    case Op::PARAM_I:
    case Op::INDEX:
    case Op::REDUCE_INDEX:
    case Op::SLOT:
    case Op::SUM:
    case Op::LOAD_F:
    case Op::LOAD_I:
    case Op::F_BITS:
    case Op::BITS_F:
    case Op::PARTIAL:
    case Op::DETACH:
      break;
  }
  return kArithmeticOps;
}

bool is_load(Op op) { return op == Op::LOAD_F || op == Op::LOAD_I; }

class Lowerer {
 public:
  Lowerer(const ir::Program& program, const std::vector<ir::Step>& steps, bool scalar_form)
      : p_(program), steps_(steps), scalar_form_(scalar_form) {}

  Lowered run() {
    make_values();
    find_uniform();
    locate_steps();
    count_uses();
    join_multiply_add();
    group_loads();
    emit();
    for (const ir::Output& output : p_.outputs) {
      std::vector<ValueId> values;
      for (const ir::Value v : output.values) values.push_back(resolve(v));
      out_.outputs.push_back(std::move(values));
    }
    find_index_use();
    place_leaves();
    place_values(out_, scalar_form_);
    return std::move(out_);
  }

 private:
  ValueId resolve(ir::Value v) const { return alias_[static_cast<size_t>(v)]; }

  ValueId new_value(bool uniform) {
    uniform_.push_back(uniform || scalar_form_);
    return next_value_++;
  }

  void make_values() {
    const size_t count = p_.instrs.size();
    next_value_ = static_cast<ValueId>(count);
    uniform_.assign(count, false);
    out_.index_value = new_value(false);
    out_.loops.resize(p_.loops.size());
    for (size_t l = 0; l < p_.loops.size(); ++l) {
      LoopValues& loop = out_.loops[l];
      const size_t sums = p_.loops[l].sums.size();
      for (size_t s = 0; s < sums; ++s) loop.accumulators.push_back(new_value(false));
      if (p_.loops[l].kind == ir::LoopKind::Csr && !scalar_form_) {
        loop.start = new_value(false);
        loop.length = new_value(false);
        loop.active = new_value(false);
      }
    }
    // F_BITS and BITS_F only reinterpret a word, and SUM is an alias of its accumulator.
    alias_.resize(count);
    for (size_t v = 0; v < count; ++v) {
      const ir::Instr& in = p_.instrs[v];
      alias_[v] = static_cast<ValueId>(v);
      if (in.op == Op::F_BITS || in.op == Op::BITS_F) alias_[v] = resolve(in.a);
      if (in.op == Op::INDEX) alias_[v] = out_.index_value;
      if (in.op == Op::SUM) {
        alias_[v] = out_.loops[static_cast<size_t>(in.a)].accumulators[static_cast<size_t>(in.b)];
      }
      if (in.op == Op::REDUCE_INDEX || in.op == Op::SLOT) {
        LoopValues& loop = out_.loops[static_cast<size_t>(in.a)];
        ValueId& first = in.op == Op::SLOT ? loop.slot : loop.reduce;
        if (first == kNoValue) first = static_cast<ValueId>(v);
        alias_[v] = first;
      }
    }
    for (size_t l = 0; l < p_.loops.size(); ++l) {
      for (const ir::Sum& sum : p_.loops[l].sums) {
        out_.loops[l].inits.push_back(resolve(sum.init));
        out_.loops[l].terms.push_back(resolve(sum.term));
      }
    }
  }

  void find_uniform() {
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const ir::Instr& in = p_.instrs[v];
      bool uniform = in.op != Op::INDEX && in.op != Op::SLOT && in.op != Op::SUM;
      ir::for_each_operand(
          in, [&](ir::Value o) { uniform = uniform && uniform_[static_cast<size_t>(resolve(o))]; });
      uniform_[v] = uniform || scalar_form_;
    }
  }

  // Finds the loop and the skip region around each step.
  void locate_steps() {
    scope_of_.assign(p_.instrs.size(), {-1, -1});
    std::vector<std::pair<int32_t, int32_t>> open;  // (end, region)
    int32_t loop = -1;
    for (size_t s = 0; s < steps_.size(); ++s) {
      while (!open.empty() && open.back().first <= static_cast<int32_t>(s)) open.pop_back();
      const ir::Step& step = steps_[s];
      if (step.kind == ir::Step::Kind::LoopBegin) loop = step.value;
      if (step.kind == ir::Step::Kind::LoopEnd) loop = -1;
      if (step.kind == ir::Step::Kind::SkipIfNone)
        open.emplace_back(step.target, static_cast<int32_t>(s));
      if (step.kind == ir::Step::Kind::Compute) {
        scope_of_[static_cast<size_t>(step.value)] = {loop, open.empty() ? -1 : open.back().second};
      }
    }
  }

  void count_uses() {
    uses_.assign(static_cast<size_t>(next_value_), 0);
    const auto use = [&](ValueId v) { ++uses_[static_cast<size_t>(v)]; };
    for (const ir::Step& step : steps_) {
      if (step.kind == ir::Step::Kind::SkipIfNone) use(resolve(step.value));
      if (step.kind != ir::Step::Kind::Compute) continue;
      const ir::Instr& in = p_.instrs[static_cast<size_t>(step.value)];
      if (in.op == Op::F_BITS || in.op == Op::BITS_F)
        continue;  // the uses of an alias count as uses of its operand
      ir::for_each_operand(in, [&](ir::Value o) { use(resolve(o)); });
    }
    for (const LoopValues& loop : out_.loops) {
      for (const ValueId v : loop.inits) use(v);
      for (const ValueId v : loop.terms) use(v);
    }
    for (const ir::Output& output : p_.outputs) {
      for (const ir::Value v : output.values) use(resolve(v));
    }
  }

  // Merges a * b into an addition next to it, if the addition is its only use. The merged operation
  // rounds twice, as before. A product never moves into a skip region, whose lanes differ.
  void join_multiply_add() {
    joined_.assign(p_.instrs.size(), kNoValue);
    absorbed_.assign(p_.instrs.size(), false);
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const ir::Instr& in = p_.instrs[v];
      if (in.op != Op::ADD && in.op != Op::SUB) continue;
      for (const ir::Value operand : {in.b, in.a}) {
        const ValueId m = resolve(operand);
        if (static_cast<size_t>(m) >= p_.instrs.size() ||
            p_.instrs[static_cast<size_t>(m)].op != Op::MUL)
          continue;
        const auto k = static_cast<size_t>(m);
        if (uses_[k] != 1 || uniform_[k] != uniform_[v] || scope_of_[k] != scope_of_[v]) continue;
        joined_[v] = m;
        absorbed_[k] = true;
        break;
      }
    }
  }

  // Merges loads of consecutive columns of a row, in the same loop and skip region, into one item
  // at the position of the first load.
  void group_loads() {
    using Key = std::tuple<int32_t, ValueId, int32_t, int32_t>;  // source, row, loop, region
    std::map<Key, std::vector<std::pair<int32_t, ValueId>>> columns;
    for (const ir::Step& step : steps_) {
      if (step.kind != ir::Step::Kind::Compute ||
          !is_load(p_.instrs[static_cast<size_t>(step.value)].op))
        continue;
      const ir::Instr& in = p_.instrs[static_cast<size_t>(step.value)];
      const auto& place = scope_of_[static_cast<size_t>(step.value)];
      columns[{in.a, resolve(in.b), place.first, place.second}].emplace_back(in.c, step.value);
    }
    groups_at_.resize(p_.instrs.size());
    for (auto& [key, loads] : columns) {
      const ValueId leader = loads.front().second;  // first load in the order of steps
      std::sort(loads.begin(), loads.end());
      for (size_t k = 0; k < loads.size();) {
        LoadGroup group{std::get<0>(key), loads[k].first, std::get<1>(key), {}};
        do {
          group.targets.push_back(loads[k++].second);
        } while (k < loads.size() &&
                 loads[k].first == group.column + static_cast<int32_t>(group.targets.size()) &&
                 group.targets.size() < static_cast<size_t>(kMaxLoadColumns));
        groups_at_[static_cast<size_t>(leader)].push_back(static_cast<int32_t>(out_.groups.size()));
        out_.groups.push_back(std::move(group));
      }
    }
  }

  void emit() {
    std::vector<int32_t> item_of_step(steps_.size() + 1, 0);
    std::vector<std::pair<int32_t, int32_t>> open;  // (end step, item)
    int32_t loop = -1;
    for (size_t s = 0; s < steps_.size(); ++s) {
      item_of_step[s] = static_cast<int32_t>(out_.items.size());
      while (!open.empty() && open.back().first <= static_cast<int32_t>(s)) open.pop_back();
      const ir::Step& step = steps_[s];
      Item item{};
      item.loop = loop;
      item.region = open.empty() ? -1 : open.back().second;
      const auto number = static_cast<int32_t>(out_.items.size());
      switch (step.kind) {
        case ir::Step::Kind::Compute:
          emit_compute(step.value, item);
          break;
        case ir::Step::Kind::SkipIfNone:
          item.kind = Item::Kind::Skip;
          item.a = resolve(step.value);
          item.polarity = step.polarity;
          item.target = step.target;
          open.emplace_back(step.target, number);
          out_.items.push_back(item);
          break;
        case ir::Step::Kind::LoopBegin:
          item.kind = Item::Kind::LoopBegin;
          loop = item.loop = step.value;
          out_.loops[static_cast<size_t>(loop)].begin = number;
          out_.items.push_back(item);
          break;
        case ir::Step::Kind::LoopEnd:
          item.kind = Item::Kind::LoopEnd;
          item.loop = step.value;
          out_.loops[static_cast<size_t>(step.value)].end = number;
          loop = -1;
          out_.items.push_back(item);
          break;
      }
    }
    item_of_step[steps_.size()] = static_cast<int32_t>(out_.items.size());
    for (Item& item : out_.items) {
      if (item.kind == Item::Kind::Skip)
        item.target = item_of_step[static_cast<size_t>(item.target)];
    }
  }

  void emit_compute(ir::Value value, Item item) {
    const auto v = static_cast<size_t>(value);
    const ir::Instr& in = p_.instrs[v];
    item.uniform = uniform_[v];
    if (is_load(in.op)) {
      for (const int32_t group : groups_at_[v]) {
        item.kind = Item::Kind::Load;
        item.group = group;
        item.a = out_.groups[static_cast<size_t>(group)].row;
        out_.items.push_back(item);
      }
      return;
    }
    item.op = cpu_op(in.op);
    if (item.op == kArithmeticOps || absorbed_[v]) return;  // a leaf or an alias
    item.kind = Item::Kind::Op;
    item.d = value;
    ValueId* const operands[3] = {&item.a, &item.b, &item.c};
    size_t count = 0;  // operands are counted by signature; words of absent operands are arbitrary
    ir::for_each_operand(in, [&](ir::Value o) { *operands[count++] = resolve(o); });
    if (joined_[v] != kNoValue) {
      const ir::Instr& product = p_.instrs[static_cast<size_t>(joined_[v])];
      const bool second = item.b == joined_[v];
      item.op = in.op == Op::ADD ? MUL_ADD : second ? SUB_MUL : MUL_SUB;
      item.c = second ? item.a : item.b;
      item.a = resolve(product.a);
      item.b = resolve(product.b);
    }
    out_.items.push_back(item);
  }

  void find_index_use() {
    const ValueId index = out_.index_value;
    for (const Item& item : out_.items) {
      const bool as_row = item.kind == Item::Kind::Load && item.a == index;
      if (!as_row && (item.a == index || item.b == index || item.c == index))
        out_.index_used = true;
    }
    const auto look = [&](const std::vector<ValueId>& values) {
      if (std::find(values.begin(), values.end(), index) != values.end()) out_.index_used = true;
    };
    for (const auto& values : out_.outputs) look(values);
    for (const LoopValues& loop : out_.loops) {
      look(loop.inits);
      look(loop.terms);
    }
  }

  // Constants (one for each bit pattern) and parameters are scalars, which are set at the start of
  // a launch.
  void place_leaves() {
    out_.place.assign(static_cast<size_t>(next_value_), {-1, 0});
    for (size_t v = 0; v < out_.place.size(); ++v) out_.place[v].uniform = uniform_[v] ? 1 : 0;
    std::map<uint32_t, int32_t> constants;
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const ir::Instr& in = p_.instrs[v];
      if (in.op != Op::CONST_F && in.op != Op::CONST_I && in.op != Op::CONST_B) continue;
      if (uses_[v] == 0) continue;
      uint32_t bits = static_cast<uint32_t>(in.a);
      if (in.op == Op::CONST_B) bits = in.a != 0 ? 0xFFFFFFFFu : 0u;
      const auto [at, added] = constants.emplace(bits, static_cast<int32_t>(out_.constants.size()));
      if (added) out_.constants.push_back(bits);
      out_.place[v].slot = at->second;
    }
    std::map<int32_t, int32_t> parameters;
    for (size_t v = 0; v < p_.instrs.size(); ++v) {
      const ir::Instr& in = p_.instrs[v];
      if ((in.op != Op::PARAM_F && in.op != Op::PARAM_I) || uses_[v] == 0) continue;
      const auto next = static_cast<int32_t>(out_.constants.size() + out_.parameters.size());
      const auto [at, added] = parameters.emplace(in.a, next);
      if (added) out_.parameters.push_back(in.a);
      out_.place[v].slot = at->second;
    }
    out_.scalar_count = static_cast<int32_t>(out_.constants.size() + out_.parameters.size());
  }

  const ir::Program& p_;
  const std::vector<ir::Step>& steps_;
  const bool scalar_form_;
  Lowered out_;
  ValueId next_value_ = 0;
  std::vector<ValueId> alias_;
  std::vector<char> uniform_;
  std::vector<std::pair<int32_t, int32_t>> scope_of_;  // per instruction: loop, region
  std::vector<int32_t> uses_;
  std::vector<ValueId> joined_;  // the product merged into an addition
  std::vector<char> absorbed_;   // products merged into an addition
  std::vector<std::vector<int32_t>> groups_at_;
};

}  // namespace

Lowered lower(const ir::Program& program, const std::vector<ir::Step>& steps, bool scalar_form) {
  return Lowerer(program, steps, scalar_form).run();
}

}  // namespace novaphy::cpu
