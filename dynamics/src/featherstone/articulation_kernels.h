// A step of articulations, and its adjoints, one row per articulation: articulation/step.h and
// step_vjp.h over the arrays of models and states.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/core/row_scratch.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"

namespace novaphy {

// Small trees work on the stack, the others in memory of their own; so do adjoints on devices.
struct LocalWorkspace {
  alignas(16) unsigned char bytes[kRowStack];
};
inline unsigned char* workspace_of(float* workspace, int64_t stride, int64_t row,
                                   LocalWorkspace& local) {
  return stride > 0 ? reinterpret_cast<unsigned char*>(workspace + row * stride) : local.bytes;
}

// Nobody waits for a launch, so one that fails writes NaN.
NOVAPHY_ROW_KERNEL(articulation_step, 39, ArticulationStepArguments) {
  const ArticulationRows& rows = a.in.rows[row];
  const articulation::Tree<float> tree = articulation_tree(a.in, rows);
  const articulation::StepInputs<float> in = articulation_inputs(a.in);
  const articulation::StepOptions<float> options = articulation_options(a.in);
  LocalWorkspace local;
  articulation::Workspace<float> ws = articulation::make_workspace<float>(
      workspace_of(a.workspace, a.stride, row, local), rows.link_count, rows.dof_count);
  const int32_t failed = articulation::forward_step(tree, in, options, ws);
  a.status[row] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
  if (failed >= 0) return write_failure(a, rows);
  write_step(a, rows, tree, in, options, ws);
}

NOVAPHY_ROW_KERNEL(articulation_step_vjp, 61, ArticulationStepVjpArguments) {
  const ArticulationRows& rows = a.in.rows[row];
  NOVAPHY_ROW_SCRATCH(LocalWorkspace, local,
                      reinterpret_cast<LocalWorkspace*>(a.workspace + row * a.stride));
  unsigned char* const memory = workspace_of(a.workspace, a.stride, row, local);
  articulation::Workspace<float> ws =
      articulation::make_workspace<float>(memory, rows.link_count, rows.dof_count);
  articulation::AdjointMemory<float> adjoint = articulation::make_adjoint_memory<float>(
      memory + articulation::workspace_bytes<float>(rows.link_count, rows.dof_count),
      rows.link_count, rows.dof_count);
  articulation::step_vjp(articulation_tree(a.in, rows), articulation_inputs(a.in),
                         articulation_options(a.in), a.qdd, a.branch, a.q_next, a.qd_next, a.out,
                         a.gradient, ws, adjoint);
}

// The gradient of gravity {worlds} from that of body_f: a force at each centre of mass, with its
// mass. One row, so that the sums have one order.
struct GravityGradientArguments {
  const ArticulationRows* rows;
  const articulation::Link* links;
  const float* mass;
  const SpatialVectorf* wrenches;  // the gradient of body_f, which goes on to body_f (null: nobody)
  Vec3f* gravity;
  SpatialVectorf* body_f;
  int64_t count, bodies, worlds, add_gravity, add_body_f;
};
NOVAPHY_ROW_KERNEL(gravity_gradient, 11, GravityGradientArguments) {
  for (int64_t w = 0; w < a.worlds && a.add_gravity == 0; ++w) a.gravity[w] = Vec3f{};
  for (int64_t i = 0; i < a.count; ++i) {
    Vec3f sum{};
    for (int32_t k = 0; k < a.rows[i].link_count; ++k) {
      const int32_t body = a.links[a.rows[i].first_link + k].body;
      if (body >= 0) sum = sum + a.wrenches[body].linear * a.mass[body];
    }
    a.gravity[a.rows[i].world] = a.gravity[a.rows[i].world] + sum;
  }
  for (int64_t b = 0; b < a.bodies && a.body_f != nullptr; ++b)
    a.body_f[b] = a.add_body_f != 0 ? a.body_f[b] + a.wrenches[b] : a.wrenches[b];
}

}  // namespace novaphy
