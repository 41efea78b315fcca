// Kernels of the tangent of a step of articulations without contacts and dry friction, for devices.
// The code of the step runs with dual numbers (articulation/dual.h), in copies of the arrays.
//
//   dual_pack              combines values and tangents to dual numbers
//   articulation_step_jvp  the step, a row per articulation
//   dual_tangent           extracts the tangents of dual numbers
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/jvp_arguments.h"

namespace novaphy {

// Arguments of dual_pack. tangents: null for zeros.
struct DualPackArguments {
  NOVAPHY_ARGUMENTS(Given<float> values, tangents; Changed<DualFloat> to;)
};
NOVAPHY_ROW_KERNEL(dual_pack, DualPackArguments) {
  a.to[row] = DualFloat(a.values[row], a.tangents != nullptr ? a.tangents[row] : 0.0f);
}

struct DualTangentArguments {
  NOVAPHY_ARGUMENTS(Given<DualFloat> from; Changed<float> to;)
};
NOVAPHY_ROW_KERNEL(dual_tangent, DualTangentArguments) { a.to[row] = a.from[row].tangent; }

NOVAPHY_ROW_KERNEL(articulation_step_jvp, ArticulationJvpArguments) {
  const ArticulationRows& rows = a.in.rows[row];
  const articulation::Tree<DualFloat> tree = articulation_tree(a.in, rows);
  const articulation::StepInputs<DualFloat> in = articulation_inputs(a.in);
  const articulation::StepOptions<DualFloat> options = articulation_options(a.in);
  articulation::Workspace<DualFloat> ws = articulation::make_workspace<DualFloat>(
      a.workspace + row * a.stride.value, rows.link_count, rows.dof_count);
  if (articulation::accelerate_again(tree, in, options, a.branch, ws) >= 0) return;
  articulation::free_rates(tree, in, options, ws);
  finish_step(a, tree, in, options, ws);
}

}  // namespace novaphy
