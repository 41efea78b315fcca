#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/spring_trace.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

const nova::Kernel& detail::spring_kernel() {
  static const nova::Kernel kernel = [] {
    std::vector<nova::SourceSpec> sources = element_sources(2);
    for (const char* name : {"stiffness", "damping", "rest_length"})
      sources.push_back({name, DType::F32, 1, Access::Direct});
    return element_kernel("spring_forces", sources, 2, [](TraceContext& c) {
      const SpringForces<Real> f = spring_forces(
          load_corner(c, "particle_q", 0), load_corner(c, "particle_q", 1),
          load_corner(c, "particle_qd", 0), load_corner(c, "particle_qd", 1),
          c.f32(c.source("stiffness")), c.f32(c.source("damping")), c.f32(c.source("rest_length")));
      return contributions({f.f0, f.f1});
    });
  }();
  return kernel;
}

Tensor eval_spring_forces_generated(const Model& model, const Tensor& particle_q,
                                    const Tensor& particle_qd, const Tensor& particle_f,
                                    const Tensor& spring_stiffness, const Tensor& spring_damping,
                                    const Tensor& spring_rest_length) {
  const char* op = "eval_spring_forces_generated";
  const auto check = [&](const Tensor& tensor, const char* name) {
    detail::check_element_tensor(model, tensor, model.spring_count(), 1, op, name);
  };
  check(spring_stiffness, "spring_stiffness");
  check(spring_damping, "spring_damping");
  check(spring_rest_length, "spring_rest_length");
  return detail::eval_elements(model, op, detail::spring_kernel(), model.particle_spring_indices,
                               particle_q, particle_qd, particle_f,
                               {spring_stiffness.flat_operand(), spring_damping.flat_operand(),
                                spring_rest_length.flat_operand()});
}

}  // namespace novaphy::diff
