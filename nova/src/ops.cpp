#include "novaphy/nova/ops.h"

#include <cmath>

#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/registry.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"

namespace nova {

using detail::check_f32;
using novaphy::require;

namespace {

void check_devices(const char* call, const Tensor& a, const Tensor& b) {
  require(a.device() == b.device(), ErrorKind::Value, call, ": a is on ", a.device().str(),
          ", b on ", b.device().str());
}

// Launches a kernel on two operands that are broadcast to one shape.
Tensor launch_pair(const Kernel& kernel, const Tensor& a, const Tensor& b,
                   std::span<const Param> params = {}) {
  const char* call = kernel.name().c_str();
  check_f32(a, {call, "a"});
  check_f32(b, {call, "b"});
  check_devices(call, a, b);
  const Shape shape = broadcast_shape(call, a.shape(), b.shape());
  const Tensor out(shape, DType::F32, a.device());
  const Operand in[] = {broadcast_to(a, shape).flat_operand(),
                        broadcast_to(b, shape).flat_operand()};
  const Operand to = out.flat_operand();
  kernel.launch(out.size(), in, to, {.params = params});
  return out;
}

template <class F>
Kernel pair_kernel(const char* name, F f) {
  return make_kernel(
      name, {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
      {{"out", 1}}, [f](TraceContext& c) { return std::vector<Real>{f(c, c.f32(0), c.f32(1))}; });
}

template <class F>
Kernel unary_kernel(const char* name, F f) {
  return with_one_gradient_set(
      make_kernel(name, {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [f](TraceContext& c) { return std::vector<Real>{f(c, c.f32(0))}; }));
}
Tensor unary(const Kernel& kernel, const Tensor& x, std::span<const Param> params = {}) {
  check_f32(x, {kernel.name().c_str(), "x"});
  const Tensor out(x.shape(), DType::F32, x.device());
  const Operand in = x.flat_operand(), to = out.flat_operand();
  kernel.launch(x.size(), in, to, {.params = params});
  return out;
}

// Kernels are shared by threads. A function-local static makes each one once.
#define NOVA_BINARY_OP(function, expression)                                                 \
  const Kernel& function##_kernel() {                                                        \
    static const Kernel kernel = with_one_gradient_set(pair_kernel(                          \
        #function, [](TraceContext&, const Real& x, const Real& y) { return expression; })); \
    return kernel;                                                                           \
  }
#define NOVA_UNARY_OP(function, expression)                                               \
  const Kernel& function##_kernel() {                                                     \
    static const Kernel kernel =                                                          \
        unary_kernel(#function, [](TraceContext&, const Real& v) { return expression; }); \
    return kernel;                                                                        \
  }
// Defines an operation with a parameter s.
#define NOVA_SCALAR_OP(function, name, expression)                                       \
  const Kernel& function##_kernel() {                                                    \
    static const Kernel kernel = unary_kernel(name, [](TraceContext& c, const Real& v) { \
      const Real s = c.param(0);                                                         \
      return expression;                                                                 \
    });                                                                                  \
    return kernel;                                                                       \
  }

NOVA_BINARY_OP(add, x + y)
NOVA_BINARY_OP(sub, x - y)
NOVA_BINARY_OP(mul, x* y)
NOVA_BINARY_OP(div, x / y)
NOVA_BINARY_OP(minimum, min(x, y))
NOVA_BINARY_OP(maximum, max(x, y))
NOVA_BINARY_OP(pow, pow(x, y))
NOVA_SCALAR_OP(add_scalar, "add_scalar", v + s)
NOVA_SCALAR_OP(mul_scalar, "mul_scalar", v* s)
NOVA_SCALAR_OP(div_scalar, "div_scalar", v / s)
NOVA_SCALAR_OP(scalar_sub, "scalar_sub", s - v)
NOVA_SCALAR_OP(scalar_div, "scalar_div", s / v)
NOVA_UNARY_OP(abs, abs(v))
NOVA_UNARY_OP(sqrt, sqrt(v))
NOVA_UNARY_OP(exp, exp(v))
NOVA_UNARY_OP(log, log(v))
NOVA_UNARY_OP(sin, sin(v))
NOVA_UNARY_OP(cos, cos(v))
NOVA_UNARY_OP(tanh, tanh(v))
NOVA_UNARY_OP(acos, acos(v))
NOVA_BINARY_OP(atan2, atan2(x, y))

// The possible relations of two numbers, as bits of a launch parameter. The result is 1 for the
// relations whose bits are set.
enum Holds : int32_t { kLess = 1, kEqual = 2, kGreater = 4, kUnordered = 8 };
int32_t holds(Comparison what) {
  constexpr int32_t kHolds[] = {
      kLess, kLess | kEqual, kEqual, kLess | kGreater | kUnordered, kGreater | kEqual, kGreater};
  return kHolds[static_cast<size_t>(what)];
}
Real compared(TraceContext& c, const Real& a, const Real& b) {
  const Int wanted = c.param_i32(0);
  const Int found =
      select(a < b, Int(kLess),
             select(a == b, Int(kEqual), select(b < a, Int(kGreater), Int(kUnordered))));
  return select((wanted & found) != Int(0), Real(1.0f), Real(0.0f));
}
const Kernel& compare_kernel() {
  static const Kernel kernel = pair_kernel(
      "compare", [](TraceContext& c, const Real& a, const Real& b) { return compared(c, a, b); });
  return kernel;
}

// Parameter 0 masks the bits of the condition that count. A float is 0 if all bits except the sign
// are 0, so one kernel serves conditions of both types.
const Kernel& where_kernel() {
  static const Kernel kernel =
      with_one_gradient_set(make_kernel("where",
                                        {{"condition", DType::I32, 1, Access::Direct},
                                         {"a", DType::F32, 1, Access::Direct},
                                         {"b", DType::F32, 1, Access::Direct}},
                                        {{"out", 1}}, [](TraceContext& c) {
                                          const Bool holds = (c.i32(0) & c.param_i32(0)) != Int(0);
                                          return std::vector{select(holds, c.f32(1), c.f32(2))};
                                        }));
  return kernel;
}

Tensor with_parameter(const Kernel& kernel, const Tensor& x, float value) {
  const Param params[] = {value};
  return unary(kernel, x, params);
}

}  // namespace

#define NOVA_DEFINE_BINARY(function)                  \
  Tensor function(const Tensor& a, const Tensor& b) { \
    return launch_pair(function##_kernel(), a, b);    \
  }
#define NOVA_DEFINE_UNARY(function) \
  Tensor function(const Tensor& x) { return unary(function##_kernel(), x); }
#define NOVA_BINARY_OPS(X) X(add) X(sub) X(mul) X(div) X(minimum) X(maximum) X(pow) X(atan2)
#define NOVA_UNARY_OPS(X) X(abs) X(sqrt) X(exp) X(log) X(sin) X(cos) X(tanh) X(acos)
#define NOVA_SCALAR_OPS(X) X(add_scalar) X(mul_scalar) X(div_scalar) X(scalar_sub) X(scalar_div)

NOVA_BINARY_OPS(NOVA_DEFINE_BINARY)
NOVA_UNARY_OPS(NOVA_DEFINE_UNARY)
Tensor add(const Tensor& x, float b) { return with_parameter(add_scalar_kernel(), x, b); }
// x + (-b) has the same bits as x - b, and -0 - x the same bits as -x.
Tensor sub(const Tensor& x, float b) { return with_parameter(add_scalar_kernel(), x, -b); }
Tensor neg(const Tensor& x) { return with_parameter(scalar_sub_kernel(), x, -0.0f); }
Tensor mul(const Tensor& x, float b) { return with_parameter(mul_scalar_kernel(), x, b); }
Tensor div(const Tensor& x, float b) { return with_parameter(div_scalar_kernel(), x, b); }
Tensor sub(float a, const Tensor& x) { return with_parameter(scalar_sub_kernel(), x, a); }
Tensor div(float a, const Tensor& x) { return with_parameter(scalar_div_kernel(), x, a); }
Tensor pow(float a, const Tensor& x) { return pow(Tensor::full({1}, a, x.device()), x); }
Tensor pow(const Tensor& x, float b) {
  return b == 2.0f ? mul(x, x) : pow(x, Tensor::full({1}, b, x.device()));
}

void detail::add_op_kernels(EngineKernels& list) {
  const auto add_one = [&](const Kernel& k) { list.push_back({k, k.gradients()}); };
#define NOVA_LIST(function) add_one(function##_kernel());
  NOVA_BINARY_OPS(NOVA_LIST)
  NOVA_UNARY_OPS(NOVA_LIST)
  NOVA_SCALAR_OPS(NOVA_LIST)
  add_one(detail::clamp_kernel());
  add_one(where_kernel());
  list.push_back({compare_kernel(), {}});
}

const Kernel& detail::clamp_kernel() {
  static const Kernel kernel = unary_kernel("clamp", [](TraceContext& c, const Real& v) {
    const Real lo = c.param(0), hi = c.param(1);
    return select(v < lo, lo, select(v > hi, hi, v));
  });
  return kernel;
}
void detail::check_limits(const char* call, float lower, float upper) {
  require(lower <= upper, ErrorKind::Value, call, ": expected lower <= upper, got ", lower, " and ",
          upper);
}
Tensor clamp(const Tensor& x, float lower, float upper) {
  detail::check_limits("clamp", lower, upper);
  const Param params[] = {lower, upper};
  return unary(detail::clamp_kernel(), x, params);
}

Tensor compare(Comparison what, const Tensor& a, const Tensor& b) {
  const NoGrad no_grad;
  const Param params[] = {holds(what)};
  return launch_pair(compare_kernel(), a, b, params);
}
Tensor compare(Comparison what, const Tensor& a, float b) {
  check_f32(a, {"compare", "a"});
  return compare(what, a, Tensor::full({1}, b, a.device()));
}

Tensor where(const Tensor& condition, const Tensor& a, const Tensor& b) {
  require(condition.defined() && condition.dtype() != DType::U8, ErrorKind::Type,
          "where, condition: expected int32 or float32, got ",
          condition.defined() ? dtype_name(condition.dtype()) : "an undefined tensor");
  check_f32(a, {"where", "a"});
  check_f32(b, {"where", "b"});
  check_devices("where", a, b);
  const Shape shape =
      broadcast_shape("where", condition.shape(), broadcast_shape("where", a.shape(), b.shape()));
  const Tensor out(shape, DType::F32, a.device());
  const Tensor words(condition.range(), condition.shape(), DType::F32);
  Operand in[] = {broadcast_to(words, shape).flat_operand(), broadcast_to(a, shape).flat_operand(),
                  broadcast_to(b, shape).flat_operand()};
  in[0].type = ir::Type::I32;
  const Operand to = out.flat_operand();
  const Param params[] = {condition.dtype() == DType::F32 ? INT32_MAX : int32_t{-1}};
  where_kernel().launch(out.size(), in, to, {.params = params});
  return out;
}

}  // namespace nova
