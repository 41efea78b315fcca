// The arguments of the kernels for the adjoint of a step of articulations. The file extends
// arguments.h.
#pragma once

#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/step_vjp.h"

namespace novaphy {

// q_next, qd_next, qdd and branch: results of the step. out_q to out_body_qd: gradients by results
// of the step; null: zero. add: StepGradient::add.
struct ArticulationStepVjpArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationArguments> in; Given<float> q_next, qd_next, qdd, branch;
                    Given<float> out_q, out_qd; Given<Transformf> out_body_q;
                    Given<SpatialVectorf> out_body_qd;
                    Part<articulation::GradientArrays<WantedArrays>> gradient; Number<int64_t> add;
                    Changed<float> workspace; Number<int64_t> stride;)
};

// Computes the gradients by the rates of a step (first part of the adjoint in step_vjp.h).
inline void step_vjp_rates(const ArticulationStepVjpArguments& a,
                           const articulation::Tree<float>& tree,
                           const articulation::StepInputs<float>& in,
                           const articulation::StepOptions<float>& options,
                           articulation::Workspace<float>& ws,
                           articulation::AdjointMemory<float>& memory) {
  const float *const qdd = a.qdd, *const branch = a.branch, *const q_next = a.q_next,
                     *const qd_next = a.qd_next;
  const articulation::StepOutputGradient<float> out = {a.out_q, a.out_qd, a.out_body_q,
                                                       a.out_body_qd};
  articulation::step_vjp_rates(tree, in, options, qdd, branch, q_next, qd_next, out, ws, memory);
}
inline articulation::StepGradient<float> step_gradient(const ArticulationStepVjpArguments& a) {
  articulation::StepGradient<float> to;
  articulation::for_each_gradient_array([](auto& g, const auto& from) { g = from; }, to,
                                        a.gradient);
  to.add = static_cast<int32_t>(a.add.value);
  return to;
}

}  // namespace novaphy
