// Internal: the derivative rule of each instruction, shared by adjoints and tangents.
#pragma once

#include "novaphy/nova/trace.h"
#include "novaphy/program/ir.h"

namespace nova::detail {

// Calls f(value, position) for each operand that gets a gradient of the result; positions 0, 1, 2
// are a, b, c. Integers, comparisons, SIGN, FLOOR and DETACH pass no gradient.
template <class F>
void for_each_differentiable(const ir::Instr& in, const F& f) {
  using ir::Op;
  switch (in.op) {
    case Op::ADD:
    case Op::SUB:
    case Op::MUL:
    case Op::DIV:
    case Op::MIN:
    case Op::MAX:
    case Op::PARTIAL:
      f(in.a, 0);
      f(in.b, 1);
      break;
    case Op::NEG:
    case Op::ABS:
    case Op::SQRT:
      f(in.a, 0);
      break;
    case Op::FMA:
      f(in.a, 0);
      f(in.b, 1);
      f(in.c, 2);
      break;
    case Op::SELECT_F:
      f(in.b, 1);
      f(in.c, 2);
      break;
    default:
      break;
  }
}

// The derivative rules. The partial derivative with respect to one operand is a factor, so one rule
// serves both directions. The rule maps a gradient of the result to the operand, or a tangent of
// the operand to the result.
class DerivativeRules {
 public:
  using Value = ir::Value;

  explicit DerivativeRules(Trace& trace) : trace_(trace) {}

  Value add(Value a, Value b) { return trace_.emit({ir::Op::ADD, a, b}); }
  Value choose(Value c, Value a, Value b) { return trace_.emit({ir::Op::SELECT_F, c, a, b}); }
  Value zero() { return trace_.constant(0.0f); }

  // Returns x times the derivative of instruction v of `p` with respect to the operand at
  // `position`. `at` returns the trace's copy of a value of p. With `zero_safe_products`, 0 times
  // infinity or NaN is 0. The caller handles SELECT_F, whose derivative depends on the chosen side.
  template <class At>
  Value apply(const ir::Program& p, Value v, int position, Value x, const At& at,
              bool zero_safe_products = false) {
    using ir::Op;
    const ir::Instr& in = p.instrs[v];
    const auto times = [&](Value partial) {
      const Value product = mul(x, partial);
      return zero_safe_products ? zero_safe(x, product) : product;
    };
    switch (in.op) {
      case Op::SUB:
        return position == 0 ? x : neg(x);
      case Op::MUL:
        return times(at(position == 0 ? in.b : in.a));
      case Op::DIV: {
        Value by_first = quotient(x, at(in.b));
        if (p.instrs[in.b].op != Op::CONST_F) by_first = zero_safe(x, by_first);
        return position == 0 ? by_first : zero_safe(x, neg(mul(by_first, at(v))));
      }
      case Op::NEG:
        return neg(x);
      case Op::ABS:
        return choose(trace_.emit({Op::LT, at(in.a), zero()}), neg(x), x);
      case Op::MIN:
      case Op::MAX: {
        const Value first = in.op == Op::MIN ? trace_.emit({Op::LT, at(in.a), at(in.b)})
                                             : trace_.emit({Op::LT, at(in.b), at(in.a)});
        return position == 0 ? choose(first, x, zero()) : choose(first, zero(), x);
      }
      case Op::SQRT: {
        const Value half = mul(x, trace_.constant(0.5f));
        return choose(trace_.emit({Op::LT, zero(), at(in.a)}), quotient(half, at(v)), zero());
      }
      case Op::FMA:
        return position == 2 ? x : times(at(position == 0 ? in.b : in.a));
      case Op::PARTIAL:
        return position == 0 ? x : zero_safe(x, mul(x, at(in.c)));
      default:  // ADD
        return x;
    }
  }

 private:
  Value mul(Value a, Value b) { return trace_.emit({ir::Op::MUL, a, b}); }
  Value neg(Value a) { return trace_.emit({ir::Op::NEG, a}); }
  // Divides a by b. If b is a square root, as in normalizing a vector, the result is a product with
  // the reciprocal, so that components and their gradients share one division. The reciprocal of a
  // root is never infinite or denormal.
  Value quotient(Value a, Value b) {
    if (trace_.program().instrs[b].op != ir::Op::SQRT) return trace_.emit({ir::Op::DIV, a, b});
    return mul(a, trace_.emit({ir::Op::DIV, trace_.constant(1.0f), b}));
  }
  // Returns `value`, or exactly 0 if x is 0, so that 0 * inf and 0 / 0 give 0.
  Value zero_safe(Value x, Value value) {
    return choose(trace_.emit({ir::Op::EQ, x, zero()}), zero(), value);
  }

  Trace& trace_;
};

}  // namespace nova::detail
