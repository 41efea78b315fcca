// The meaning of a Program as stated in program.h, written for clarity: one row at a time, every
// value on demand.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "harness.h"

namespace conformance {
namespace {

float to_float(uint32_t word) {
  float value;
  std::memcpy(&value, &word, 4);
  return value;
}

int32_t f_to_i(float a) {
  if (std::isnan(a)) return 0;
  if (a >= 2147483648.0f) return std::numeric_limits<int32_t>::max();
  if (a < -2147483648.0f) return std::numeric_limits<int32_t>::min();
  return static_cast<int32_t>(a);
}

uint32_t arithmetic(ir::Op op, uint32_t a, uint32_t b, uint32_t c) {
  const float fa = to_float(a), fb = to_float(b), fc = to_float(c);
  const auto ia = static_cast<int32_t>(a), ib = static_cast<int32_t>(b);
  using ir::Op;
  switch (op) {
    case Op::ADD:
      return bits(fa + fb);
    case Op::SUB:
      return bits(fa - fb);
    case Op::MUL:
      return bits(fa * fb);
    case Op::DIV:
      return bits(fa / fb);
    case Op::NEG:
      return a ^ 0x80000000u;
    case Op::ABS:
      return a & 0x7FFFFFFFu;
    case Op::SIGN:
      return bits(fa < 0.0f ? -1.0f : 1.0f);
    case Op::MIN:
      return fa <= fb ? a : b;
    case Op::MAX:
      return fa >= fb ? a : b;
    case Op::SQRT:
      return bits(std::sqrt(fa));
    case Op::FMA:
      return bits(std::fma(fa, fb, fc));
    case Op::FLOOR:
      return bits(std::floor(fa));
    case Op::IADD:
      return a + b;
    case Op::ISUB:
      return a - b;
    case Op::IMUL:
      return a * b;
    case Op::IDIV:
      return ib == 0 ? 0 : static_cast<uint32_t>(static_cast<int64_t>(ia) / ib);
    case Op::IMOD:
      return ib == 0 ? 0 : static_cast<uint32_t>(static_cast<int64_t>(ia) % ib);
    case Op::IMIN:
      return ia <= ib ? a : b;
    case Op::IMAX:
      return ia >= ib ? a : b;
    case Op::IAND:
      return a & b;
    case Op::IOR:
      return a | b;
    case Op::IXOR:
      return a ^ b;
    case Op::ISHL:
      return a << (b & 31);
    case Op::ISHR:
      return static_cast<uint32_t>(ia >> (b & 31));
    case Op::IUSHR:
      return a >> (b & 31);
    case Op::LT:
      return fa < fb;
    case Op::LE:
      return fa <= fb;
    case Op::EQ:
      return fa == fb;
    case Op::NE:
      return fa != fb;
    case Op::ILT:
      return ia < ib;
    case Op::ILE:
      return ia <= ib;
    case Op::IEQ:
      return ia == ib;
    case Op::INE:
      return ia != ib;
    case Op::AND:
      return a & b;
    case Op::OR:
      return a | b;
    case Op::NOT:
      return a ^ 1u;
    case Op::F_TO_I:
      return bits(f_to_i(fa));
    case Op::I_TO_F:
      return bits(static_cast<float>(ia));
    case Op::F_BITS:
    case Op::BITS_F:
      return a;
    default:
      break;
  }
  ADD_FAILURE() << "the reference lacks op " << ir::kOpNames[static_cast<int>(op)];
  return 0;
}

class Row {
 public:
  Row(const ir::Program& program, const Inputs& inputs, int64_t row)
      : p_(program), inputs_(inputs), section_(ir::sections(program)), row_(row) {
    values_.resize(p_.instrs.size());
    known_.assign(p_.instrs.size(), 0);
  }

  uint32_t value(ir::Value v) {
    const auto k = static_cast<size_t>(v);
    if (known_[k] == 0) {
      values_[k] = compute(p_.instrs[k]);
      known_[k] = 1;
    }
    return values_[k];
  }

