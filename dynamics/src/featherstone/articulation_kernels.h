// A step of articulations, and its adjoints, one row per articulation: articulation/step.h and
// step_vjp.h over the arrays of models and states.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/core/row_scratch.h"
#include "novaphy/dynamics/articulation/step_vjp.h"

namespace novaphy {

// Where an articulation's rows are.
struct ArticulationRows {
  int32_t first_link, link_count, first_dof, dof_count, world;
};

// What a step reads. The arrays of a model, state and control; rows, links and dof_parent are those
// of Articulations.
struct ArticulationArguments {
  const ArticulationRows* rows;
  const articulation::Link* links;
  const int32_t* dof_parent;
  const Transformf *X_p, *X_c;
  const Vec3f* axis;
  const float* mass;
  const Vec3f* com;
  const Mat33f* inertia;
  const Vec3f* gravity;
  const int32_t* target_mode;
  const float *target_q, *target_qd, *target_ke, *target_kd, *damping, *armature, *limit_lower,
      *limit_upper, *limit_ke, *limit_kd, *effort_limit, *velocity_limit, *q, *qd, *joint_f;
  const SpatialVectorf* body_f;
  FloatWord dt, angular_damping;
  int64_t implicit_drives;
};
inline constexpr int kArticulationWords = 30;

inline articulation::Tree<float> articulation_tree(const ArticulationArguments& a,
                                                   const ArticulationRows& rows) {
  return {rows.link_count,
          rows.dof_count,
          a.links + rows.first_link,
          a.dof_parent + rows.first_dof,
          rows.first_dof,
          a.X_p,
          a.X_c,
          a.axis,
          a.mass,
          a.com,
          a.inertia,
          a.gravity[rows.world]};
}
inline articulation::StepInputs<float> articulation_inputs(const ArticulationArguments& a) {
  return {a.q,
          a.qd,
          a.joint_f,
          a.body_f,
          {a.target_mode, a.target_q, a.target_qd, a.target_ke, a.target_kd, a.damping, a.armature,
           a.limit_lower, a.limit_upper, a.limit_ke, a.limit_kd, a.effort_limit, a.velocity_limit}};
}
inline articulation::StepOptions<float> articulation_options(const ArticulationArguments& a) {
  return {a.dt.value, a.angular_damping.value, a.implicit_drives != 0};
}

// Small trees work on the stack, the others in memory of their own; so do adjoints on devices.
struct LocalWorkspace {
  alignas(16) unsigned char bytes[kRowStack];
};
inline unsigned char* workspace_of(float* workspace, int64_t stride, int64_t row,
                                   LocalWorkspace& local) {
  return stride > 0 ? reinterpret_cast<unsigned char*>(workspace + row * stride) : local.bytes;
}

struct ArticulationStepArguments {
  ArticulationArguments in;
  float *q_next, *qd_next;
  Transformf* body_q;
  SpatialVectorf* body_qd;
  float* qdd;       // a row per dof: what the adjoint needs of the step
  float* branch;    // likewise
  int32_t* status;  // a row per articulation: 0, or 1 + the dof that failed
  float* workspace;
  int64_t stride;  // numbers of it for an articulation; 0: they are on the stack
};

// NaN in the new state of an articulation, and in its accelerations.
inline void write_failure(const ArticulationStepArguments& a, const ArticulationRows& rows) {
  const float nan = math::bits_float(0x7fc00000);
  const Vec3f none = {nan, nan, nan};
  for (int32_t i = 0; i < rows.link_count; ++i) {
    const articulation::Link& link = a.in.links[rows.first_link + i];
    for (int32_t c = 0; c < link.dofs + (link.dofs > 1 ? 1 : 0); ++c)
      a.q_next[link.coord + c] = nan;
    for (int32_t k = link.dof; k < link.dof + link.dofs; ++k) {
      a.qd_next[k] = a.qdd[k] = nan;
      a.branch[k] = 0.0f;
    }
    if (link.body < 0) continue;
    a.body_q[link.body] = {none, {nan, nan, nan, nan}};
    a.body_qd[link.body] = {none, none};
  }
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
  for (int32_t k = 0; k < rows.dof_count; ++k) {
    a.qdd[rows.first_dof + k] = ws.qdd[k];
    a.branch[rows.first_dof + k] = static_cast<float>(ws.branch[k]);
  }
  articulation::finish_step(tree, in, options, ws, a.q_next, a.qd_next, a.body_q, a.body_qd);
}

struct ArticulationStepVjpArguments {
  ArticulationArguments in;
  const float* qdd;
  const float* branch;
  const float *q_next, *qd_next;
  articulation::StepOutputGradient<float> out;
  articulation::StepGradient<float> gradient;  // ends with `add`, in a word of its own
  float* workspace;
  int64_t stride;
};
NOVAPHY_ROW_KERNEL(articulation_step_vjp, 60, ArticulationStepVjpArguments) {
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
