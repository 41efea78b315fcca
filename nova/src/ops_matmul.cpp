// The matrix product. The two gradients of a product are products with transposed matrices. One
// kernel with strides as parameters computes all three.
#include <algorithm>
#include <array>
#include <cstring>

#include "checks.h"
#include "engine_kernels.h"
#include "matmul_lanes.h"
#include "novaphy/core/cpu_level.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/networks.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"

namespace nova {

namespace baseline {
extern const ProductLevel kLevel;
}
#ifdef NOVAPHY_X86_LEVELS
namespace avx2 {
extern const ProductLevel kLevel;
}
namespace avx512 {
extern const ProductLevel kLevel;
}
#endif

using detail::check_f32;
using detail::int_param;
using novaphy::require;

namespace {

// On the CPU the product is one launch, whose rows are split here, because a row is more work than
// a row of other kernels.
void multiply(const uint64_t* words, int64_t, int64_t, int64_t) {
  static const ProductLevel& level = novaphy::choose_cpu_level(std::to_array<const ProductLevel*>({
#ifdef NOVAPHY_X86_LEVELS
      &avx512::kLevel, &avx2::kLevel,
#endif
      &baseline::kLevel}));
  constexpr int64_t kTiles = 24, kProducts = 1 << 22;  // rows per chunk; products per chunk
  struct Work {
    ProductWords product;
    int64_t rows;  // rows per chunk
  } work;
  std::memcpy(&work.product, words, sizeof(work.product));
  const ProductWords& p = work.product;
  const int64_t of_row = std::max<int64_t>(1, p.columns * p.shared);
  work.rows = (kProducts / of_row / kTiles + 1) * kTiles;
  novaphy::parallel_for((p.rows + work.rows - 1) / work.rows,
                        [](void* pointer, int64_t chunk) {
                          const Work& w = *static_cast<const Work*>(pointer);
                          const int64_t begin = chunk * w.rows;
                          level.multiply(w.product, begin,
                                         std::min(begin + w.rows, w.product.rows));
                        },
                        &work);
}
constexpr novaphy_row_function kMultiply = {sizeof(novaphy_row_function), "matmul",
                                            sizeof(ProductWords) / 8, 0, multiply};

// The kernel for devices, with the same bits. Parameters: columns of the result, row and column
// strides of a, row and column strides of b.
const Kernel& matmul_kernel() {
  static const Kernel kernel = make_reduce_kernel(
      "matmul", {{"a", DType::F32, 1, Access::Indexed}, {"b", DType::F32, 1, Access::Indexed}},
      {{"out", 1}},
      {.init = {},
       .body =
           [](TraceContext& c) {
             const Int columns = c.param_i32(0), i = c.index(), k = c.reduce_index();
             const Int of_a = i / columns * c.param_i32(1) + k * c.param_i32(2);
             const Int of_b = k * c.param_i32(3) + i % columns * c.param_i32(4);
             return std::vector{c.f32(0, of_a, 0) * c.f32(1, of_b, 0)};
           },
       .epilogue = {}});
  return kernel;
}

// A matrix in memory: entry (r, c) at r * row + c * column.
struct Matrix {
  const Tensor& tensor;
  int64_t rows, columns;
  int64_t row = columns, column = 1;
  Matrix transposed() const { return {tensor, columns, rows, column, row}; }
};

void launch_lanes(const Matrix& a, const Matrix& b, const Tensor& out) {
  const auto matrix = [](const char* name, const Tensor& tensor, bool write) {
    novaphy::LaunchArgument made;
    made.word = reinterpret_cast<uint64_t>(tensor.range()->data());
    made.name = name;
    made.range = tensor.range();
    made.read = !write;
    made.write = write;
    return made;
  };
  using novaphy::number;
  static const auto& kernel = *new novaphy::DeviceKernel(kMultiply, nullptr);
  kernel.launch(out.device(), out.size() > 0 ? 1 : 0,
                {matrix("a", a.tensor, false), matrix("b", b.tensor, false),
                 matrix("out", out, true), number(a.row), number(a.column), number(b.row),
                 number(b.column), number(a.rows), number(b.columns), number(a.columns)});
}

void multiply(const Matrix& a, const Matrix& b, const Tensor& out) {
  const NoGrad no_grad;
  if (out.device().is_cpu()) return launch_lanes(a, b, out);
  const auto param = [](int64_t value) { return int_param("matmul", value); };
  const Param params[] = {param(b.columns), param(a.row), param(a.column), param(b.row),
                          param(b.column)};
  param(a.columns);
  const Operand in[] = {a.tensor.flat_operand(), b.tensor.flat_operand()};
  const Operand to = out.flat_operand();
  matmul_kernel().launch(out.size(), in, to,
                         {.params = params, .extent = static_cast<int32_t>(a.columns)});
}

Tensor product(const Matrix& a, const Matrix& b, const Shape& shape) {
  const Tensor out(shape, DType::F32, a.tensor.device());
  multiply(a, b, out);
  return out;
}

// Transposes a matrix. Not compiled ahead of time, because it moves few numbers. Parameters: rows
// and columns of x.
const Kernel& transpose_kernel() {
  static const Kernel kernel = make_kernel(
      "transpose", {{"x", DType::F32, 1, Access::Indexed}}, {{"out", 1}}, [](TraceContext& c) {
        const Int rows = c.param_i32(0), i = c.index();
        return std::vector{c.f32(0, i % rows * c.param_i32(1) + i / rows, 0)};
      });
  return kernel;
}

// Returns weight^T in new memory, so that a device reads it row by row.
Tensor transposed(const Tensor& x) {
  const Tensor out({x.dim(1), x.dim(0)}, DType::F32, x.device());
  const Param params[] = {int_param("linear", x.dim(0)), int_param("linear", x.dim(1))};
  const Operand in = x.flat_operand(), to = out.flat_operand();
  const NoGrad no_grad;
  transpose_kernel().launch(out.size(), in, to, {.params = params});
  return out;
}

// Computes a b^T.
void multiply_with_transposed(const Matrix& a, const Matrix& b, const Tensor& out) {
  if (b.tensor.device().is_cpu()) return multiply(a, b.transposed(), out);
  multiply(a, {transposed(b.tensor), b.columns, b.rows}, out);
}
Tensor product_with_transposed(const Matrix& a, const Matrix& b, const Shape& shape) {
  const Tensor out(shape, DType::F32, a.tensor.device());
  multiply_with_transposed(a, b, out);
  return out;
}

}  // namespace

void detail::add_matmul_kernels(EngineKernels& list) { list.push_back({matmul_kernel(), {}}); }

Tensor matmul(const Tensor& a, const Tensor& b) {
  check_f32(a, {"matmul", "a"});
  check_f32(b, {"matmul", "b"});
  require(a.device() == b.device(), ErrorKind::Value, "matmul: a is on ", a.device().str(),
          ", b on ", b.device().str());
  const auto is_matrix = [](const Tensor& x) { return x.ndim() == 2; };
  const auto fits = [&](const Tensor& x) { return x.ndim() == 1 || is_matrix(x); };
  const int64_t shared = a.ndim() == 0 ? 1 : a.shape().back();
  require(fits(a) && fits(b) && b.dim(0) == shared, ErrorKind::Value,
          "matmul: expected {n, k} or {k} by {k, m} or {k}, got ", shape_str(a.shape()), " by ",
          shape_str(b.shape()));
  const int64_t n = is_matrix(a) ? a.dim(0) : 1, m = is_matrix(b) ? b.dim(1) : 1;
  Shape shape;
  if (is_matrix(a)) shape.push_back(n);
  if (is_matrix(b)) shape.push_back(m);
  if (shape.empty()) shape.push_back(1);
  const Tensor out(shape, DType::F32, a.device());
  const auto forward = [=] { multiply({a, n, shared}, {b, shared, m}, out); };
  forward();
  const auto vjp = [=](detail::Gradients g, detail::InputGradients to) {
    const Matrix left{a, n, shared}, right{b, shared, m}, grad{g[0], n, m};
    if (to[0].wanted()) to[0].put(product(grad, right.transposed(), a.shape()));
    if (to[1].wanted()) to[1].put(product(left.transposed(), grad, b.shape()));
  };
  const auto tangent = [=](std::span<const Tensor> t) {
    Tensor total;
    if (t[0].defined()) total = product({t[0], n, shared}, {b, shared, m}, shape);
    if (!t[1].defined()) return total;
    const Tensor second = product({a, n, shared}, {t[1], shared, m}, shape);
    return total.defined() ? add(total, second) : second;
  };
  detail::record("matmul", {a, b}, out, forward, vjp, tangent, {a, b});
  return out;
}

Tensor linear(const Tensor& x, const Tensor& weight, const Tensor& bias) {
  check_f32(x, {"linear", "x"});
  check_f32(weight, {"linear", "weight"});
  require(x.ndim() == 1 || x.ndim() == 2, ErrorKind::Value,
          "linear, x: expected {n, k} or {k}, got ", shape_str(x.shape()));
  const int64_t n = x.ndim() == 2 ? x.dim(0) : 1, k = x.shape().back();
  require(weight.ndim() == 2 && weight.dim(1) == k, ErrorKind::Value,
          "linear, weight: expected {m, ", k, "} for x ", shape_str(x.shape()), ", got ",
          shape_str(weight.shape()));
  require(weight.device() == x.device(), ErrorKind::Value, "linear: x is on ", x.device().str(),
          ", weight on ", weight.device().str());
  const int64_t m = weight.dim(0);
  if (bias.defined()) {
    check_f32(bias, {"linear", "bias"});
    require(bias.ndim() == 1 && bias.size() == m, ErrorKind::Value, "linear, bias: expected {", m,
            "}, got ", shape_str(bias.shape()));
  }
  const Shape shape = x.ndim() == 2 ? Shape{n, m} : Shape{m};
  const Tensor out(shape, DType::F32, x.device());
  const auto forward = [=] { multiply_with_transposed({x, n, k}, {weight, m, k}, out); };
  forward();
  const auto vjp = [=](detail::Gradients g, detail::InputGradients to) {
    const Matrix grad{g[0], n, m};
    if (to[0].wanted()) to[0].put(product(grad, {weight, m, k}, x.shape()));
    if (to[1].wanted()) to[1].put(product(grad.transposed(), {x, n, k}, weight.shape()));
  };
  const auto tangent = [=](std::span<const Tensor> t) {
    Tensor total;
    if (t[0].defined()) total = product_with_transposed({t[0], n, k}, {weight, m, k}, shape);
    if (!t[1].defined()) return total;
    const Tensor second = product_with_transposed({x, n, k}, {t[1], m, k}, shape);
    return total.defined() ? add(total, second) : second;
  };
  detail::record("linear", {x, weight}, out, forward, vjp, tangent, {x, weight});
  return bias.defined() ? add(out, bias) : out;
}

}  // namespace nova
