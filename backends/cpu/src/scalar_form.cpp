#include <algorithm>

#include "lowering.h"
#include "module.h"

namespace novaphy::cpu {
namespace {

class ScalarBuilder {
 public:
  ScalarBuilder(const nova::ir::Program& program, const Lowered& lowered)
      : p_(program), l_(lowered) {}

  ScalarForm run() {
    constexpr int32_t kMax = 0xFFFF;
    if (l_.scalar_count > kMax || p_.sources.size() > kMax || p_.outputs.size() > kMax ||
        p_.loops.size() > kMax)
      return {};
    out_.usable = true;
    out_.constants = l_.constants;
    for (const int32_t parameter : l_.parameters) {
      out_.parameter_words.push_back(p_.param_argument(static_cast<size_t>(parameter)));
    }
    out_.scalar_count = l_.scalar_count;
    out_.index = slot(l_.index_value);
    for (const auto& source : p_.sources) out_.source_widths.push_back(source.width);
    for (const auto& output : p_.outputs)
      out_.output_widths.push_back(static_cast<int32_t>(output.values.size()));
    make_loops();
    std::vector<int32_t> at(l_.items.size() + 1);
    for (size_t k = 0; k < l_.items.size(); ++k) {
      at[k] = static_cast<int32_t>(out_.code.size());
      emit(l_.items[k]);
    }
    at[l_.items.size()] = static_cast<int32_t>(out_.code.size());
    set_jumps(at);
    emit_stores();
    out_.code.push_back(make(kEnd));
    return std::move(out_);
  }

 private:
  int32_t slot(ValueId v) const { return l_.place[static_cast<size_t>(v)].slot; }
  uint16_t short_slot(ValueId v) const { return static_cast<uint16_t>(slot(v)); }
  Operand operand(ValueId v) const { return {slot(v), 1}; }
  static ScalarInstr make(uint16_t op) { return {op, 0, 0, 0, 0, 0, 0, 0}; }

  void make_loops() {
    for (size_t k = 0; k < l_.loops.size(); ++k) {
      const LoopValues& values = l_.loops[k];
      LoopCode loop{};
      loop.csr = p_.loops[k].kind == nova::ir::LoopKind::Csr ? 1 : 0;
      loop.word = static_cast<int32_t>(
          loop.csr != 0 ? p_.loop_argument(k)
                        : p_.param_argument(static_cast<size_t>(p_.loops[k].extent_param)));
      loop.reduce = values.reduce == kNoValue ? -1 : slot(values.reduce);
      loop.slot = values.slot == kNoValue ? -1 : slot(values.slot);
      loop.sums_begin = static_cast<int32_t>(out_.sums.size());
      for (size_t s = 0; s < values.accumulators.size(); ++s) {
        out_.sums.push_back(
            {operand(values.accumulators[s]), operand(values.inits[s]), operand(values.terms[s])});
      }
      loop.sums_end = static_cast<int32_t>(out_.sums.size());
      out_.loops.push_back(loop);
    }
  }

  void emit(const Item& item) {
    ScalarInstr in = make(item.op);
    switch (item.kind) {
      case Item::Kind::Op:
        in.d = short_slot(item.d);
        in.a = short_slot(item.a);
        if (item.b != kNoValue) in.b = short_slot(item.b);
        if (item.c != kNoValue) in.c = short_slot(item.c);
        break;
      case Item::Kind::Load: {
        const LoadGroup& group = l_.groups[static_cast<size_t>(item.group)];
        const bool own_row = group.row == l_.index_value;
        in.op = static_cast<uint16_t>((own_row ? kLoadRow1 : kLoadAt1) + group.targets.size() - 1);
        in.a = static_cast<uint16_t>(group.source);
        if (!own_row) in.b = short_slot(group.row);
        in.c = static_cast<uint16_t>(group.column);
        uint16_t* const targets[kMaxLoadColumns] = {&in.d, &in.e, &in.f, &in.g};
        for (size_t k = 0; k < group.targets.size(); ++k)
          *targets[k] = short_slot(group.targets[k]);
        break;
      }
      case Item::Kind::Skip:
        in.op = item.polarity ? kSkipUnless : kSkipIf;
        in.a = short_slot(item.a);
        break;
      case Item::Kind::LoopBegin:
      case Item::Kind::LoopEnd:
        in.op = item.kind == Item::Kind::LoopBegin ? kLoopBegin : kLoopEnd;
        in.a = static_cast<uint16_t>(item.loop);
        break;
    }
    out_.code.push_back(in);
  }

  void set_jumps(const std::vector<int32_t>& at) {
    for (size_t k = 0; k < l_.items.size(); ++k) {
      const Item& item = l_.items[k];
      ScalarInstr& in = out_.code[static_cast<size_t>(at[k])];
      if (item.kind == Item::Kind::Skip) {
        const int32_t to = at[static_cast<size_t>(item.target)];
        in.b = static_cast<uint16_t>(to & 0xFFFF);
        in.c = static_cast<uint16_t>(to >> 16);
      }
      if (item.kind == Item::Kind::LoopBegin)
        out_.loops[static_cast<size_t>(item.loop)].body = at[k] + 1;
      if (item.kind == Item::Kind::LoopEnd)
        out_.loops[static_cast<size_t>(item.loop)].after = at[k] + 1;
    }
  }

  void emit_stores() {
    for (size_t o = 0; o < l_.outputs.size(); ++o) {
      const auto& values = l_.outputs[o];
      for (size_t column = 0; column < values.size(); column += 4) {
        const size_t count = std::min<size_t>(4, values.size() - column);
        ScalarInstr in = make(static_cast<uint16_t>(kStore1 + count - 1));
        in.a = static_cast<uint16_t>(o);
        in.c = static_cast<uint16_t>(column);
        uint16_t* const sources[4] = {&in.d, &in.e, &in.f, &in.g};
        for (size_t k = 0; k < count; ++k) *sources[k] = short_slot(values[column + k]);
        out_.code.push_back(in);
      }
    }
  }

  const nova::ir::Program& p_;
  const Lowered& l_;
  ScalarForm out_;
};

}  // namespace

ScalarForm make_scalar_form(const nova::ir::Program& program,
                            const std::vector<nova::ir::Step>& steps) {
  const Lowered lowered = lower(program, steps, true);
  return ScalarBuilder(program, lowered).run();
}

static double operations_of(const nova::ir::Program& program) {
  constexpr int kLoad = 8;
  int count = 0;
  for (const nova::ir::Instr& in : program.instrs)
    count += in.op == nova::ir::Op::LOAD_F || in.op == nova::ir::Op::LOAD_I ? kLoad : 1;
  return count;
}

Executable::Executable(nova::ir::Program p, const IsaTable& table)
    : program(std::move(p)),
      argument_count(program.argument_count()),
      first_output(program.output_argument(0)),
      isa(table),
      native(find_native(program, table.name)),
      operations(operations_of(program)) {
  if (native.rows == nullptr) interpreted();
}

const Interpreted& Executable::interpreted() const {
  std::call_once(once_, [this] {
    const std::vector<nova::ir::Step> steps = nova::ir::schedule(program);
    interpreted_ = {make_block_form(program, steps, isa), make_scalar_form(program, steps)};
  });
  return interpreted_;
}

}  // namespace novaphy::cpu
