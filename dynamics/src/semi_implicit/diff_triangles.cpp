#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/triangle_trace.h"
#include "novaphy/nova/functions.h"

namespace novaphy::diff {

using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const detail::OperatorSpec& detail::triangle_operator() {
  static const OperatorSpec spec =
      with_kernel({"triangle_forces",
                   "eval_triangle_forces_generated",
                   array_of<&Model::particle_tri_indices>,
                   3,
                   {{"pose", 4, array_of<&Model::particle_tri_pose>, nullptr},
                    {"activation", 1,
                     array_of<&Model::particle_tri_activation, &Control::particle_tri_activation>,
                     "tri_activations"},
                    {"material", 5, array_of<&Model::particle_tri_material>, "tri_materials"}},
                   [](TraceContext& c) {
                     Vec3<Real> x[3], v[3];
                     load_corners(c, x, v);
                     Mat22<Real> pose;
                     for (int32_t i = 0; i < 2; ++i)
                       for (int32_t j = 0; j < 2; ++j)
                         pose.m[i][j] = c.f32(c.source("pose"), 2 * i + j);
                     const size_t m = c.source("material");
                     const TriangleForces<Real> f = triangle_forces<Real>(
                         x, v, pose, c.f32(c.source("activation")),
                         {c.f32(m, 0), c.f32(m, 1), c.f32(m, 2), c.f32(m, 3), c.f32(m, 4)});
                     return contributions({f.f0, f.f1, f.f2});
                   }});
  return spec;
}

Tensor eval_triangle_forces_generated(const Model& model, const Tensor& particle_q,
                                      const Tensor& particle_qd, const Tensor& particle_f,
                                      const Tensor& tri_activations, const Tensor& tri_materials) {
  return detail::eval_elements(model, detail::triangle_operator(), particle_q, particle_qd,
                               particle_f, {tri_activations, tri_materials});
}

}  // namespace novaphy::diff
