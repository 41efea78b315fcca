#include "novaphy/diff/losses.h"

#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/ops.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

void check_points(const Tensor& points, const char* op, const char* name) {
  require(points.defined() && points.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  require(points.ndim() == 2 && points.row_width() == 3, ErrorKind::Value, op, ", ", name,
          ": expected {n, 3} tightly packed float32, got ", nova::shape_str(points.shape()));
}

void check_target(float x, float y, float z, const char* op) {
  require(std::isfinite(x) && std::isfinite(y) && std::isfinite(z), ErrorKind::Value, op,
          ", target: expected finite coordinates, got (", x, ", ", y, ", ", z, ")");
}

std::vector<Real> squared_distance(TraceContext& c, const Vec3<Real>& p) {
  const Vec3<Real> delta = p - Vec3<Real>{c.param(0), c.param(1), c.param(2)};
  return {math::dot(delta, delta)};
}

const nova::Kernel& particle_point_loss_kernel() {
  static const nova::Kernel kernel = nova::with_one_gradient_set(nova::make_kernel(
      "particle_point_loss",
      {{"particle_index", DType::I32, 1, Access::Direct},
       {"particle_q", DType::F32, 3, Access::Indexed}},
      {{"loss", 1}}, [](TraceContext& c) {
        const nova::Int row = c.i32(0);
        return squared_distance(c, {c.f32(1, row, 0), c.f32(1, row, 1), c.f32(1, row, 2)});
      }));
  return kernel;
}

const nova::Kernel& vec3_point_loss_kernel() {
  static const nova::Kernel kernel = nova::with_one_gradient_set(
      nova::make_kernel("vec3_point_loss", {{"point", DType::F32, 3, Access::Direct}},
                        {{"loss", 1}}, [](TraceContext& c) {
                          return squared_distance(c, {c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)});
                        }));
  return kernel;
}

}  // namespace

void detail::add_loss_kernels(std::vector<nova::EngineKernel>& list) {
  for (const nova::Kernel& k : {particle_point_loss_kernel(), vec3_point_loss_kernel()})
    list.push_back({k, k.gradients()});
}

Tensor particle_point_loss_generated(const Tensor& particle_q, int64_t particle_index,
                                     float target_x, float target_y, float target_z) {
  const char* op = "particle_point_loss_generated";
  check_points(particle_q, op, "particle_q");
  check_target(target_x, target_y, target_z, op);
  require(particle_index >= 0 && particle_index < particle_q.rows(), ErrorKind::Index, op,
          ", particle_index: expected 0 <= index < ", particle_q.rows(), ", got ", particle_index);
  const auto index = static_cast<int32_t>(particle_index);
  const Tensor table = Tensor::from_host(std::span(&index, 1), {1}, particle_q.device());
  const nova::Param params[] = {target_x, target_y, target_z};
  return particle_point_loss_kernel()(1, {table, particle_q}, {.params = params})[0];
}

Tensor particle_centroid_generated(const Tensor& particle_q) {
  check_points(particle_q, "particle_centroid_generated", "particle_q");
  require(particle_q.rows() > 0, ErrorKind::Value,
          "particle_centroid_generated, particle_q: expected at least one row");
  return nova::sum_rows(nova::div(particle_q, static_cast<float>(particle_q.rows())));
}

Tensor vec3_point_loss_generated(const Tensor& point, float target_x, float target_y,
                                 float target_z) {
  const char* op = "vec3_point_loss_generated";
  require(point.defined() && point.dtype() == DType::F32, ErrorKind::Type, op,
          ", point: expected a float32 tensor");
  require(point.size() == 3 && point.ndim() <= 2, ErrorKind::Value, op,
          ", point: expected {1, 3} or {3}, got ", nova::shape_str(point.shape()));
  check_target(target_x, target_y, target_z, op);
  const nova::Param params[] = {target_x, target_y, target_z};
  return vec3_point_loss_kernel()(1, {point.reshape({1, 3})}, {.params = params})[0];
}

Tensor clamp_f32_generated(const Tensor& x, float lower, float upper) {
  require(x.defined() && x.dtype() == DType::F32, ErrorKind::Type,
          "clamp_f32_generated, x: expected a float32 tensor");
  require(lower <= upper, ErrorKind::Value, "clamp_f32_generated: expected lower <= upper, got ",
          lower, " and ", upper);
  return nova::clamp(x, lower, upper);
}

}  // namespace novaphy::diff
