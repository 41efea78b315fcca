// The updates of plain gradient descent, without moments.
#include "novaphy/nova/optim.h"

#include <cmath>

#include "engine_kernels.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"
#include "optim_impl.h"

namespace nova {

using novaphy::require;
using novaphy::Vec3;

namespace {

void check_param(const Tensor& param, float learning_rate, const char* call) {
  detail::check_f32(param, {call, "param"});
  detail::check_has_grad(param, {call, "param"});
  require(std::isfinite(learning_rate), ErrorKind::Value, call,
          ", learning_rate: expected a finite number, got ", learning_rate);
}

// x * 0 is 0 if and only if x is finite.
Bool is_finite(const Real& x) { return x * Real(0.0f) == Real(0.0f); }

// Returns v, scaled to the length `limit` if it is longer. limit <= 0 switches the clip off.
Vec3<Real> clip(const Vec3<Real>& v, const Real& limit) {
  const Real l = novaphy::math::length(v);
  const Bool too_long = both(Real(0.0f) < limit, limit < l);
  return novaphy::math::select(too_long, v * (limit / l), v);
}

const Kernel& sgd_kernel() {
  static const Kernel kernel = make_kernel(
      "sgd_update_f32",
      {{"param", DType::F32, 1, Access::Direct}, {"grad", DType::F32, 1, Access::Direct}},
      {{"param", 1}},
      [](TraceContext& c) { return std::vector{c.f32(0) - c.f32(1) * c.param(0)}; });
  return kernel;
}

const Kernel& sgd_vec3_clipped_kernel() {
  static const Kernel kernel = make_kernel(
      "sgd_update_vec3_clipped_f32",
      {{"param", DType::F32, 3, Access::Direct}, {"grad", DType::F32, 3, Access::Direct}},
      {{"param", 3}}, [](TraceContext& c) {
        const Vec3<Real> p{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)};
        const Vec3<Real> g{c.f32(1, 0), c.f32(1, 1), c.f32(1, 2)};
        const Bool finite = both(is_finite(g.x), both(is_finite(g.y), is_finite(g.z)));
        const Vec3<Real> moved = clip(p - clip(g, c.param(2)) * c.param(0), c.param(1));
        const Vec3<Real> out = novaphy::math::select(finite, moved, p);
        return std::vector{out.x, out.y, out.z};
      });
  return kernel;
}

}  // namespace

// Updates are never recorded, so these kernels have no gradients.
void detail::add_optim_kernels(EngineKernels& list) {
  list.push_back({sgd_kernel(), {}});
  list.push_back({sgd_vec3_clipped_kernel(), {}});
  add_sgd_kernels(list);
  add_adam_kernels(list);
  add_clip_kernels(list);
}

void sgd_update_f32(const Tensor& param, float learning_rate) {
  check_param(param, learning_rate, "sgd_update_f32");
  NoGrad no_grad;
  const Operand in[] = {param.flat_operand(), detail::grad_operand(param)};
  const Param params[] = {learning_rate};
  sgd_kernel().launch(param.size(), in, {&in[0], 1}, {.params = params});
}

void sgd_update_vec3_clipped_f32(const Tensor& param, float learning_rate, float max_parameter_norm,
                                 float max_gradient_norm) {
  check_param(param, learning_rate, "sgd_update_vec3_clipped_f32");
  require(param.row_width() == 3, ErrorKind::Value,
          "sgd_update_vec3_clipped_f32, param: expected {n, 3}, got ", shape_str(param.shape()));
  require(!std::isnan(max_parameter_norm) && !std::isnan(max_gradient_norm), ErrorKind::Value,
          "sgd_update_vec3_clipped_f32: expected norms that are numbers, got NaN");
  NoGrad no_grad;
  const Operand in[] = {param.operand(), param.grad().operand()};
  const Param params[] = {learning_rate, max_parameter_norm, max_gradient_norm};
  sgd_vec3_clipped_kernel().launch(param.rows(), in, {&in[0], 1}, {.params = params});
}

}  // namespace nova
