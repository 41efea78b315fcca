// Sums over a dimension, and their adjoint, which repeats values. The tensor is viewed as {outer,
// count, inner}, and `count` is the dimension.
#include <algorithm>

#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"

namespace nova {

using detail::Along;
using detail::check_f32;
using detail::Gradients;
using detail::InputGradients;
using novaphy::require;

namespace {

// Repeats values. Parameters: inner, count * inner.
const Kernel& broadcast_kernel() {
  static const Kernel kernel = make_kernel(
      "broadcast", {{"x", DType::F32, 1, Access::Indexed}}, {{"out", 1}}, [](TraceContext& c) {
        const Int inner = c.param_i32(0), i = c.index();
        return std::vector{c.f32(0, i / c.param_i32(1) * inner + i % inner, 0)};
      });
  return kernel;
}

// Repeats a single value without the row index, so the kernel can be fused with its neighbors.
const Kernel& broadcast_value_kernel() {
  static const Kernel kernel =
      make_kernel("broadcast_value", {{"value", DType::F32, 1, Access::Uniform}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0)}; });
  return kernel;
}

Tensor repeat_along(const Tensor& x, const Along& along, const Shape& shape);

// Removes a dimension. A shape without other dimensions becomes {1}.
Shape without_dimension(Shape shape, size_t axis, bool keepdims) {
  shape[axis] = 1;
  if (!keepdims && shape.size() > 1) shape.erase(shape.begin() + static_cast<std::ptrdiff_t>(axis));
  return shape;
}

// Sums {outer, count, inner} to {outer, inner}, in the order of the row-sum rule.
Tensor sum_along(const Tensor& x, const Along& along, const Shape& shape) {
  require(along.inner <= INT32_MAX, ErrorKind::Value,
          "sum: expected rows of less than 2^31 values, got shape ", shape_str(x.shape()));
  const Tensor out(shape, DType::F32, x.device());
  const auto width = static_cast<int32_t>(along.inner);
  const auto forward = [=] {
    if (width == 0) return;  // rows of width 0 have nothing to sum
    row_sum({x.range(), along.outer * along.count, width}, along.outer, along.count, nullptr,
            {out.range(), along.outer, width});
  };
  forward();
  detail::record(
      "sum", {x}, out, forward,
      [along, shape = x.shape()](Gradients g, InputGradients to) {
        to[0].put(repeat_along(g[0], along, shape));
      },
      [along, shape](std::span<const Tensor> t) { return sum_along(t[0], along, shape); });
  return out;
}

// Repeats {outer, inner} to {outer, count, inner}.
Tensor repeat_along(const Tensor& x, const Along& along, const Shape& shape) {
  const Tensor out(shape, DType::F32, x.device());
  const auto forward = [=] {
    const Operand in = x.flat_operand(), target = out.flat_operand();
    const Param params[] = {detail::int_param("broadcast", along.inner),
                            detail::int_param("broadcast", along.count * along.inner)};
    const NoGrad no_grad;
    const bool one = x.size() == 1;
    (one ? broadcast_value_kernel() : broadcast_kernel())
        .launch(out.size(), in, target,
                {.params = one ? std::span<const Param>() : std::span<const Param>(params)});
  };
  forward();
  detail::record(
      "broadcast", {x}, out, forward,
      [along, shape = x.shape()](Gradients g, InputGradients to) {
        if (along.outer * along.inner != 1) return to[0].put(sum_along(g[0], along, shape));
        // The gradient of a single value continues from the present value, like the gradient of a
        // uniform source.
        const Operand sum = to[0].grad.flat_operand();
        row_sum({g[0].range(), along.count, 1}, 1, along.count, to[0].add ? &sum : nullptr, sum);
      },
      [along, shape](std::span<const Tensor> t) { return repeat_along(t[0], along, shape); });
  return out;
}

}  // namespace

void detail::add_sum_kernels(EngineKernels& list) {
  list.push_back({broadcast_kernel(), {}});
  list.push_back({broadcast_value_kernel(), {}});
}

Along detail::along(const char* call, const Shape& shape, int64_t axis) {
  const auto ndim = static_cast<int64_t>(shape.size());
  require(axis >= -ndim && axis < ndim, ErrorKind::Index, call, ", axis: expected ", -ndim, " to ",
          ndim - 1, " for shape ", shape_str(shape), ", got ", axis);
  Along a{static_cast<size_t>(axis < 0 ? axis + ndim : axis)};
  for (size_t d = 0; d < shape.size(); ++d)
    (d < a.axis ? a.outer : d == a.axis ? a.count : a.inner) *= shape[d];
  return a;
}

Param detail::int_param(const char* call, int64_t value) {
  require(value >= INT32_MIN && value <= INT32_MAX, ErrorKind::Value, call, ": ", value,
          " values are more than a kernel can number");
  return Param(static_cast<int32_t>(value));
}

void detail::record(const char* name, std::vector<Tensor> inputs, const Tensor& out,
                    std::function<void()> forward, decltype(CustomOp::vjp) vjp, TangentFn tangent,
                    std::vector<Tensor> reads) {
  Tape* tape = Tape::active();
  if (tape == nullptr) return;
  CustomOp op{.name = name, .inputs = std::move(inputs), .outputs = {out}, .vjp = std::move(vjp)};
  op.jvp = [tangent = std::move(tangent)](std::span<const Tensor> in, std::span<const Tensor> to) {
    to[0].copy_(tangent(in));
  };
  op.forward = std::move(forward);
  op.reads = std::move(reads);
  tape->record_custom(std::move(op));
}

