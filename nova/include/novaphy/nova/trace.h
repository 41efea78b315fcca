// Tracing. Real, Int and Bool are handles of values in the Program that is being built. An
// arithmetic operation appends an instruction, unless the result is a constant or already exists.
// Constant folding is exact to the bit. A formula template runs with float in the forward engine,
// and builds a Program with Real.
//
// Bool does not convert to bool, so a data-dependent `if` fails to compile. Write select(c, a, b)
// instead.
#pragma once

#include <cstdint>
#include <unordered_map>

#include "novaphy/math/scalar.h"
#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

// Builds one Program. A Trace is the current trace of its thread as long as it exists.
class NOVAPHY_NOVA_API Trace {
 public:
  explicit Trace(std::string name);
  ~Trace();
  Trace(const Trace&) = delete;
  Trace& operator=(const Trace&) = delete;
  static Trace& current();  // throws if this thread builds no trace

  // Appends an instruction, or returns an existing value that is equal.
  ir::Value emit(ir::Instr instr);
  ir::Value constant(float value);
  ir::Value constant(int32_t value);
  ir::Value constant(bool value);

  ir::Program& program() { return program_; }

 private:
  struct Key {
    uint64_t low, high;
    bool operator==(const Key&) const = default;
  };
  struct KeyHash {
    size_t operator()(const Key& k) const {
      return k.low * 0x9E3779B97F4A7C15u ^ (k.high + (k.high >> 29));
    }
  };
  ir::Value fold(const ir::Instr& instr);

  ir::Program program_;
  std::unordered_map<Key, ir::Value, KeyHash> numbering_;
  Trace* previous_;
};

class Bool;
class Int;

// A traced float.
class NOVAPHY_NOVA_API Real {
 public:
  Real() = default;  // has no value yet
  Real(float constant) : value_(Trace::current().constant(constant)) {}
  static Real of(ir::Value value) {
    Real r;
    r.value_ = value;
    return r;
  }
  ir::Value value() const { return value_; }

 private:
  ir::Value value_ = ir::kNone;
};

// A traced 32-bit integer. Arithmetic wraps.
class NOVAPHY_NOVA_API Int {
 public:
  Int() = default;
  Int(int32_t constant) : value_(Trace::current().constant(constant)) {}
  static Int of(ir::Value value) {
    Int i;
    i.value_ = value;
    return i;
  }
  ir::Value value() const { return value_; }

 private:
  ir::Value value_ = ir::kNone;
};

// A traced truth value.
class NOVAPHY_NOVA_API Bool {
 public:
  Bool() = default;
  explicit Bool(bool constant) : value_(Trace::current().constant(constant)) {}
  static Bool of(ir::Value value) {
    Bool b;
    b.value_ = value;
    return b;
  }
  ir::Value value() const { return value_; }

 private:
  ir::Value value_ = ir::kNone;
};

namespace detail {
inline ir::Value emit(ir::Op op, ir::Value a, ir::Value b = ir::kNone, ir::Value c = ir::kNone) {
  return Trace::current().emit({op, a, b, c});
}
}  // namespace detail

#define NOVA_BINARY(name, op, Operand, Result)                         \
  inline Result name(const Operand& a, const Operand& b) {             \
    return Result::of(detail::emit(ir::Op::op, a.value(), b.value())); \
  }
#define NOVA_SWAPPED(name, op, Operand, Result)                        \
  inline Result name(const Operand& a, const Operand& b) {             \
    return Result::of(detail::emit(ir::Op::op, b.value(), a.value())); \
  }
#define NOVA_UNARY(name, op, Operand, Result) \
  inline Result name(const Operand& a) { return Result::of(detail::emit(ir::Op::op, a.value())); }

