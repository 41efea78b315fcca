#include "novaphy/nova/trace.h"

#include <bit>
#include <cmath>
#include <cstring>

#include "novaphy/core/error.h"

namespace nova {
namespace {

thread_local Trace* current_trace = nullptr;

bool is_const(const ir::Instr& in) {
  return in.op == ir::Op::CONST_F || in.op == ir::Op::CONST_I || in.op == ir::Op::CONST_B;
}
float f32(int32_t bits) { return std::bit_cast<float>(bits); }
bool is_f32_const(const ir::Instr& in, uint32_t bits) {
  return in.op == ir::Op::CONST_F && static_cast<uint32_t>(in.a) == bits;
}
constexpr uint32_t kOne = 0x3F800000u, kPlusZero = 0u, kMinusZero = 0x80000000u;

int32_t float_to_int(float x) {
  if (x != x) return 0;
  if (x >= 2147483648.0f) return INT32_MAX;
  if (x <= -2147483648.0f) return INT32_MIN;
  return static_cast<int32_t>(x);
}
int32_t wrap(uint32_t x) { return static_cast<int32_t>(x); }

// Evaluates an instruction on constants with the same result as the backends. f32 values are given
// as bits.
int32_t evaluate(ir::Op op, int32_t a, int32_t b, int32_t c) {
  namespace m = novaphy::math;
  const float x = f32(a), y = f32(b);
  auto bits = [](float v) { return std::bit_cast<int32_t>(v); };
  const auto ua = static_cast<uint32_t>(a), ub = static_cast<uint32_t>(b);
  const int shift = static_cast<int>(ub & 31u);
  switch (op) {
    case ir::Op::ADD:
      return bits(x + y);
    case ir::Op::SUB:
      return bits(x - y);
    case ir::Op::MUL:
      return bits(x * y);
    case ir::Op::DIV:
      return bits(x / y);
    case ir::Op::NEG:
      return wrap(ua ^ kMinusZero);
    case ir::Op::ABS:
      return wrap(ua & ~kMinusZero);
    case ir::Op::SIGN:
      return bits(m::sign(x));
    case ir::Op::MIN:
      return bits(m::min(x, y));
    case ir::Op::MAX:
      return bits(m::max(x, y));
    case ir::Op::SQRT:
      return bits(m::sqrt(x));
    case ir::Op::FMA:
      return bits(std::fma(x, y, f32(c)));
    case ir::Op::FLOOR:
      return bits(m::floor(x));
    case ir::Op::IADD:
      return wrap(ua + ub);
    case ir::Op::ISUB:
      return wrap(ua - ub);
    case ir::Op::IMUL:
      return wrap(ua * ub);
    case ir::Op::IDIV:
      return b == 0 ? 0 : b == -1 ? wrap(0u - ua) : a / b;
    case ir::Op::IMOD:
      return b == 0 || b == -1 ? 0 : a % b;
    case ir::Op::IMIN:
      return a <= b ? a : b;
    case ir::Op::IMAX:
      return a >= b ? a : b;
    case ir::Op::IAND:
      return a & b;
    case ir::Op::IOR:
      return a | b;
    case ir::Op::IXOR:
      return a ^ b;
    case ir::Op::ISHL:
      return wrap(ua << shift);
    case ir::Op::ISHR:
      return a >> shift;
    case ir::Op::IUSHR:
      return wrap(ua >> shift);
    case ir::Op::LT:
      return x < y;
    case ir::Op::LE:
      return x <= y;
    case ir::Op::EQ:
      return x == y;
    case ir::Op::NE:
      return x != y;
    case ir::Op::ILT:
      return a < b;
    case ir::Op::ILE:
      return a <= b;
    case ir::Op::IEQ:
      return a == b;
    case ir::Op::INE:
      return a != b;
    case ir::Op::AND:
      return a && b;
    case ir::Op::OR:
      return a || b;
    case ir::Op::NOT:
      return !a;
    case ir::Op::F_TO_I:
      return float_to_int(x);
    case ir::Op::I_TO_F:
      return bits(static_cast<float>(a));
    case ir::Op::F_BITS:
    case ir::Op::BITS_F:
      return a;
    case ir::Op::SELECT_F:
    case ir::Op::SELECT_I:
    case ir::Op::SELECT_B:
      return a ? b : c;
    default:
      novaphy::fail(novaphy::ErrorKind::Runtime, "nova: op cannot be folded");
  }
}

bool foldable(ir::Op op) {
  switch (op) {
    case ir::Op::PARTIAL:
    case ir::Op::DETACH:
    case ir::Op::LOAD_F:
    case ir::Op::LOAD_I:
    case ir::Op::INDEX:
    case ir::Op::REDUCE_INDEX:
    case ir::Op::SLOT:
    case ir::Op::SUM:
    case ir::Op::PARAM_F:
    case ir::Op::PARAM_I:
    case ir::Op::CONST_F:
    case ir::Op::CONST_I:
    case ir::Op::CONST_B:
      return false;
    default:
      return true;
  }
}

}  // namespace

Trace::Trace(std::string name) : previous_(current_trace) {
  program_.name = std::move(name);
  current_trace = this;
}
Trace::~Trace() { current_trace = previous_; }

Trace& Trace::current() {
  novaphy::require(current_trace != nullptr, novaphy::ErrorKind::Runtime,
                   "nova: a traced value was used outside of the function that makes a kernel");
  return *current_trace;
}

ir::Value Trace::constant(float value) {
  return emit({ir::Op::CONST_F, std::bit_cast<int32_t>(value)});
}
ir::Value Trace::constant(int32_t value) { return emit({ir::Op::CONST_I, value}); }
ir::Value Trace::constant(bool value) { return emit({ir::Op::CONST_B, value ? 1 : 0}); }

// Returns a value that equals the instruction in all bits, or kNone. Identities that change a
// signed zero (x + 0, x * 0) are not used.
ir::Value Trace::fold(const ir::Instr& in) {
  if (!foldable(in.op)) return ir::kNone;
  bool all_const = true;
  ir::for_each_operand(in,
                       [&](ir::Value v) { all_const = all_const && is_const(program_.instrs[v]); });
  auto operand = [&](ir::Value v) -> const ir::Instr& { return program_.instrs[v]; };
  if (all_const) {
    auto value = [&](ir::Value v) { return v == ir::kNone ? 0 : operand(v).a; };
    const int32_t bits = evaluate(in.op, value(in.a), value(in.b), value(in.c));
    switch (ir::result_type(in.op)) {
      case ir::Type::F32:
        return emit({ir::Op::CONST_F, bits});
      case ir::Type::I32:
        return emit({ir::Op::CONST_I, bits});
      case ir::Type::Bool:
        return emit({ir::Op::CONST_B, bits});
    }
  }
  switch (in.op) {
    case ir::Op::ADD:
      if (is_f32_const(operand(in.b), kMinusZero)) return in.a;
      if (is_f32_const(operand(in.a), kMinusZero)) return in.b;
      break;
    case ir::Op::SUB:
      if (is_f32_const(operand(in.b), kPlusZero)) return in.a;
      break;
    case ir::Op::MUL:
      if (is_f32_const(operand(in.b), kOne)) return in.a;
      if (is_f32_const(operand(in.a), kOne)) return in.b;
      break;
    case ir::Op::DIV:
      if (is_f32_const(operand(in.b), kOne)) return in.a;
      break;
    case ir::Op::NEG:
      if (operand(in.a).op == ir::Op::NEG) return operand(in.a).a;
      break;
    case ir::Op::NOT:
      if (operand(in.a).op == ir::Op::NOT) return operand(in.a).a;
      break;
    case ir::Op::SELECT_F:
    case ir::Op::SELECT_I:
    case ir::Op::SELECT_B:
      if (in.b == in.c) return in.b;
      if (operand(in.a).op == ir::Op::CONST_B) return operand(in.a).a ? in.b : in.c;
      break;
    default:
      break;
  }
  return ir::kNone;
}

ir::Value Trace::emit(ir::Instr in) {
  ir::for_each_operand(in, [&](ir::Value v) {
    novaphy::require(v >= 0 && v < static_cast<ir::Value>(program_.instrs.size()),
                     novaphy::ErrorKind::Runtime, "nova: ", ir::kOpNames[static_cast<int>(in.op)],
                     " got an operand without a value, or one of another kernel's trace");
  });
  if (const ir::Value known = fold(in); known != ir::kNone) return known;
  const Key key{
      (static_cast<uint64_t>(in.op) << 32) | static_cast<uint32_t>(in.a),
      (static_cast<uint64_t>(static_cast<uint32_t>(in.b)) << 32) | static_cast<uint32_t>(in.c)};
  const auto [entry, fresh] =
      numbering_.try_emplace(key, static_cast<ir::Value>(program_.instrs.size()));
  if (fresh) program_.instrs.push_back(in);
  return entry->second;
}

}  // namespace nova
