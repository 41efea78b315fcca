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

template <class F>
Tensor binary(Binary<F>& op, const Tensor& a, const Tensor& b) {
  check_f32(a, {op.name, "a"});
  check_f32(b, {op.name, "b"});
  require(a.device() == b.device(), ErrorKind::Value, op.name, ": a is on ", a.device().str(),
          ", b on ", b.device().str());
  const bool one_a = a.size() == 1 && b.size() != 1, one_b = b.size() == 1 && a.size() != 1;
  require(one_a || one_b || a.shape() == b.shape() || (a.size() == 1 && b.size() == 1),
          ErrorKind::Value, op.name, ": shapes ", shape_str(a.shape()), " and ",
          shape_str(b.shape()), " differ");
  const Tensor out(one_a ? b.shape() : a.shape(), DType::F32, a.device());
  const Operand in[] = {a.flat_operand(), b.flat_operand()};
  const Operand to = out.flat_operand();
  op.kernel(one_a ? Access::Uniform : Access::Direct, one_b ? Access::Uniform : Access::Direct)
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
NOVA_UNARY_OP(neg, -v)
NOVA_UNARY_OP(abs, abs(v))
NOVA_UNARY_OP(sqrt, sqrt(v))
NOVA_UNARY_OP(exp, exp(v))
NOVA_UNARY_OP(log, log(v))
NOVA_UNARY_OP(sin, sin(v))
NOVA_UNARY_OP(cos, cos(v))
NOVA_UNARY_OP(tanh, tanh(v))

const Kernel& where_kernel() {
  static const Kernel kernel = make_kernel(
      "where",
      {{"condition", DType::I32, 1, Access::Direct},
       {"a", DType::F32, 1, Access::Direct},
       {"b", DType::F32, 1, Access::Direct}},
      {{"out", 1}},
      [](TraceContext& c) { return std::vector{select(c.i32(0) != Int(0), c.f32(1), c.f32(2))}; });
  return kernel;
}

// The adjoint of a sum of rows: every row gets the gradient of the sum.
const Kernel& broadcast_kernel() {
  static const Kernel kernel = make_kernel(
      "broadcast", {{"row", DType::F32, 1, Access::Indexed}}, {{"out", 1}},
      [](TraceContext& c) { return std::vector{c.f32(0, c.index() % c.param_i32(0), 0)}; });
  return kernel;
}

const Kernel& broadcast_value_kernel() {
  static const Kernel kernel =
      make_kernel("broadcast_value", {{"value", DType::F32, 1, Access::Uniform}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0)}; });
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
  X(add_scalar) X(sub_scalar) X(mul_scalar) X(div_scalar) X(scalar_sub) X(scalar_div)

NOVA_BINARY_OPS(NOVA_DEFINE_BINARY)
NOVA_UNARY_OPS(NOVA_DEFINE_UNARY)
Tensor add(const Tensor& x, float b) { return with_parameter(add_scalar_kernel(), x, b); }
Tensor sub(const Tensor& x, float b) { return with_parameter(sub_scalar_kernel(), x, b); }
Tensor mul(const Tensor& x, float b) { return with_parameter(mul_scalar_kernel(), x, b); }
Tensor div(const Tensor& x, float b) { return with_parameter(div_scalar_kernel(), x, b); }
Tensor sub(float a, const Tensor& x) { return with_parameter(scalar_sub_kernel(), x, a); }
Tensor div(float a, const Tensor& x) { return with_parameter(scalar_div_kernel(), x, a); }

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
  list.push_back({broadcast_kernel(), {}});  // these two are only ever part of a backward
  list.push_back({broadcast_value_kernel(), {}});
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

Tensor where(const Tensor& condition, const Tensor& a, const Tensor& b) {
  require(condition.defined() && condition.dtype() == DType::I32, ErrorKind::Type,
          "where, condition: expected int32");
  check_f32(a, {"where", "a"});
  check_f32(b, {"where", "b"});
  require(condition.shape() == a.shape() && a.shape() == b.shape(), ErrorKind::Value,
          "where: shapes ", shape_str(condition.shape()), ", ", shape_str(a.shape()), " and ",
          shape_str(b.shape()), " differ");
  const Tensor out(a.shape(), DType::F32, a.device());
  const Operand in[] = {condition.flat_operand(), a.flat_operand(), b.flat_operand()};
  const Operand to = out.flat_operand();
  where_kernel().launch(out.size(), in, {&to, 1});
  return out;
}

namespace {

// Sums of all rows: {1, w} as `shape`. Its adjoint gives every row the gradient of the sum.
Tensor sum_of_rows(const Operand& x, Shape shape, const Tensor& source) {
  const Tensor out(std::move(shape), DType::F32, source.device());
  row_sum(x, 1, x.rows, nullptr, {out.range(), 1, x.width});
  if (Tape* tape = Tape::active()) {
    CustomOp op = make_custom_op("sum", {source}, {out}, [x](const std::vector<Tensor>& g) {
      const Tensor spread(Shape{x.rows, x.width}, DType::F32, g[0].device());
      const Operand in = g[0].flat_operand(), to = spread.flat_operand();
      const Param width[] = {x.width};
      // A single value goes without the row number, and so block by block with its neighbours.
      const bool one = x.width == 1;
      (one ? broadcast_value_kernel() : broadcast_kernel())
          .launch(spread.size(), {&in, 1}, {&to, 1},
                  {.params = std::span<const Param>(width, one ? 0 : 1)});
      return std::vector<Tensor>{spread};
    });
    op.jvp = [x](std::span<const Tensor> in, std::span<const Tensor> sums) {
      row_sum({in[0].range(), x.rows, x.width}, 1, x.rows, nullptr, {sums[0].range(), 1, x.width});
    };
    tape->record_custom(std::move(op));
  }
  return out;
}

}  // namespace

Tensor sum(const Tensor& x) {
  check_f32(x, {"sum", "x"});
  return sum_of_rows(x.flat_operand(), {1}, x);
}
Tensor sum_rows(const Tensor& x) {
  check_f32(x, {"sum_rows", "x"});
  require(x.ndim() == 2, ErrorKind::Value, "sum_rows, x: expected {n, w}, got ",
          shape_str(x.shape()));
  return sum_of_rows(x.operand(), {1, x.row_width()}, x);
}
Tensor mean(const Tensor& x) {
  require(x.defined() && x.size() > 0, ErrorKind::Value, "mean, x: expected at least one value");
  return div(sum(x), static_cast<float>(x.size()));
}
Tensor dot(const Tensor& a, const Tensor& b) { return sum(mul(a, b)); }
Tensor norm(const Tensor& x) { return sqrt(dot(x, x)); }

}  // namespace nova
