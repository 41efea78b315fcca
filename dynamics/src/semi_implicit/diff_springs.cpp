#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/spring_trace.h"

namespace novaphy::diff {

using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const detail::OperatorSpec& detail::spring_operator() {
  static const OperatorSpec spec = with_kernel(
      {"spring_forces",
       "eval_spring_forces_generated",
       array_of<&Model::particle_spring_indices>,
       2,
       {{"stiffness", 1, array_of<&Model::particle_spring_stiffness>, "spring_stiffness"},
        {"damping", 1, array_of<&Model::particle_spring_damping>, "spring_damping"},
        {"rest_length", 1, array_of<&Model::particle_spring_rest_length>, "spring_rest_length"}},
       [](TraceContext& c) {
         const SpringForces<Real> f =
             spring_forces(load_corner(c, "particle_q", 0), load_corner(c, "particle_q", 1),
                           load_corner(c, "particle_qd", 0), load_corner(c, "particle_qd", 1),
                           c.f32(c.source("stiffness")), c.f32(c.source("damping")),
                           c.f32(c.source("rest_length")));
         return contributions({f.f0, f.f1});
       }});
  return spec;
}

Tensor eval_spring_forces_generated(const Model& model, const Tensor& particle_q,
                                    const Tensor& particle_qd, const Tensor& particle_f,
                                    const Tensor& spring_stiffness, const Tensor& spring_damping,
                                    const Tensor& spring_rest_length) {
  return detail::eval_elements(model, detail::spring_operator(), particle_q, particle_qd,
                               particle_f, {spring_stiffness, spring_damping, spring_rest_length});
}

}  // namespace novaphy::diff
