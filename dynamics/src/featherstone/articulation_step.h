// Checks, and the arguments of a step, which the solvers of articulations share.
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

// Trees or groups that a thread of the CPU takes at a time.
inline constexpr uint32_t kTreeRows = 4;
// Runs a kernel of a step on the CPU, where nobody records, with arguments in memory. A thread
// takes `chunk` rows at a time.
template <class A>
void run_rows(const RowKernel<A>& kernel, int64_t n, const std::type_identity_t<A>& in_memory,
              int64_t chunk = kTreeRows) {
  for_chunks(n, chunk, [&](int64_t begin, int64_t end, int64_t) {
    kernel.rows(reinterpret_cast<const uint64_t*>(&in_memory), n, begin, end);
  });
}
// Likewise these rows only.
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

// A step without contacts and dry friction.
const Kernel<ArticulationStepArguments>& tree_step_kernel();

// ErrorKind::Value: a bad option; ErrorKind::NotImplemented: parts besides articulations.
void check_featherstone_model(const Model& model, const FeatherstoneOptions& options,
                              const char* user);
// Of shapes in contact.
UnsupportedMaterials unsupported_materials(ArticulationContact contact, const char* user);

// ErrorKind::Runtime, naming the first dof that failed; `state`: where the step began, if known.
void check_status(const Model& model, const Articulations& articulations,
                  std::span<const int32_t> status, const char* user,
                  const SimState* state = nullptr);

// Likewise, of a step from a state on the cpu. Where a dof of what failed moves so fast that this
// is why, it names that and the contact with the largest force (empty: none).
void check_exploded(const Model& model, const Articulations& articulations,
                    std::span<const int32_t> status, const SimState& from, float dt,
                    const std::string& largest_force, const char* user);

// ErrorKind::Index: a status that names a row of contacts, and what is wrong with its shapes
// (null: not known).
void check_contact_status(std::span<const int32_t> status, const char* user,
                          const Model* model = nullptr, const int32_t* shape0 = nullptr,
                          const int32_t* shape1 = nullptr);

// What the host has looked at, and no launch looks at: a replay throws once it was written.
void depend_on_values(const Model& model, const Control* control);
void depend_on_modes(const Model& model, const Control* control);  // of them, but for friction

// The poses and velocities of all bodies, from joint_q and joint_qd; on the cpu.
void place_bodies(const Articulations& articulations, const ArticulationArguments& in,
                  Transformf* body_q, SpatialVectorf* body_qd);

// Numbers of memory per articulation, for a step on a device; 0: the stack of a row holds it.
int64_t device_workspace(const Articulations& articulations);
// For a step and its adjoint; 0: the stack of the host holds
// it.
int64_t step_workspace(const Articulations& articulations);

// What a step reads besides the arrays of step_arrays.h.
struct StepTables {
  Given<int32_t> target_mode;
  Given<ArticulationRows> rows;
  Given<articulation::Link> links;
  Given<int32_t> dof_parent;
};
// argument(place) gives the arrays, in the order of their places.
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
          .implicit_drives = options.implicit_drives};
}
ArticulationArguments articulation_arguments(const Model& model, const Articulations& articulations,
                                             const SimState& in, const StepDrives& drives,
                                             const Array& body_f,
                                             const FeatherstoneOptions& options, float dt);

}  // namespace novaphy
