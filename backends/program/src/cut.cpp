#include "novaphy/program/cut.h"

#include <utility>

namespace nova::ir {
namespace {

size_t at(int32_t k) { return static_cast<size_t>(k); }

class Cutter {
 public:
  Cutter(const Program& p, const std::vector<Available>& sources)
      : p_(p), sources_(sources), guards_(guards(p)), column_(p.instrs.size(), -1) {
    find_needed();
    find_early();
    for (Program* half : {&halves_.early, &halves_.late}) {
      half->name = p.name;
      half->sources = p.sources;
      half->param_count = p.param_count;
      half->contract = p.contract;
    }
    for (auto& clones : clones_) clones.assign(p.instrs.size(), kNone);
  }

  Cut run() {
    find_crossing();
    Program& late = halves_.late;
    late.loops = p_.loops;
    for (size_t k = 0; k < p_.instrs.size(); ++k)
      if (needed_[k] && !early_[k]) clone(static_cast<Value>(k), Late);
    for (Loop& loop : late.loops)
      for (Sum& sum : loop.sums) {
        sum.init = in_late(sum.init);
        sum.term = in_late(sum.term);
      }
    for (const Output& output : p_.outputs) {
      Output& mine = late.outputs.emplace_back(output);
      for (Value& v : mine.values) v = in_late(v);
    }
    return std::move(halves_);
  }

 private:
  enum Half { Early, Late };
  Program& program(Half half) { return half == Early ? halves_.early : halves_.late; }
  Value emit(Half half, const Instr& in) {
    program(half).instrs.push_back(in);
    return static_cast<Value>(program(half).instrs.size()) - 1;
  }

  template <class F>
  void for_each_result(const F& f) const {
    for (const Loop& loop : p_.loops)
      for (const Sum& sum : loop.sums) {
        f(sum.init);
        f(sum.term);
      }
    for (const Output& output : p_.outputs)
      for (const Value v : output.values) f(v);
  }
  void find_needed() {
    needed_.assign(p_.instrs.size(), 0);
    const auto need = [&](Value v) { needed_[at(v)] = 1; };
    for_each_result(need);
    for (size_t k = p_.instrs.size(); k-- > 0;)
      if (needed_[k]) for_each_operand(p_.instrs[k], need);
  }

  // Finds early values: values that depend only on early sources and lie under early conditions
  // only. Reading a row before its condition is known could read past the end.
  void find_early() {
    const std::vector<int32_t> section = sections(p_);
    early_.assign(p_.instrs.size(), 1);
    reads_.assign(p_.instrs.size(), 0);
    for (size_t k = 0; k < p_.instrs.size(); ++k) {
      const Instr& in = p_.instrs[k];
      const bool load = in.op == Op::LOAD_F || in.op == Op::LOAD_I;
      if (section[k] != 0 || in.op == Op::SUM || (load && sources_[at(in.a)] == Available::Late))
        early_[k] = 0;
      reads_[k] = load ? 1 : 0;
      for_each_operand(in, [&](Value v) { reads_[k] |= reads_[at(v)]; });
    }
    for (bool changed = true; changed;) {
      changed = false;
      for (size_t k = 0; k < p_.instrs.size(); ++k) {
        bool still = early_[k] != 0;
        for_each_operand(p_.instrs[k], [&](Value v) { still = still && early_[at(v)]; });
        for (int32_t g = guards_.guard[k]; g > 0; g = guards_.nodes[at(g)].parent)
          still = still && early_[at(guards_.nodes[at(g)].cond)];
        changed = changed || still != (early_[k] != 0);
        early_[k] = still ? 1 : 0;
      }
    }
  }