 private:
  uint32_t compute(const ir::Instr& in) {
    using ir::Op;
    switch (in.op) {
      case Op::CONST_F:
      case Op::CONST_I:
      case Op::CONST_B:
        return static_cast<uint32_t>(in.a);
      case Op::PARAM_F:
      case Op::PARAM_I:
        return inputs_.parameters[static_cast<size_t>(in.a)];
      case Op::INDEX:
        return static_cast<uint32_t>(row_);
      case Op::REDUCE_INDEX:
        return static_cast<uint32_t>(counter_);
      case Op::SLOT:
        return slot_;
      case Op::SUM:
        return sum(static_cast<size_t>(in.a), static_cast<size_t>(in.b));
      case Op::LOAD_F:
      case Op::LOAD_I: {
        const auto s = static_cast<size_t>(in.a);
        const int64_t row = static_cast<int32_t>(value(in.b));
        const int64_t width = p_.sources[s].width;
        const auto rows = static_cast<int64_t>(inputs_.sources[s].size()) / width;
        if (row < 0 || row >= rows) return 0;
        return inputs_.sources[s][static_cast<size_t>(row * width + in.c)];
      }
      case Op::SELECT_F:
      case Op::SELECT_I:
      case Op::SELECT_B:
        return value(in.a) != 0 ? value(in.b) : value(in.c);
      default:
        break;
    }
    uint32_t operands[3] = {0, 0, 0};
    const int32_t ids[3] = {in.a, in.b, in.c};
    const char* signature = ir::kOpSignatures[static_cast<int>(in.op)];
    for (int k = 0; k < 3; ++k) {
      if (signature[k + 1] != '-' && signature[k + 1] != '#') operands[k] = value(ids[k]);
    }
    return arithmetic(in.op, operands[0], operands[1], operands[2]);
  }

  uint32_t sum(size_t l, size_t s) {
    const ir::Loop& loop = p_.loops[l];
    float acc = to_float(value(loop.sums[s].init));
    int64_t start = 0, extent = 0;
    size_t csr = 0;
    for (size_t k = 0; k < l; ++k) csr += p_.loops[k].kind == ir::LoopKind::Csr ? 1 : 0;
    const bool is_csr = loop.kind == ir::LoopKind::Csr;
    if (is_csr) {
      start = static_cast<int32_t>(inputs_.offsets[csr][static_cast<size_t>(row_)]);
      extent = static_cast<int32_t>(inputs_.offsets[csr][static_cast<size_t>(row_) + 1]) - start;
    } else {
      extent = static_cast<int32_t>(inputs_.parameters[static_cast<size_t>(loop.extent_param)]);
    }
    for (int64_t r = 0; r < extent; ++r) {
      for (size_t v = 0; v < known_.size(); ++v) {
        if (section_[v] == static_cast<int32_t>(2 * l + 1)) known_[v] = 0;
      }
      counter_ = r;
      if (is_csr) {
        slot_ = inputs_.null_items ? static_cast<uint32_t>(start + r)
                                   : inputs_.items[csr][static_cast<size_t>(start + r)];
      }
      acc = acc + to_float(value(loop.sums[s].term));
    }
    return bits(acc);
  }

  const ir::Program& p_;
  const Inputs& inputs_;
  std::vector<int32_t> section_;
  std::vector<uint32_t> values_;
  std::vector<char> known_;
  int64_t row_, counter_ = 0;
  uint32_t slot_ = 0;
};

}  // namespace

std::vector<std::vector<uint32_t>> reference(const ir::Program& program, int64_t n,
                                             const Inputs& inputs) {
  std::vector<std::vector<uint32_t>> outputs(program.outputs.size());
  for (int64_t i = 0; i < n; ++i) {
    Row row(program, inputs, i);
    for (size_t o = 0; o < outputs.size(); ++o) {
      for (const ir::Value v : program.outputs[o].values) outputs[o].push_back(row.value(v));
    }
  }
  return outputs;
}

}  // namespace conformance
