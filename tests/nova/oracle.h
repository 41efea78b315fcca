// An independent reference for gradients. The oracle runs a traced Program row by row in double
// precision with dual numbers (a value and its derivative in one direction). Its code shares
// nothing with the adjoints, blocks and lanes of the engine.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "novaphy/nova/kernel.h"

namespace novaphy::testing {

namespace ir = nova::ir;

struct Dual {
  double v = 0.0, t = 0.0;
};

// Everything that a launch reads.
struct OracleInputs {
  int64_t dim = 0;
  std::vector<std::vector<Dual>> f32;     // per source; empty for an integer source
  std::vector<std::vector<int32_t>> i32;  // per source; empty for a float source
  std::vector<uint32_t> params;           // without the extent
  int32_t extent = 0;
  std::vector<int32_t> offsets, items;  // for a CSR sum
};

class OracleRow {
 public:
  // `section`: ir::sections of the program.
  OracleRow(const ir::Program& program, const OracleInputs& inputs,
            const std::vector<int32_t>& section, int64_t row)
      : p_(program), in_(inputs), section_(section), row_(row) {
    cells_.resize(p_.instrs.size());
    known_.assign(p_.instrs.size(), 0);
  }

  Dual f(ir::Value v) { return cell(v).f; }

 private:
  struct Cell {
    Dual f;
    int32_t i = 0;
    bool b = false;
  };

  const Cell& cell(ir::Value v) {
    const auto k = static_cast<size_t>(v);
    if (!known_[k]) {
      cells_[k] = compute(p_.instrs[k]);
      known_[k] = 1;
    }
    return cells_[k];
  }

  static Cell of(Dual d) { return {d, 0, false}; }
  static Cell of(int32_t i) { return {{}, i, false}; }
  static Cell of(bool b) { return {{}, 0, b}; }
  static int32_t wrap(int64_t x) { return static_cast<int32_t>(static_cast<uint64_t>(x)); }

  Cell compute(const ir::Instr& in) {
    using ir::Op;
    switch (in.op) {
      case Op::CONST_F:
        return of(Dual{static_cast<double>(std::bit_cast<float>(in.a)), 0.0});
      case Op::CONST_I:
        return of(in.a);
      case Op::CONST_B:
        return of(in.a != 0);
      case Op::PARAM_F:
        return of(Dual{
            static_cast<double>(std::bit_cast<float>(in_.params[static_cast<size_t>(in.a)])), 0.0});
      case Op::PARAM_I:
        return of(static_cast<int32_t>(in_.params[static_cast<size_t>(in.a)]));
      case Op::INDEX:
        return of(static_cast<int32_t>(row_));
      case Op::REDUCE_INDEX:
        return of(counter_);
      case Op::SLOT:
        return of(slot_);
      case Op::SUM:
        return of(sum(in.a, in.b));
      case Op::LOAD_F:
      case Op::LOAD_I:
        return load(in);
      case Op::SELECT_F:
      case Op::SELECT_I:
      case Op::SELECT_B:
        return cell(cell(in.a).b ? in.b : in.c);
      case Op::PARTIAL: {
        const Dual a = f(in.a), b = f(in.b), c = f(in.c);
        return of(Dual{a.v, a.t + c.v * b.t});
      }
      case Op::DETACH:
        return of(Dual{f(in.a).v, 0.0});
      default:
        break;
    }
    const char* signature = ir::kOpSignatures[static_cast<int>(in.op)];
    return signature[1] == 'f' ? of_floats(in) : of_others(in);
  }

  Cell load(const ir::Instr& in) {
    const auto s = static_cast<size_t>(in.a);
    const int32_t row = cell(in.b).i;
    const auto at = static_cast<size_t>(row) * static_cast<size_t>(p_.sources[s].width) +
                    static_cast<size_t>(in.c);
    if (in.op == ir::Op::LOAD_F) return of(row < 0 ? Dual{} : in_.f32[s].at(at));
    return of(row < 0 ? 0 : in_.i32[s].at(at));
  }

  Cell of_floats(const ir::Instr& in) {
    using ir::Op;
    const Dual a = f(in.a);
    Dual b, c;
    const char* signature = ir::kOpSignatures[static_cast<int>(in.op)];
    if (signature[2] == 'f') b = f(in.b);
    if (signature[3] == 'f') c = f(in.c);
    switch (in.op) {
      case Op::ADD:
        return of(Dual{a.v + b.v, a.t + b.t});
      case Op::SUB:
        return of(Dual{a.v - b.v, a.t - b.t});
      case Op::MUL:
        return of(Dual{a.v * b.v, a.t * b.v + a.v * b.t});
      case Op::DIV:
        return of(Dual{a.v / b.v, (a.t * b.v - a.v * b.t) / (b.v * b.v)});
      case Op::NEG:
        return of(Dual{-a.v, -a.t});
      case Op::ABS:
        return of(a.v < 0.0 ? Dual{-a.v, -a.t} : a);
      case Op::SIGN:
        return of(Dual{a.v < 0.0 ? -1.0 : 1.0, 0.0});
      case Op::MIN:
        return of(Dual{a.v <= b.v ? a.v : b.v, a.v < b.v ? a.t : b.t});
      case Op::MAX:
        return of(Dual{a.v >= b.v ? a.v : b.v, a.v > b.v ? a.t : b.t});
      case Op::SQRT:
        return of(Dual{std::sqrt(a.v), a.v > 0.0 ? a.t * 0.5 / std::sqrt(a.v) : 0.0});
      case Op::FMA:
        return of(Dual{a.v * b.v + c.v, a.t * b.v + a.v * b.t + c.t});
      case Op::FLOOR:
        return of(Dual{std::floor(a.v), 0.0});
      case Op::LT:
        return of(a.v < b.v);
      case Op::LE:
        return of(a.v <= b.v);
      case Op::EQ:
        return of(a.v == b.v);
      case Op::NE:
        return of(a.v != b.v);
      case Op::F_TO_I:
        return of(static_cast<int32_t>(a.v));
      case Op::F_BITS:
        return of(std::bit_cast<int32_t>(static_cast<float>(a.v)));
      default:
        throw std::logic_error(ir::kOpNames[static_cast<int>(in.op)]);
    }
  }

