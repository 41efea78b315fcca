#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/triangle_trace.h"
#include "novaphy/nova/functions.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const nova::Kernel& detail::triangle_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = element_sources(3);
    sources.push_back({"pose", DType::F32, 4, Access::Direct});
    sources.push_back({"activation", DType::F32, 1, Access::Direct});
    sources.push_back({"material", DType::F32, 5, Access::Direct});
    return element_kernel("triangle_forces", sources, 3, [](TraceContext& c) {
      Vec3<Real> x[3], v[3];
      load_corners(c, x, v);
      Mat22<Real> pose;
      for (int32_t i = 0; i < 2; ++i)
        for (int32_t j = 0; j < 2; ++j) pose.m[i][j] = c.f32(c.source("pose"), 2 * i + j);
      const size_t m = c.source("material");
      const TriangleForces<Real> f =
          triangle_forces<Real>(x, v, pose, c.f32(c.source("activation")),
                                {c.f32(m, 0), c.f32(m, 1), c.f32(m, 2), c.f32(m, 3), c.f32(m, 4)});
      return contributions({f.f0, f.f1, f.f2});
    });
  }();
  return kernel;
}

Tensor eval_triangle_forces_generated(const Model& model, const Tensor& particle_q,
                                      const Tensor& particle_qd, const Tensor& particle_f,
                                      const Tensor& tri_activations, const Tensor& tri_materials) {
  const char* op = "eval_triangle_forces_generated";
  detail::check_element_tensor(model, tri_activations, model.tri_count(), 1, op, "tri_activations");
  detail::check_element_tensor(model, tri_materials, model.tri_count(), 5, op, "tri_materials");
  return detail::eval_elements(model, op, detail::triangle_kernel(), model.particle_tri_indices,
                               particle_q, particle_qd, particle_f,
                               {nova::operand_of(model.particle_tri_pose),
                                tri_activations.flat_operand(), tri_materials.operand()});
}

}  // namespace novaphy::diff
