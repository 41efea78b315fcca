#include "novaphy/dynamics/semi_implicit/bending_trace.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/nova/functions.h"

namespace novaphy::diff {

using nova::Bool;
using nova::Int;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const detail::OperatorSpec& detail::bending_operator() {
  static const OperatorSpec spec = with_kernel(
      {"bending_forces",
       "eval_bending_forces_generated",
       array_of<&Model::particle_edge_indices>,
       4,
       {{"material", 2, array_of<&Model::particle_edge_material>, "edge_materials"},
        {"rest_angle", 1, array_of<&Model::particle_edge_rest_angle>, "edge_rest_angle"}},
       [](TraceContext& c) {
         Vec3<Real> x[4], v[4];
         load_corners(c, x, v);
         const Bool complete = both(both(c.i32(0, 0) >= Int(0), c.i32(0, 1) >= Int(0)),
                                    both(c.i32(0, 2) >= Int(0), c.i32(0, 3) >= Int(0)));
         const size_t m = c.source("material");
         const BendingForces<Real> f = bending_forces<Bool, Real>(
             complete, x, v, c.f32(m, 0), c.f32(m, 1), c.f32(c.source("rest_angle")));
         return contributions({f.f1, f.f2, f.f3, f.f4});
       }});
  return spec;
}

Tensor eval_bending_forces_generated(const Model& model, const Tensor& particle_q,
                                     const Tensor& particle_qd, const Tensor& particle_f,
                                     const Tensor& edge_materials, const Tensor& edge_rest_angle) {
  return detail::eval_elements(model, detail::bending_operator(), particle_q, particle_qd,
                               particle_f, {edge_materials, edge_rest_angle});
}

}  // namespace novaphy::diff