NOVA_BINARY(operator+, ADD, Real, Real)
NOVA_BINARY(operator-, SUB, Real, Real)
NOVA_BINARY(operator*, MUL, Real, Real)
NOVA_BINARY(operator/, DIV, Real, Real)
NOVA_UNARY(operator-, NEG, Real, Real)
NOVA_BINARY(min, MIN, Real, Real)  // a <= b ? a : b; the gradient goes to a if a < b, else to b
NOVA_BINARY(max, MAX, Real, Real)  // a >= b ? a : b; the gradient goes to a if a > b, else to b
NOVA_UNARY(abs, ABS, Real, Real)   // derivative -1 for x < 0, else +1
NOVA_UNARY(sign, SIGN, Real, Real)
NOVA_UNARY(sqrt, SQRT, Real, Real)  // the gradient at 0 is 0
NOVA_UNARY(floor, FLOOR, Real, Real)
NOVA_BINARY(operator<, LT, Real, Bool)
NOVA_BINARY(operator<=, LE, Real, Bool)
NOVA_SWAPPED(operator>, LT, Real, Bool)
NOVA_SWAPPED(operator>=, LE, Real, Bool)
NOVA_BINARY(operator==, EQ, Real, Bool)
NOVA_BINARY(operator!=, NE, Real, Bool)

NOVA_BINARY(operator+, IADD, Int, Int)
NOVA_BINARY(operator-, ISUB, Int, Int)
NOVA_BINARY(operator*, IMUL, Int, Int)
NOVA_BINARY(operator/, IDIV, Int, Int)  // truncates; 0 for a zero divisor
NOVA_BINARY(operator%, IMOD, Int, Int)
NOVA_BINARY(min, IMIN, Int, Int)
NOVA_BINARY(max, IMAX, Int, Int)
NOVA_BINARY(operator&, IAND, Int, Int)
NOVA_BINARY(operator|, IOR, Int, Int)
NOVA_BINARY(operator^, IXOR, Int, Int)
NOVA_BINARY(operator<<, ISHL, Int, Int)
NOVA_BINARY(operator>>, ISHR, Int, Int)
NOVA_BINARY(shift_right_unsigned, IUSHR, Int, Int)
NOVA_BINARY(operator<, ILT, Int, Bool)
NOVA_BINARY(operator<=, ILE, Int, Bool)
NOVA_SWAPPED(operator>, ILT, Int, Bool)
NOVA_SWAPPED(operator>=, ILE, Int, Bool)
NOVA_BINARY(operator==, IEQ, Int, Bool)
NOVA_BINARY(operator!=, INE, Int, Bool)

NOVA_BINARY(both, AND, Bool, Bool)
NOVA_BINARY(either, OR, Bool, Bool)
NOVA_UNARY(negate, NOT, Bool, Bool)
NOVA_UNARY(to_int, F_TO_I, Real, Int)  // truncates, saturates, NaN gives 0
NOVA_UNARY(to_real, I_TO_F, Int, Real)
NOVA_UNARY(float_bits, F_BITS, Real, Int)
NOVA_UNARY(bits_float, BITS_F, Int, Real)
NOVA_UNARY(detach, DETACH, Real, Real)  // the value without its derivative
#undef NOVA_BINARY
#undef NOVA_SWAPPED
#undef NOVA_UNARY

inline Real fma(const Real& a, const Real& b, const Real& c) {
  return Real::of(detail::emit(ir::Op::FMA, a.value(), b.value(), c.value()));
}
// Returns c ? a : b. Only the chosen side gets the gradient; NaN on the other side has no effect.
inline Real select(const Bool& c, const Real& a, const Real& b) {
  return Real::of(detail::emit(ir::Op::SELECT_F, c.value(), a.value(), b.value()));
}
inline Int select(const Bool& c, const Int& a, const Int& b) {
  return Int::of(detail::emit(ir::Op::SELECT_I, c.value(), a.value(), b.value()));
}
inline Bool select(const Bool& c, const Bool& a, const Bool& b) {
  return Bool::of(detail::emit(ir::Op::SELECT_B, c.value(), a.value(), b.value()));
}
// Returns y with the declared derivative dy_dx with respect to x. The derivative of y itself is
// added. Pass detach(y) if dy_dx is the whole derivative.
inline Real with_derivative(const Real& y, const Real& x, const Real& dy_dx) {
  return Real::of(detail::emit(ir::Op::PARTIAL, y.value(), x.value(), dy_dx.value()));
}

}  // namespace nova
