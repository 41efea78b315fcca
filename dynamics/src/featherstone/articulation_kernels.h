// Kernels for a step of articulations and its adjoint, with a row per articulation. The algorithms
// of articulation/step.h and step_vjp.h read the arrays of models and states. Actuators
// (articulation/actuation.h) and gravity compensation act in addition to the drives. Gravity
// compensation is the force -gravcomp mass gravity at each center of mass.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/core/row_scratch.h"
#include "novaphy/dynamics/articulation/actuation.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"

namespace novaphy {

// Stack memory for small trees. Other trees, and all adjoints on devices, use a workspace.
struct LocalWorkspace {
  alignas(16) unsigned char bytes[kRowStack];
};
template <class Arguments>
unsigned char* workspace_of(const Arguments& a, int64_t row, LocalWorkspace& local) {
  float* const own = a.workspace + row * a.stride.value;
  return a.stride.value > 0 ? reinterpret_cast<unsigned char*>(own) : local.bytes;
}

// The host does not wait for a launch, so a failed step writes NaN.
NOVAPHY_ROW_KERNEL(articulation_step, ArticulationStepArguments) {
  const ArticulationRows& rows = a.in.rows[row];
  const articulation::Tree<float> tree = articulation_tree(a.in, rows);
  const articulation::StepInputs<float> in = articulation_inputs(a.in);
  const articulation::StepOptions<float> options = articulation_options(a.in);
  LocalWorkspace local;
  articulation::Workspace<float> ws = articulation::make_workspace<float>(
      workspace_of(a, row, local), rows.link_count, rows.dof_count);
  const int32_t failed = articulation::forward_step(tree, in, options, ws);
  a.status[row] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
  if (failed >= 0) return write_failure(a, rows);
  write_step(a, rows, tree, in, options, ws);
}

NOVAPHY_ROW_KERNEL(articulation_step_vjp, ArticulationStepVjpArguments) {
  const ArticulationRows& rows = a.in.rows[row];
  NOVAPHY_ROW_SCRATCH(LocalWorkspace, local,
                      reinterpret_cast<LocalWorkspace*>(a.workspace + row * a.stride.value));
  unsigned char* const memory = workspace_of(a, row, local);
  articulation::Workspace<float> ws =
      articulation::make_workspace<float>(memory, rows.link_count, rows.dof_count);
  articulation::AdjointMemory<float> adjoint = articulation::make_adjoint_memory<float>(
      memory + articulation::workspace_bytes<float>(rows.link_count, rows.dof_count),
      rows.link_count, rows.dof_count);
  const articulation::Tree<float> tree = articulation_tree(a.in, rows);
  const articulation::StepInputs<float> in = articulation_inputs(a.in);
  const articulation::StepOptions<float> options = articulation_options(a.in);
  step_vjp_rates(a, tree, in, options, ws, adjoint);
  articulation::step_vjp_dynamics(tree, in, options, ws);
  articulation::step_vjp_solve(tree, options, ws, adjoint);
  articulation::step_vjp_inputs(tree, in, options, step_gradient(a), ws, adjoint);
}

// Computes the gradient by gravity {worlds} from the gradient by body_f, because gravity is a force
// mass * gravity at each center of mass. One kernel row keeps the order of the sums fixed.
// wrenches: the gradient by body_f, which is also added to body_f.
struct GravityGradientArguments {
  NOVAPHY_ARGUMENTS(Given<ArticulationRows> rows; Given<articulation::Link> links;
                    Given<float> mass; Given<SpatialVectorf> wrenches; Changed<Vec3f> gravity;
                    Optional<Changed<SpatialVectorf>> body_f;
                    Number<int64_t> count, bodies, worlds, add_gravity, add_body_f;)
};
NOVAPHY_ROW_KERNEL(gravity_gradient, GravityGradientArguments) {
  for (int64_t w = 0; w < a.worlds && a.add_gravity.value == 0; ++w) a.gravity[w] = Vec3f{};
  for (int64_t i = 0; i < a.count; ++i) {
    Vec3f sum{};
    for (int32_t k = 0; k < a.rows[i].link_count; ++k) {
      const int32_t body = a.links[a.rows[i].first_link + k].body;
      if (body >= 0) sum = sum + a.wrenches[body].linear * a.mass[body];
    }
    a.gravity[a.rows[i].world] = a.gravity[a.rows[i].world] + sum;
  }
  for (int64_t b = 0; b < a.bodies && a.body_f != nullptr; ++b)
    a.body_f[b] = a.add_body_f.value != 0 ? a.body_f[b] + a.wrenches[b] : a.wrenches[b];
}

// Arguments of actuators on dofs, with a kernel row per degree of freedom.
struct ActuationArguments {
  NOVAPHY_ARGUMENTS(Part<articulation::Actuation> in;
                    Each<Optional<Changed<float>>, articulation::kActuationOutputs> out;)
};
NOVAPHY_ROW_KERNEL(actuation, ActuationArguments) {
  articulation::actuate(
      a.in, static_cast<int32_t>(row),
      [&](int32_t input, int32_t of, int32_t k) {
        return articulation::DualFloat(
            a.in.in[input][of * articulation::numbers_of_input(input) + k]);
      },
      [&](int32_t output, int32_t of, const articulation::DualFloat& v) {
        a.out[output][of] = v.value;
      });
}

// Arguments of the tangent. Null tangents are zero. Null outputs are not requested.
struct ActuationJvpArguments {
  NOVAPHY_ARGUMENTS(Part<articulation::Actuation> in;
                    Each<Given<float>, articulation::kActuationInputs> tangent;
                    Each<Changed<float>, articulation::kActuationOutputs> out;)
};
NOVAPHY_ROW_KERNEL(actuation_jvp, ActuationJvpArguments) {
  articulation::actuate(
      a.in, static_cast<int32_t>(row),
      [&](int32_t input, int32_t of, int32_t k) {
        const int32_t at = of * articulation::numbers_of_input(input) + k;
        const float* const t = a.tangent[input];
        return articulation::DualFloat(a.in.in[input][at], t != nullptr ? t[at] : 0.0f);
      },
      [&](int32_t output, int32_t of, const articulation::DualFloat& v) {
        if (a.out[output] != nullptr) a.out[output][of] = v.tangent;
      });
}

// Arguments of the adjoint, which adds to the gradients by the inputs, one number at a time. Null
// outputs have a zero gradient. Null gradients are not requested.
struct ActuationVjpArguments {
  NOVAPHY_ARGUMENTS(Part<articulation::Actuation> in;
                    Each<Given<float>, articulation::kActuationOutputs> out;
                    Each<Changed<float>, articulation::kActuationInputs> gradient;)
};
NOVAPHY_ROW_KERNEL(actuation_vjp, ActuationVjpArguments) {
  const auto dof = static_cast<int32_t>(row);
  const auto add = [&](int32_t input, int32_t of) {
    if (a.gradient[input] == nullptr || of < 0) return;
    const int32_t numbers = articulation::numbers_of_input(input);
    for (int32_t seed = 0; seed < numbers; ++seed) {
      float sum = 0.0f;
      articulation::actuate(
          a.in, dof,
          [&](int32_t i, int32_t r, int32_t k) {
            return articulation::DualFloat(a.in.in[i][r * articulation::numbers_of_input(i) + k],
                                           i == input && r == of && k == seed ? 1.0f : 0.0f);
          },
          [&](int32_t output, int32_t r, const articulation::DualFloat& v) {
            if (a.out[output] != nullptr) sum += a.out[output][r] * v.tangent;
          });
      a.gradient[input][of * numbers + seed] += sum;
    }
  };
  for (int32_t input = 0; input < articulation::kActuated; ++input)
    add(input, input == articulation::kTarget ? a.in.coord[dof] : dof);
  const int32_t coord = a.in.coord[dof];
  for (int32_t c = -2 - coord; coord < -1 && c < 2 - coord; ++c) add(articulation::kTarget, c);
  for (int32_t i = a.in.first[dof]; i < a.in.first[dof + 1]; ++i) {
    const int32_t k = a.in.order[i];
    for (int32_t input = articulation::kActuated; input < articulation::kActuationInputs; ++input)
      add(input, input == articulation::kActivation ? a.in.state[k] : k);
  }
}

// Gravity compensation: body_f plus its force, with a kernel row per body. World -1 stands for the
// last world.
struct GravcompInputs {
  NOVAPHY_ARGUMENTS(Given<int32_t> world; Given<float> gravcomp, mass; Given<Vec3f> gravity;
                    Given<SpatialVectorf> body_f; Number<int64_t> worlds;)
};
inline int64_t world_of(const GravcompInputs& a, int64_t body) {
  return a.world[body] < 0 ? a.worlds - 1 : a.world[body];
}
struct GravcompArguments {
  NOVAPHY_ARGUMENTS(Part<GravcompInputs> in; Changed<SpatialVectorf> out;)
};
NOVAPHY_ROW_KERNEL(gravity_compensation, GravcompArguments) {
  SpatialVectorf f = a.in.body_f[row];
  f.linear = f.linear - a.in.gravity[world_of(a.in, row)] * (a.in.gravcomp[row] * a.in.mass[row]);
  a.out[row] = f;
}

// The tangents of the inputs. Null: zeros.
struct GravcompTangents {
  NOVAPHY_ARGUMENTS(Part<GravcompInputs> in; Changed<SpatialVectorf> out;
                    Given<float> gravcomp, mass; Given<Vec3f> gravity;
                    Given<SpatialVectorf> body_f;)
};
NOVAPHY_ROW_KERNEL(gravity_compensation_jvp, GravcompTangents) {
  const int64_t world = world_of(a.in, row);
  const float part = a.in.gravcomp[row], mass = a.in.mass[row];
  float by_number = 0.0f;
  if (a.gravcomp != nullptr) by_number += a.gravcomp[row] * mass;
  if (a.mass != nullptr) by_number += part * a.mass[row];
  SpatialVectorf f{};
  if (a.body_f != nullptr) f = a.body_f[row];
  f.linear = f.linear - a.in.gravity[world] * by_number;
  if (a.gravity != nullptr) f.linear = f.linear - a.gravity[world] * (part * mass);
  a.out[row] = f;
}

// The adjoint of gravity compensation, which adds to the gradients by the inputs. Null: not
// requested. out: the gradient by the result. One kernel row keeps the order of the sums fixed.
struct GravcompGradients {
  NOVAPHY_ARGUMENTS(Part<GravcompInputs> in; Given<SpatialVectorf> out;
                    Changed<float> gravcomp, mass; Changed<Vec3f> gravity;
                    Changed<SpatialVectorf> body_f; Number<int64_t> bodies;)
};
NOVAPHY_ROW_KERNEL(gravity_compensation_vjp, GravcompGradients) {
  for (int64_t b = 0; b < a.bodies; ++b) {
    const int64_t world = world_of(a.in, b);
    const SpatialVectorf& g = a.out[b];
    const float weight = -math::dot(g.linear, a.in.gravity[world]);
    if (a.gravcomp != nullptr) a.gravcomp[b] += weight * a.in.mass[b];
    if (a.mass != nullptr) a.mass[b] += weight * a.in.gravcomp[b];
    if (a.gravity != nullptr)
      a.gravity[world] = a.gravity[world] - g.linear * (a.in.gravcomp[b] * a.in.mass[b]);
    if (a.body_f != nullptr) a.body_f[b] = a.body_f[b] + g;
  }
}

}  // namespace novaphy