  // Makes each early value that the late half uses an output of the early half.
  void find_crossing() {
    Output floats{"floats", Type::F32, {}}, ints{"ints", Type::I32, {}};
    const auto use = [&](Value v) {
      if (!early_[at(v)] || !reads_[at(v)] || column_[at(v)] >= 0 || is_at_hand(v)) return;
      Output& output = type_of(v) == Type::F32 ? floats : ints;
      column_[at(v)] = static_cast<int32_t>(output.values.size());
      output.values.push_back(where_needed(v));
    };
    for (size_t k = 0; k < p_.instrs.size(); ++k)
      if (needed_[k] && !early_[k]) for_each_operand(p_.instrs[k], use);
    for_each_result(use);
    for (Output* output : {&floats, &ints}) {
      if (output->values.empty()) continue;
      const auto source = static_cast<int32_t>(halves_.late.sources.size());
      (output == &floats ? float_source_ : int_source_) = source;
      halves_.late.sources.push_back({output->name, output->type,
                                      static_cast<int32_t>(output->values.size()), Access::Direct});
      halves_.early.outputs.push_back(std::move(*output));
    }
  }
  // Returns whether the late half can load the value itself, at its own row.
  bool is_at_hand(Value v) const {
    const Instr& in = p_.instrs[at(v)];
    return (in.op == Op::LOAD_F || in.op == Op::LOAD_I) && sources_[at(in.a)] == Available::Both &&
           p_.instrs[at(in.b)].op == Op::INDEX;
  }
  Type type_of(Value v) const { return result_type(p_.instrs[at(v)].op); }

  // Returns an early value with 0 in lanes that do not need it.
  Value where_needed(Value v) {
    Value value = clone(v, Early);
    const bool is_float = type_of(v) == Type::F32;
    const Value zero = emit(Early, {is_float ? Op::CONST_F : Op::CONST_I, 0});
    if (type_of(v) == Type::Bool)
      value = emit(Early, {Op::SELECT_I, value, emit(Early, {Op::CONST_I, 1}), zero});
    for (int32_t g = guards_.guard[at(v)]; g > 0; g = guards_.nodes[at(g)].parent) {
      const Guard& guard = guards_.nodes[at(g)];
      const Value cond = clone(guard.cond, Early);
      value = emit(Early, {is_float ? Op::SELECT_F : Op::SELECT_I, cond,
                           guard.polarity ? value : zero, guard.polarity ? zero : value});
    }
    return value;
  }

  // Returns an early value for use in the late half: a load of an output of the early half. A value
  // that depends on no source is computed again.
  Value in_late(Value v) {
    const int32_t column = column_[at(v)];
    Value& mapped = clones_[Late][at(v)];
    if (mapped != kNone || column < 0) return clone(v, Late);
    const Value index = emit(Late, {Op::INDEX});
    if (type_of(v) == Type::F32)
      return mapped = emit(Late, {Op::LOAD_F, float_source_, index, column});
    mapped = emit(Late, {Op::LOAD_I, int_source_, index, column});
    if (type_of(v) == Type::Bool)
      mapped = emit(Late, {Op::INE, mapped, emit(Late, {Op::CONST_I, 0})});
    return mapped;
  }
  Value clone(Value v, Half half) {
    Value& mapped = clones_[half][at(v)];
    return mapped != kNone ? mapped : mapped = emit(half, with_operands(v, half));
  }
  Instr with_operands(Value v, Half half) {
    Instr in = p_.instrs[at(v)];
    const char* const signature = kOpSignatures[static_cast<int>(in.op)];
    int32_t* const operands[] = {&in.a, &in.b, &in.c};
    for (int k = 0; k < 3; ++k)
      if (signature[k + 1] != '#' && signature[k + 1] != '-')
        *operands[k] = half == Early ? clone(*operands[k], half) : in_late(*operands[k]);
    return in;
  }

  const Program& p_;
  const std::vector<Available>& sources_;
  const Guards guards_;
  std::vector<char> needed_, early_;  // per value: whether it is needed, and whether it is early
  std::vector<char> reads_;           // per value: whether it depends on a row of a source
  std::vector<int32_t> column_;       // per early value: its column among the outputs of its type,
                                      // or -1
  std::vector<Value> clones_[2];
  int32_t float_source_ = -1, int_source_ = -1;
  Cut halves_;
};

}  // namespace

Cut cut(const Program& program, const std::vector<Available>& sources) {
  return Cutter(program, sources).run();
}

}  // namespace nova::ir
