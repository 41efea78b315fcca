#include "novaphy/dynamics/semi_implicit/bending_trace.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/nova/functions.h"

namespace novaphy::diff {

using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const nova::Kernel& detail::bending_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = element_sources(4);
    sources.push_back({"material", DType::F32, 2, Access::Direct});
    sources.push_back({"rest_angle", DType::F32, 1, Access::Direct});
    return element_kernel("bending_forces", sources, 4, [](TraceContext& c) {
      Vec3<Real> x[4], v[4];
      load_corners(c, x, v);
      const Bool complete = both(both(c.i32(0, 0) >= Int(0), c.i32(0, 1) >= Int(0)),
                                 both(c.i32(0, 2) >= Int(0), c.i32(0, 3) >= Int(0)));
      const size_t m = c.source("material");
      const BendingForces<Real> f = bending_forces<Bool, Real>(
          complete, x, v, c.f32(m, 0), c.f32(m, 1), c.f32(c.source("rest_angle")));
      return contributions({f.f1, f.f2, f.f3, f.f4});
    });
  }();
  return kernel;
}

Tensor eval_bending_forces_generated(const Model& model, const Tensor& particle_q,
                                     const Tensor& particle_qd, const Tensor& particle_f,
                                     const Tensor& edge_materials, const Tensor& edge_rest_angle) {
  const char* op = "eval_bending_forces_generated";
  detail::check_element_tensor(model, edge_materials, model.edge_count(), 2, op, "edge_materials");
  detail::check_element_tensor(model, edge_rest_angle, model.edge_count(), 1, op,
                               "edge_rest_angle");
  return detail::eval_elements(model, op, detail::bending_kernel(), model.particle_edge_indices,
                               particle_q, particle_qd, particle_f,
                               {edge_materials.operand(), edge_rest_angle.flat_operand()});
}

}  // namespace novaphy::diff
