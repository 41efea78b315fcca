// Functions of the last dimension: the cross product of vectors, and quaternions (x, y, z, w).
#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/math/types.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/registry.h"

namespace nova {

using novaphy::require;

namespace {

using Vector = novaphy::Vec3<Real>;
using Quaternion = novaphy::Quat<Real>;
namespace math = novaphy::math;

Vector vector(TraceContext& c, size_t s) { return {c.f32(s, 0), c.f32(s, 1), c.f32(s, 2)}; }
Quaternion quaternion(TraceContext& c, size_t s) {
  return {c.f32(s, 0), c.f32(s, 1), c.f32(s, 2), c.f32(s, 3)};
}
std::vector<Real> values(const Vector& v) { return {v.x, v.y, v.z}; }
std::vector<Real> values(const Quaternion& q) { return {q.x, q.y, q.z, q.w}; }

// Returns q = (r sin(a)/|r|, cos(a)) with a = |r|/2. Below a = 0.1 the sine is replaced by its
// series, which has a derivative at 0.
Quaternion exponential(const Vector& r) {
  const Vector half = r * Real(0.5f);
  const Real a2 = math::dot(half, half), a = sqrt(a2);
  const Real series = Real(1.0f) - a2 * (Real(1.0f / 6.0f) - a2 * Real(1.0f / 120.0f));
  const Real s = select(a2 < Real(1e-2f), series, sin(a) / a);
  return {half.x * s, half.y * s, half.z * s, cos(a)};
}
// Returns r = 2 atan2(|v|, w) v/|v| of q or -q, whichever has w >= 0. Below |v|/w = 0.03 the arc
// tangent is replaced by its series.
Vector logarithm(const Quaternion& q) {
  const Real side = select(q.w < Real(0.0f), Real(-1.0f), Real(1.0f)), w = q.w * side;
  const Vector v = Vector{q.x, q.y, q.z} * side;
  const Real n2 = math::dot(v, v), n = sqrt(n2);
  const auto small = n2 < w * w * Real(1e-3f);
  const Real t2 = n2 / (w * w);
  const Real series = Real(1.0f) - t2 * (Real(1.0f / 3.0f) - t2 * Real(0.2f));
  return v * (Real(2.0f) * select(small, series / w, atan2(n, w) / n));
}

// Makes a kernel that reads every source at its own row.
template <class F>
Kernel row_kernel(const char* name, std::vector<SourceSpec> sources, int32_t width, F f) {
  return with_one_gradient_set(make_kernel(name, std::move(sources), {{"out", width}},
                                           [f](TraceContext& c) { return values(f(c)); }));
}
const Kernel& cross_kernel() {
  static const Kernel kernel =
      row_kernel("cross", {{"a", DType::F32, 3}, {"b", DType::F32, 3}}, 3,
                 [](TraceContext& c) { return math::cross(vector(c, 0), vector(c, 1)); });
  return kernel;
}
const Kernel& quat_mul_kernel() {
  static const Kernel kernel = row_kernel(
      "quat_mul", {{"a", DType::F32, 4}, {"b", DType::F32, 4}}, 4,
      [](TraceContext& c) { return math::multiply(quaternion(c, 0), quaternion(c, 1)); });
  return kernel;
}
const Kernel& quat_rotate_kernel() {
  static const Kernel kernel =
      row_kernel("quat_rotate", {{"q", DType::F32, 4}, {"v", DType::F32, 3}}, 3,
                 [](TraceContext& c) { return math::rotate(quaternion(c, 0), vector(c, 1)); });
  return kernel;
}
const Kernel& quat_exp_kernel() {
  static const Kernel kernel =
      row_kernel("quat_exp", {{"r", DType::F32, 3}}, 4,
                 [](TraceContext& c) { return exponential(vector(c, 0)); });
  return kernel;
}
const Kernel& quat_log_kernel() {
  static const Kernel kernel =
      row_kernel("quat_log", {{"q", DType::F32, 4}}, 3,
                 [](TraceContext& c) { return logarithm(quaternion(c, 0)); });
  return kernel;
}

// Launches a kernel on inputs whose leading dimensions are broadcast.
Tensor launch_rows(const Kernel& kernel, std::initializer_list<Tensor> inputs) {
  const char* call = kernel.name().c_str();
  const std::vector<SourceSpec>& sources = kernel.sources();
  const Tensor& first = *inputs.begin();
  Shape leading;
  for (size_t s = 0; s < inputs.size(); ++s) {
    const Tensor& x = inputs.begin()[s];
    const char* name = sources[s].name.c_str();
    detail::check_f32(x, {call, name});
    require(x.ndim() >= 1 && x.shape().back() == sources[s].width, ErrorKind::Value, call, ", ",
            name, ": expected a last dimension of ", sources[s].width, ", got shape ",
            shape_str(x.shape()));
    require(x.device() == first.device(), ErrorKind::Value, call, ": ", sources[0].name, " is on ",
            first.device().str(), ", ", name, " on ", x.device().str());
    leading = broadcast_shape(call, leading, Shape(x.shape().begin(), x.shape().end() - 1));
  }
  const auto rows_of = [&](const Tensor& x, int32_t width) {
    return Operand{x.range(), x.size() / width, width};
  };
  std::vector<Operand> in;
  for (size_t s = 0; s < inputs.size(); ++s) {
    Shape whole = leading;
    whole.push_back(sources[s].width);
    in.push_back(rows_of(broadcast_to(inputs.begin()[s], whole), sources[s].width));
  }
  const int32_t width = kernel.outputs()[0].width;
  Shape shape = leading;
  shape.push_back(width);
  const Tensor out(shape, DType::F32, first.device());
  const Operand to = rows_of(out, width);
  kernel.launch(to.rows, in, to);
  return out;
}

}  // namespace

void detail::add_vector_kernels(EngineKernels& list) {
  for (const Kernel& k : {cross_kernel(), quat_mul_kernel(), quat_rotate_kernel(),
                          quat_exp_kernel(), quat_log_kernel()})
    list.push_back({k, k.gradients()});
}

Tensor cross(const Tensor& a, const Tensor& b) { return launch_rows(cross_kernel(), {a, b}); }
Tensor quat_mul(const Tensor& a, const Tensor& b) { return launch_rows(quat_mul_kernel(), {a, b}); }
Tensor quat_rotate(const Tensor& q, const Tensor& v) {
  return launch_rows(quat_rotate_kernel(), {q, v});
}
Tensor quat_exp(const Tensor& r) { return launch_rows(quat_exp_kernel(), {r}); }
Tensor quat_log(const Tensor& q) { return launch_rows(quat_log_kernel(), {q}); }

}  // namespace nova
