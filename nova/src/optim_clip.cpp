// Clipping of gradients, and limiting a parameter to an interval.
#include <cmath>

#include "engine_kernels.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"
#include "ops_impl.h"
#include "optim_impl.h"

namespace nova {

using novaphy::require;

namespace {

const Kernel& square_kernel() {
  static const Kernel kernel =
      make_kernel("square_f32", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(0)}; });
  return kernel;
}

// PyTorch's constant, which avoids a division by 0.
constexpr float kNormEpsilon = 1e-6f;

const Kernel& clip_factor_kernel() {
  static const Kernel kernel =
      make_kernel("clip_factor_f32", {{"total", DType::F32, 1, Access::Direct}},
                  {{"norm", 1}, {"factor", 1}}, [](TraceContext& c) {
                    const Real norm = sqrt(c.f32(0));
                    const Bool finite = norm < Real(INFINITY);  // false for NaN
                    const Real wanted = c.param(0) / (norm + Real(kNormEpsilon));
                    return std::vector{norm, select(finite, min(wanted, Real(1.0f)), Real(0.0f))};
                  });
  return kernel;
}

// Turns `total`, the sum of squares, into the norm. `factor` becomes the factor of the gradients, 0
// for a norm that is not finite.
void norm_and_factor(const Operand& total, const Operand& factor, float max_norm) {
  const Operand out[] = {total, factor};
  const Param params[] = {max_norm};
  clip_factor_kernel().launch(1, total, out, {.params = params});
}

const Kernel& scale_grad_kernel() {
  static const Kernel kernel = make_kernel(
      "scale_grad_f32",
      {{"grad", DType::F32, 1, Access::Direct}, {"factor", DType::F32, 1, Access::Uniform}},
      {{"grad", 1}}, [](TraceContext& c) {
        const Real zero(0.0f), by = c.f32(1);
        // The product of 0 and a gradient that is not finite would be NaN.
        return std::vector{select(by == zero, zero, c.f32(0) * by)};
      });
  return kernel;
}

void scale(const Operand& grad, const Operand& factor) {
  const Operand in[] = {grad, factor};
  scale_grad_kernel().launch(grad.rows, in, {in, 1});
}

void clamp_in_place(const Operand& x, float lower, float upper) {
  const Param params[] = {lower, upper};
  detail::clamp_kernel().launch(x.rows, x, x, {.params = params});
}

}  // namespace

void detail::add_clip_kernels(EngineKernels& list) {
  for (const Kernel* k : {&square_kernel(), &clip_factor_kernel(), &scale_grad_kernel()})
    list.push_back({*k, {}});
}

Tensor clip_grad_norm_(const std::vector<Tensor>& params, float max_norm) {
  detail::check_params(params, "clip_grad_norm_");
  detail::check_grads(params, "clip_grad_norm_");
  require(max_norm > 0.0f, ErrorKind::Value,
          "clip_grad_norm_, max_norm: expected a number > 0, got ", max_norm);
  NoGrad no_grad;
  const Tensor norm({1}, DType::F32, params[0].device());
  const Tensor factor({1}, DType::F32, params[0].device());
  detail::sum_over_grads(params, square_kernel(), norm.operand());
  norm_and_factor(norm.operand(), factor.operand(), max_norm);
  for (const Tensor& p : params) scale(detail::grad_operand(p), factor.operand());
  return norm;
}

void clip_grad_value_(const std::vector<Tensor>& params, float v) {
  detail::check_params(params, "clip_grad_value_");
  detail::check_grads(params, "clip_grad_value_");
  require(v > 0.0f, ErrorKind::Value, "clip_grad_value_, v: expected a number > 0, got ", v);
  NoGrad no_grad;
  for (const Tensor& p : params) clamp_in_place(detail::grad_operand(p), -v, v);
}

void clamp_(const Tensor& param, float lower, float upper) {
  detail::check_f32(param, {"clamp_", "param"});
  detail::check_limits("clamp_", lower, upper);
  NoGrad no_grad;
  clamp_in_place(param.flat_operand(), lower, upper);
}

}  // namespace nova