  Cell of_others(const ir::Instr& in) {
    using ir::Op;
    const Cell a = cell(in.a);
    const Cell b = ir::kOpSignatures[static_cast<int>(in.op)][2] == '-' ? Cell{} : cell(in.b);
    switch (in.op) {
      case Op::IADD:
        return of(wrap(int64_t{a.i} + b.i));
      case Op::ISUB:
        return of(wrap(int64_t{a.i} - b.i));
      case Op::IMUL:
        return of(wrap(int64_t{a.i} * b.i));
      case Op::IDIV:
        return of(b.i == 0 ? 0 : wrap(int64_t{a.i} / b.i));
      case Op::IMOD:
        return of(b.i == 0 ? 0 : wrap(int64_t{a.i} % b.i));
      case Op::IMIN:
        return of(a.i <= b.i ? a.i : b.i);
      case Op::IMAX:
        return of(a.i >= b.i ? a.i : b.i);
      case Op::IAND:
        return of(a.i & b.i);
      case Op::IOR:
        return of(a.i | b.i);
      case Op::IXOR:
        return of(a.i ^ b.i);
      case Op::ISHL:
        return of(wrap(static_cast<int64_t>(static_cast<uint32_t>(a.i) << (b.i & 31))));
      case Op::ISHR:
        return of(a.i >> (b.i & 31));
      case Op::IUSHR:
        return of(wrap(static_cast<int64_t>(static_cast<uint32_t>(a.i) >> (b.i & 31))));
      case Op::ILT:
        return of(a.i < b.i);
      case Op::ILE:
        return of(a.i <= b.i);
      case Op::IEQ:
        return of(a.i == b.i);
      case Op::INE:
        return of(a.i != b.i);
      case Op::AND:
        return of(a.b && b.b);
      case Op::OR:
        return of(a.b || b.b);
      case Op::NOT:
        return of(!a.b);
      case Op::I_TO_F:
        return of(Dual{static_cast<double>(a.i), 0.0});
      case Op::BITS_F:
        return of(Dual{static_cast<double>(std::bit_cast<float>(a.i)), 0.0});
      default:
        throw std::logic_error(ir::kOpNames[static_cast<int>(in.op)]);
    }
  }

  Dual sum(int32_t l, int32_t s) {
    const ir::Loop& loop = p_.loops[static_cast<size_t>(l)];
    const ir::Sum& of_loop = loop.sums[static_cast<size_t>(s)];
    Dual acc = f(of_loop.init);
    const bool csr = loop.kind == ir::LoopKind::Csr;
    const auto row = static_cast<size_t>(row_);
    const int32_t begin = csr ? in_.offsets[row] : 0;
    const int32_t count = csr ? in_.offsets[row + 1] - begin : in_.extent;
    for (int32_t r = 0; r < count; ++r) {
      for (size_t v = 0; v < known_.size(); ++v)
        if (section_[v] == 2 * l + 1) known_[v] = 0;
      counter_ = r;
      slot_ = csr ? in_.items[static_cast<size_t>(begin + r)] : 0;
      const Dual term = f(of_loop.term);
      acc = {acc.v + term.v, acc.t + term.t};
    }
    return acc;
  }

  const ir::Program& p_;
  const OracleInputs& in_;
  const std::vector<int32_t>& section_;
  std::vector<Cell> cells_;
  std::vector<char> known_;
  int64_t row_;
  int32_t counter_ = 0, slot_ = 0;
};

// Values and derivatives of all outputs, {dim, width} each.
inline std::vector<std::vector<Dual>> oracle(const ir::Program& program,
                                             const OracleInputs& inputs) {
  std::vector<std::vector<Dual>> outputs(program.outputs.size());
  const std::vector<int32_t> section = ir::sections(program);
  for (int64_t i = 0; i < inputs.dim; ++i) {
    OracleRow row(program, inputs, section, i);
    for (size_t o = 0; o < outputs.size(); ++o)
      for (const ir::Value v : program.outputs[o].values) outputs[o].push_back(row.f(v));
  }
  return outputs;
}

}  // namespace novaphy::testing
