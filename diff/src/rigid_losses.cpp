#include "novaphy/diff/rigid_losses.h"

#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

void check_width(const Tensor& tensor, int64_t width, const char* op, const char* name) {
  require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  require(tensor.ndim() == 2 && tensor.row_width() == width, ErrorKind::Value, op, ", ", name,
          ": expected {b, ", width, "} tightly packed float32, got ",
          nova::shape_str(tensor.shape()));
}

void check_finite(float value, const char* op, const char* name) {
  require(std::isfinite(value), ErrorKind::Value, op, ", ", name,
          ": expected a finite number, got ", value);
}

Vec3f unit(const Vec3f& v, const char* op, const char* name) {
  const double x = v.x, y = v.y, z = v.z, length = std::sqrt(x * x + y * y + z * z);
  require(std::isfinite(length) && length > 0.0, ErrorKind::Value, op, ", ", name,
          ": expected an axis of finite length > 0, got (", v.x, ", ", v.y, ", ", v.z, ")");
  return {static_cast<float>(x / length), static_cast<float>(y / length),
          static_cast<float>(z / length)};
}

const nova::Kernel& twist_kernel() {
  static const nova::Kernel kernel = nova::with_one_gradient_set(
      nova::make_kernel("body_twist_from_omega", {{"omega", DType::F32, 3, Access::Direct}},
                        {{"body_qd", 6}}, [](TraceContext& c) {
                          return std::vector<Real>{c.param(0),  c.param(1),  c.param(2),
                                                   c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)};
                        }));
  return kernel;
}

// Parameters of the kernel: a, ta, b, tb (3 numbers each), wa, wb, h, wh, wv, ww. rigid_losses.h
// explains them.
const nova::Kernel& orientation_kernel() {
  static const nova::Kernel kernel = nova::with_one_gradient_set(nova::make_kernel(
      "rigid_orientation_velocity_loss",
      {{"body_index", DType::I32, 1, Access::Direct},
       {"body_q", DType::F32, 7, Access::Indexed},
       {"body_qd", DType::F32, 6, Access::Indexed}},
      {{"loss", 1}}, [](TraceContext& c) {
        using namespace math;
        const nova::Int row = c.i32(0);
        const auto q = [&](int32_t k) { return c.f32(1, row, k); };
        const auto qd = [&](int32_t k) { return c.f32(2, row, k); };
        const auto vec3 = [&](int32_t k) {
          return Vec3<Real>{c.param(k), c.param(k + 1), c.param(k + 2)};
        };
        const Quat<Real> turn = {q(3), q(4), q(5), q(6)};
        const Vec3<Real> v = {qd(0), qd(1), qd(2)}, w = {qd(3), qd(4), qd(5)};
        const Real one = 1.0f, off = q(2) - c.param(14);
        const Real axes = c.param(12) * (one - dot(rotate(turn, vec3(0)), vec3(3))) +
                          c.param(13) * (one - dot(rotate(turn, vec3(6)), vec3(9)));
        const Real speeds = c.param(16) * dot(v, v) + c.param(17) * dot(w, w);
        return std::vector<Real>{(axes + (c.param(15) * off) * off) + speeds};
      }));
  return kernel;
}

}  // namespace

void detail::add_rigid_loss_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k : {twist_kernel(), orientation_kernel()})
    list.push_back({k, k.gradients()});
}

Tensor body_twist_from_omega_generated(const Tensor& omega, float linear_x, float linear_y,
                                       float linear_z) {
  const char* op = "body_twist_from_omega_generated";
  check_width(omega, 3, op, "omega");
  check_finite(linear_x, op, "linear_x");
  check_finite(linear_y, op, "linear_y");
  check_finite(linear_z, op, "linear_z");
  const nova::Param params[] = {linear_x, linear_y, linear_z};
  return twist_kernel()(omega.rows(), {omega}, {.params = params})[0];
}

Tensor rigid_orientation_velocity_loss_generated(const Tensor& body_q, const Tensor& body_qd,
                                                 int64_t body_index, const Vec3f& local_axis_a,
                                                 const Vec3f& target_axis_a,
                                                 const Vec3f& local_axis_b,
                                                 const Vec3f& target_axis_b,
                                                 const OrientationLossOptions& options) {
  const char* op = "rigid_orientation_velocity_loss_generated";
  check_width(body_q, 7, op, "body_q");
  check_width(body_qd, 6, op, "body_qd");
  require(body_q.rows() == body_qd.rows(), ErrorKind::Value, op, ", body_qd: expected ",
          body_q.rows(), " rows as body_q has, got ", body_qd.rows());
  require(body_index >= 0 && body_index < body_q.rows(), ErrorKind::Index, op,
          ", body_index: expected 0 <= index < ", body_q.rows(), ", got ", body_index);
  std::vector<nova::Param> params;
  const auto add_axis = [&](const Vec3f& v, const char* name) {
    const Vec3f u = unit(v, op, name);
    for (const float x : {u.x, u.y, u.z}) params.emplace_back(x);
  };
  const auto add = [&](float value, const char* name) {
    check_finite(value, op, name);
    params.emplace_back(value);
  };
  add_axis(local_axis_a, "local_axis_a");
  add_axis(target_axis_a, "target_axis_a");
  add_axis(local_axis_b, "local_axis_b");
  add_axis(target_axis_b, "target_axis_b");
  add(options.axis_weight_a, "axis_weight_a");
  add(options.axis_weight_b, "axis_weight_b");
  add(options.target_height, "target_height");
  add(options.height_weight, "height_weight");
  add(options.linear_velocity_weight, "linear_velocity_weight");
  add(options.angular_velocity_weight, "angular_velocity_weight");
  const auto index = static_cast<int32_t>(body_index);
  const Tensor table = Tensor::from_host(std::span(&index, 1), {1}, body_q.device());
  return orientation_kernel()(1, {table, body_q, body_qd}, {.params = params})[0];
}

}  // namespace novaphy::diff
