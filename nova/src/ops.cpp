#include "novaphy/nova/ops.h"

#include <cmath>

#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"

namespace nova {

using detail::check_f32;
using novaphy::require;

namespace {

// One kernel per function and way of broadcasting, made at first use and kept.
template <class F>
struct Binary {
  const char* name;
  F f;
  Kernel kernels[3] = {};
  const Kernel& kernel(Access a, Access b) {
    Kernel& k = kernels[a == Access::Uniform ? 1 : b == Access::Uniform ? 2 : 0];
    if (!k.impl())
      k = make_kernel(name, {{"a", DType::F32, 1, a}, {"b", DType::F32, 1, b}}, {{"out", 1}},
                      [this](TraceContext& c) { return std::vector<Real>{f(c.f32(0), c.f32(1))}; });
    return k;
  }
};

void check_devices(const char* call, const Tensor& a, const Tensor& b) {
  require(a.device() == b.device(), ErrorKind::Value, call, ": a is on ", a.device().str(),
          ", b on ", b.device().str());
}

template <class F>
Tensor binary(Binary<F>& op, const Tensor& a, const Tensor& b) {
  check_f32(a, {op.name, "a"});
  check_f32(b, {op.name, "b"});
  check_devices(op.name, a, b);
  const Shape shape = broadcast_shape(op.name, a.shape(), b.shape());
  const bool one_a = a.size() == 1, one_b = b.size() == 1;
  if (!(one_a || a.shape() == shape) || !(one_b || b.shape() == shape))
    return binary(op, broadcast_to(a, shape), broadcast_to(b, shape));
  const Tensor out(shape, DType::F32, a.device());
  const Operand in[] = {a.flat_operand(), b.flat_operand()};
  const Operand to = out.flat_operand();
  const bool one = out.size() == 1;
  op.kernel(one_a && !one ? Access::Uniform : Access::Direct,
            one_b && !one ? Access::Uniform : Access::Direct)
      .launch(out.size(), in, {&to, 1});
  return out;
}

template <class F>
Kernel unary_kernel(const char* name, F f) {
  return make_kernel(name, {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                     [f](TraceContext& c) { return std::vector<Real>{f(c, c.f32(0))}; });
}
Tensor unary(const Kernel& kernel, const Tensor& x, std::span<const Param> params = {}) {
  check_f32(x, {kernel.name().c_str(), "x"});
  const Tensor out(x.shape(), DType::F32, x.device());
  const Operand in = x.flat_operand(), to = out.flat_operand();
  kernel.launch(x.size(), {&in, 1}, {&to, 1}, {.params = params});
  return out;
}

// Kernels are shared by threads; making one is rare, so a function-local static guards it.
#define NOVA_BINARY_OP(function, expression)                                                    \
  auto& function##_op() {                                                                       \
    static auto f = [](const Real& x, const Real& y) { return expression; };                    \
    static Binary<decltype(f)> op = [] {                                                        \
      Binary<decltype(f)> made{#function, f};                                                   \
      return made;                                                                              \
    }();                                                                                        \
    static const bool ready =                                                                   \
        (op.kernel(Access::Direct, Access::Direct), op.kernel(Access::Uniform, Access::Direct), \
         op.kernel(Access::Direct, Access::Uniform), true);                                     \
    (void)ready;                                                                                \
    return op;                                                                                  \
  }
#define NOVA_UNARY_OP(function, expression)                                               \
  const Kernel& function##_kernel() {                                                     \
    static const Kernel kernel =                                                          \
        unary_kernel(#function, [](TraceContext&, const Real& v) { return expression; }); \
    return kernel;                                                                        \
  }
// With a parameter s.
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
NOVA_SCALAR_OP(add_scalar, "add_scalar", v + s)
NOVA_SCALAR_OP(sub_scalar, "sub_scalar", v - s)
NOVA_SCALAR_OP(mul_scalar, "mul_scalar", v* s)
NOVA_SCALAR_OP(div_scalar, "div_scalar", v / s)
NOVA_SCALAR_OP(scalar_sub, "scalar_sub", s - v)
NOVA_SCALAR_OP(scalar_div, "scalar_div", s / v)
NOVA_SCALAR_OP(pow_scalar, "pow_scalar", pow(v, s))
NOVA_SCALAR_OP(scalar_pow, "scalar_pow", pow(s, v))
NOVA_UNARY_OP(neg, -v)
NOVA_UNARY_OP(abs, abs(v))
NOVA_UNARY_OP(sqrt, sqrt(v))
NOVA_UNARY_OP(exp, exp(v))
NOVA_UNARY_OP(log, log(v))
NOVA_UNARY_OP(sin, sin(v))
NOVA_UNARY_OP(cos, cos(v))
NOVA_UNARY_OP(tanh, tanh(v))

const Kernel& pow_kernel() {
  static const Kernel kernel = make_kernel(
      "pow", {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{pow(c.f32(0), c.f32(1))}; });
  return kernel;
}

// Which of the four ways in which two numbers can compare make a 1: bits of a launch parameter.
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
  static const Kernel kernel = make_kernel(
      "compare", {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
      {{"out", 1}}, [](TraceContext& c) { return std::vector{compared(c, c.f32(0), c.f32(1))}; });
  return kernel;
}
const Kernel& compare_scalar_kernel() {
  static const Kernel kernel = unary_kernel(
      "compare_scalar", [](TraceContext& c, const Real& v) { return compared(c, v, c.param(1)); });
  return kernel;
}

// A float is 0 when all bits but the sign are, so parameter 0, the bits that count, serves
// conditions of both types.
const Kernel& where_kernel() {
  static const Kernel kernel = make_kernel("where",
                                           {{"condition", DType::I32, 1, Access::Direct},
                                            {"a", DType::F32, 1, Access::Direct},
                                            {"b", DType::F32, 1, Access::Direct}},
                                           {{"out", 1}}, [](TraceContext& c) {
                                             const Bool holds =
                                                 (c.i32(0) & c.param_i32(0)) != Int(0);
                                             return std::vector{select(holds, c.f32(1), c.f32(2))};
                                           });
  return kernel;
}

Tensor with_parameter(const Kernel& kernel, const Tensor& x, float value) {
  const Param params[] = {value};
  return unary(kernel, x, params);
}

}  // namespace

#define NOVA_DEFINE_BINARY(function) \
  Tensor function(const Tensor& a, const Tensor& b) { return binary(function##_op(), a, b); }
#define NOVA_DEFINE_UNARY(function) \
  Tensor function(const Tensor& x) { return unary(function##_kernel(), x); }
#define NOVA_BINARY_OPS(X) X(add) X(sub) X(mul) X(div) X(minimum) X(maximum)
#define NOVA_UNARY_OPS(X) X(neg) X(abs) X(sqrt) X(exp) X(log) X(sin) X(cos) X(tanh)
#define NOVA_SCALAR_OPS(X) \
  X(add_scalar)            \
  X(sub_scalar) X(mul_scalar) X(div_scalar) X(scalar_sub) X(scalar_div) X(pow_scalar) X(scalar_pow)

NOVA_BINARY_OPS(NOVA_DEFINE_BINARY)
NOVA_UNARY_OPS(NOVA_DEFINE_UNARY)
Tensor add(const Tensor& x, float b) { return with_parameter(add_scalar_kernel(), x, b); }
Tensor sub(const Tensor& x, float b) { return with_parameter(sub_scalar_kernel(), x, b); }
Tensor mul(const Tensor& x, float b) { return with_parameter(mul_scalar_kernel(), x, b); }
Tensor div(const Tensor& x, float b) { return with_parameter(div_scalar_kernel(), x, b); }
Tensor sub(float a, const Tensor& x) { return with_parameter(scalar_sub_kernel(), x, a); }
Tensor div(float a, const Tensor& x) { return with_parameter(scalar_div_kernel(), x, a); }
Tensor pow(float a, const Tensor& x) { return with_parameter(scalar_pow_kernel(), x, a); }
Tensor pow(const Tensor& x, float b) {
  return b == 2.0f ? mul(x, x) : with_parameter(pow_scalar_kernel(), x, b);
}

void detail::add_op_kernels(EngineKernels& list) {
  const auto add_one = [&](const Kernel& k) { list.push_back({k, every_gradient(k)}); };
#define NOVA_LIST_BINARY(function)                           \
  for (const Access a : {Access::Direct, Access::Uniform})   \
    for (const Access b : {Access::Direct, Access::Uniform}) \
      if (a == Access::Direct || b == Access::Direct) add_one(function##_op().kernel(a, b));
#define NOVA_LIST_UNARY(function) add_one(function##_kernel());
  NOVA_BINARY_OPS(NOVA_LIST_BINARY)
  NOVA_UNARY_OPS(NOVA_LIST_UNARY)
  NOVA_SCALAR_OPS(NOVA_LIST_UNARY)
  add_one(detail::clamp_kernel());
  add_one(where_kernel());
  list.push_back({pow_kernel(),
                  {gradient_mask(pow_kernel(), {"a"}, {}, {"out"}),
                   gradient_mask(pow_kernel(), {"b"}, {}, {"out"}),
                   gradient_mask(pow_kernel(), {"a", "b"}, {}, {"out"})}});
  list.push_back({compare_kernel(), {}});
  list.push_back({compare_scalar_kernel(), {}});
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

namespace {

// Both operands in full, in one shape.
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
  kernel.launch(out.size(), in, {&to, 1}, {.params = params});
  return out;
}

}  // namespace

Tensor pow(const Tensor& a, const Tensor& b) { return launch_pair(pow_kernel(), a, b); }

Tensor compare(Comparison what, const Tensor& a, const Tensor& b) {
  const NoGrad no_grad;
  const Param params[] = {holds(what)};
  return launch_pair(compare_kernel(), a, b, params);
}
Tensor compare(Comparison what, const Tensor& a, float b) {
  const NoGrad no_grad;
  const Param params[] = {holds(what), b};
  return unary(compare_scalar_kernel(), a, params);
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
  where_kernel().launch(out.size(), in, {&to, 1}, {.params = params});
  return out;
}

}  // namespace nova