Shape broadcast_shape(const char* call, const Shape& a, const Shape& b) {
  Shape shape(std::max(a.size(), b.size()), 1);
  for (size_t k = 1; k <= shape.size(); ++k) {
    const int64_t x = k <= a.size() ? a[a.size() - k] : 1, y = k <= b.size() ? b[b.size() - k] : 1;
    require(x == y || x == 1 || y == 1, ErrorKind::Value, call, ": shapes ", shape_str(a), " and ",
            shape_str(b), " differ, and cannot be broadcast to one");
    shape[shape.size() - k] = x == 1 ? y : x;
  }
  return shape;
}

Tensor broadcast_to(const Tensor& x, const Shape& shape) {
  check_f32(x, {"broadcast_to", "x"});
  require(x.ndim() <= shape.size() && broadcast_shape("broadcast_to", x.shape(), shape) == shape,
          ErrorKind::Value, "broadcast_to: shape ", shape_str(x.shape()),
          " cannot be broadcast to ", shape_str(shape));
  if (x.shape() == shape) return x;
  Shape now(shape.size() - x.ndim(), 1);
  now.insert(now.end(), x.shape().begin(), x.shape().end());
  Tensor t = x;
  // Consecutive dimensions that are repeated are repeated together.
  for (size_t first = 0, end; first < shape.size(); first = end) {
    for (end = first; end < shape.size() && now[end] != shape[end]; ++end) now[end] = shape[end];
    if (end == first) {
      ++end;
      continue;
    }
    Along along{first};
    for (size_t d = 0; d < shape.size(); ++d)
      (d < first ? along.outer : d < end ? along.count : along.inner) *= now[d];
    t = repeat_along(t, along, now);
  }
  return t.reshape(shape);
}

Tensor sum(const Tensor& x) {
  check_f32(x, {"sum", "x"});
  return sum_along(x, {.count = x.size()}, {1});
}
Tensor sum(const Tensor& x, int64_t axis, bool keepdims) {
  check_f32(x, {"sum", "x"});
  const Along along = detail::along("sum", x.shape(), axis);
  return sum_along(x, along, without_dimension(x.shape(), along.axis, keepdims));
}
Tensor sum_rows(const Tensor& x) {
  check_f32(x, {"sum_rows", "x"});
  require(x.ndim() == 2, ErrorKind::Value, "sum_rows, x: expected {n, w}, got ",
          shape_str(x.shape()));
  return sum(x, 0, true);
}

namespace {
void check_not_empty(const char* call, const Tensor& x, int64_t count) {
  require(count > 0, ErrorKind::Value, call, ", x: expected at least one value, got shape ",
          shape_str(x.shape()));
}
}  // namespace

Tensor mean(const Tensor& x) {
  check_f32(x, {"mean", "x"});
  check_not_empty("mean", x, x.size());
  return div(sum(x), static_cast<float>(x.size()));
}
Tensor mean(const Tensor& x, int64_t axis, bool keepdims) {
  check_f32(x, {"mean", "x"});
  const int64_t count = detail::along("mean", x.shape(), axis).count;
  check_not_empty("mean", x, count);
  return div(sum(x, axis, keepdims), static_cast<float>(count));
}
namespace {
// Compares both halves of a dimension until one entry is left. For an odd size the middle entry
// belongs to both halves.
Tensor fold(const char* call, Tensor x, int64_t axis, bool keepdims,
            Tensor (*pick)(const Tensor&, const Tensor&)) {
  check_f32(x, {call, "x"});
  const size_t d = detail::along(call, x.shape(), axis).axis;
  check_not_empty(call, x, x.dim(d));
  for (int64_t n = x.dim(d); n > 1; n = x.dim(d)) {
    const int64_t half = (n + 1) / 2;
    x = pick(slice(x, axis, 0, half), slice(x, axis, n - half, half));
  }
  return x.reshape(without_dimension(x.shape(), d, keepdims));
}
Tensor all_values(const char* call, const Tensor& x) {
  check_f32(x, {call, "x"});
  return x.reshape({x.size()});
}
}  // namespace

Tensor max(const Tensor& x) { return max(all_values("max", x), 0); }
Tensor min(const Tensor& x) { return min(all_values("min", x), 0); }
Tensor max(const Tensor& x, int64_t axis, bool keepdims) {
  return fold("max", x, axis, keepdims, &maximum);
}
Tensor min(const Tensor& x, int64_t axis, bool keepdims) {
  return fold("min", x, axis, keepdims, &minimum);
}
Tensor dot(const Tensor& a, const Tensor& b) {
  check_f32(a, {"dot", "a"});
  check_f32(b, {"dot", "b"});
  require(a.shape() == b.shape() || a.size() == 1 || b.size() == 1, ErrorKind::Value,
          "dot: shapes ", shape_str(a.shape()), " and ", shape_str(b.shape()), " differ");
  return sum(mul(a, b));
}
Tensor norm(const Tensor& x) { return sqrt(dot(x, x)); }

}  // namespace nova
