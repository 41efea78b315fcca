// The checks and the arguments of a step that all solvers of articulations share.
#pragma once

#include <span>
#include <string>
#include <type_traits>

#include "../step_sources.h"
#include "actuators.h"
#include "articulation_kernels.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/unsupported_materials.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

// The number of trees or groups that a thread of the CPU handles at a time.
inline constexpr uint32_t kTreeRows = 4;
// Runs a kernel of a step on the CPU without a recording. Arguments are in host memory. A thread
// handles `chunk` rows at a time.
template <class A>
void run_rows(const RowKernel<A>& kernel, int64_t n, const std::type_identity_t<A>& in_memory,
              int64_t chunk = kTreeRows) {
  for_chunks(n, chunk, [&](int64_t begin, int64_t end, int64_t) {
    kernel.rows(reinterpret_cast<const uint64_t*>(&in_memory), n, begin, end);
  });
}
// Runs the kernel for the given rows only.
template <class A>
void run_some(const RowKernel<A>& kernel, int64_t n, const std::type_identity_t<A>& in_memory,
              std::span<const int32_t> rows) {
  for_chunks(static_cast<int64_t>(rows.size()), kTreeRows,
             [&](int64_t begin, int64_t end, int64_t) {
               for (int64_t k = begin; k < end; ++k) {
                 const int64_t row = rows[static_cast<size_t>(k)];
                 kernel.rows(reinterpret_cast<const uint64_t*>(&in_memory), n, row, row + 1);
               }
             });
}

// Returns the kernel of a step without contacts and dry friction.
const Kernel<ArticulationStepArguments>& tree_step_kernel();

// Checks the options and the model. ErrorKind::Value: a bad option. ErrorKind::NotImplemented: the
// model has particles.
void check_featherstone_model(const Model& model, const FeatherstoneOptions& options,
                              const char* user);
// Returns the check for materials of touching shapes that the contact model does not support.
UnsupportedMaterials unsupported_materials(ArticulationContact contact, const char* user);

// Throws ErrorKind::Runtime, with the first dof that failed, if a status is not 0. `state`: where
// the step began, if known.
void check_status(const Model& model, const Articulations& articulations,
                  std::span<const int32_t> status, const char* user,
                  const SimState* state = nullptr);

// The same check for a step from a state on the CPU. If a dof of the failed articulation moved too
// fast, the message says so and names the contact with the largest force (empty: none).
void check_exploded(const Model& model, const Articulations& articulations,
                    std::span<const int32_t> status, const SimState& from, float dt,
                    const std::string& largest_force, const char* user);

// Throws ErrorKind::Index if a status names a contact row. The message says what is wrong with its
// shapes (null: unknown).
void check_contact_status(std::span<const int32_t> status, const char* user,
                          const Model* model = nullptr, const int32_t* shape0 = nullptr,
                          const int32_t* shape1 = nullptr);

// Tells a capture which values the host has checked although no launch reads them. A replay throws
// if such a value was written since.
void depend_on_values(const Model& model, const Control* control);
// The same without joint_friction, which a launch reads.
void depend_on_modes(const Model& model, const Control* control);

// Computes the poses and velocities of all bodies from joint_q and joint_qd, on the CPU.
void place_bodies(const Articulations& articulations, const ArticulationArguments& in,
                  Transformf* body_q, SpatialVectorf* body_qd);

// Returns the size in floats of the workspace per articulation for a step on a device. 0: the stack
// suffices.
int64_t device_workspace(const Articulations& articulations);
// Returns the size in floats of the workspace per articulation for a step and its adjoint. 0: the
// stack of the host suffices.
int64_t step_workspace(const Articulations& articulations);

// The tables that a step reads besides the arrays of step_arrays.h.
struct StepTables {
  Given<int32_t> target_mode;
  Given<ArticulationRows> rows;
  Given<articulation::Link> links;
  Given<int32_t> dof_parent;
};
// Makes the arguments of a step. argument(place) returns the array at a place, in the order of
// step_arrays.h.
template <class T, class Argument>
ArticulationArgumentsOf<T> arguments_of(const Argument& argument, const StepTables& tables,
                                        const FeatherstoneOptions& options, float dt) {
  using A = GivenArrays<T>;
  constexpr std::make_index_sequence<kGradientArrays> gradients;
  constexpr std::make_index_sequence<kStepArrays - kGradientArrays> frames;
  return {.arrays = step_arguments<articulation::GradientArrays<A>, 0>(argument, gradients),
          .frames = step_arguments<articulation::FrameArrays<A>, kGradientArrays>(argument, frames),
          .target_mode = tables.target_mode,
          .rows = tables.rows,
          .links = tables.links,
          .dof_parent = tables.dof_parent,
          .dt = dt,
          .angular_damping = options.angular_damping,
          .limit_restitution = options.joint_limit_restitution,
          .restitution_threshold = options.restitution_threshold,
          .implicit_drives = options.implicit_drives,
          .limit_rows = options.joint_limits == JointLimits::Row};
}
ArticulationArguments articulation_arguments(const Model& model, const Articulations& articulations,
                                             const SimState& in, const StepDrives& drives,
                                             const Array& body_f,
                                             const FeatherstoneOptions& options, float dt);

}  // namespace novaphy
