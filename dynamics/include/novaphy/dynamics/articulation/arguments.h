// The arguments of the kernels that step articulations (core/row_kernel.h), over the arrays of
// models and states. A kernel row is an articulation.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/step.h"

namespace novaphy {

// Arguments without a gradient in the kernel: the tape operations that launch the kernels compute
// the gradients.
template <class T>
using Given = Detached<Reads<T>>;
template <class T>
using Changed = Detached<Updates<T>>;

template <class T>
struct GivenArrays {
  using Scalar = T;
  template <articulation::RowOf, class Value>
  using Array = Given<Value>;
};
// Field types for gradient outputs. Null: the gradient is not requested.
struct WantedArrays {
  using Scalar = float;
  template <articulation::RowOf, class Value>
  using Array = Optional<Changed<Value>>;
};

// The place of an articulation in the arrays: its first links and dofs, their numbers, and its
// world.
struct ArticulationRows {
  int32_t first_link, link_count, first_dof, dof_count, world;
  int32_t moves;   // 0: impulses move none of its dofs
  int32_t mimics;  // number of mimic links
  int32_t joints_in_a_row;
};

// The inputs of a step: arrays of a model, state and control. The links and dof_parent come from
// Articulations. With dual numbers as T, the arrays are copies of these arrays with tangents.
template <class T>
struct ArticulationArgumentsOf {
  NOVAPHY_ARGUMENTS(Part<articulation::GradientArrays<GivenArrays<T>>> arrays;
                    Part<articulation::FrameArrays<GivenArrays<T>>> frames;
                    Given<int32_t> target_mode; Given<ArticulationRows> rows;
                    Given<articulation::Link> links; Given<int32_t> dof_parent;
                    Number<float> dt, angular_damping, limit_restitution, restitution_threshold;
                    Number<int64_t> implicit_drives, limit_rows;)
};
using ArticulationArguments = ArticulationArgumentsOf<float>;

template <class T>
articulation::StepInputs<T> articulation_inputs(const ArticulationArgumentsOf<T>& a) {
  articulation::StepInputs<T> in;
  const auto point = [](auto& to, const auto& from) { to = from; };
  articulation::for_each_gradient_array(point, in, a.arrays);
  articulation::for_each_frame_array(point, in, a.frames);
  in.target_mode = a.target_mode;
  return in;
}
template <class T>
articulation::StepOptions<T> articulation_options(const ArticulationArgumentsOf<T>& a) {
  return {T(a.dt.value),           T(a.angular_damping.value),   a.implicit_drives.value != 0,
          a.limit_rows.value != 0, T(a.limit_restitution.value), T(a.restitution_threshold.value)};
}
template <class T>
articulation::Tree<T> articulation_tree(const ArticulationArgumentsOf<T>& a,
                                        const ArticulationRows& rows) {
  articulation::Tree<T> tree;
  tree.link_count = rows.link_count;
  tree.dof_count = rows.dof_count;
  tree.links = a.links + rows.first_link;
  tree.dof_parent = a.dof_parent + rows.first_dof;
  tree.first_dof = rows.first_dof;
  tree.mimics = rows.mimics;
  tree.joints_in_a_row = rows.joints_in_a_row;
  articulation::set_arrays(articulation_inputs(a), rows.world, tree);
  return tree;
}

// The arguments of a step. qdd, branch: per dof, for the adjoint. status: per articulation, 0, or 1
// + the dof that failed. stride: size of an articulation's workspace in floats; 0: on the stack.
struct ArticulationStepArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationArguments> in; Writes<float> q_next, qd_next;
                    Writes<Transformf> body_q; Writes<SpatialVectorf> body_qd;
                    Writes<float> qdd, branch; Writes<int32_t> status; Writes<float> workspace;
                    Number<int64_t> stride;)
};

// Writes NaN to the new state of an articulation and to its accelerations.
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

// Computes the new state of an articulation from its new rates.
template <class Arguments, class T>
void finish_step(const Arguments& a, const articulation::Tree<T>& tree,
                 const articulation::StepInputs<T>& in, const articulation::StepOptions<T>& options,
                 articulation::Workspace<T>& ws) {
  T *const q = a.q_next, *const qd = a.qd_next;
  Transform<T>* const body_q = a.body_q;
  SpatialVector<T>* const body_qd = a.body_qd;
  articulation::finish_step(tree, in, options, ws, q, qd, body_q, body_qd);
}
// Writes qdd and the branches of limits and clamps that the step took. The adjoint reads both.
inline void write_rates(const ArticulationStepArguments& a, const ArticulationRows& rows,
                        const articulation::Workspace<float>& ws) {
  for (int32_t k = 0; k < rows.dof_count; ++k) {
    a.qdd[rows.first_dof + k] = ws.qdd[k];
    a.branch[rows.first_dof + k] = static_cast<float>(ws.branch[k]);
  }
}
// Writes the new state, qdd and the branches.
inline void write_step(const ArticulationStepArguments& a, const ArticulationRows& rows,
                       const articulation::Tree<float>& tree,
                       const articulation::StepInputs<float>& in,
                       const articulation::StepOptions<float>& options,
                       articulation::Workspace<float>& ws) {
  write_rates(a, rows, ws);
  finish_step(a, tree, in, options, ws);
}

}  // namespace novaphy
