// DiffSolverBase: the base of solvers whose steps are kernels of the tensor runtime, recorded or
// not. A solver gives one step; the rollout is here. Compiled into novaphy::dynamics where nova is
// built.
#pragma once

#include <map>
#include <memory>
#include <vector>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// What acts in a recorded step, besides the model.
struct StepInputs {
  const Control* control = nullptr;    // null: the model's defaults
  const Contacts* contacts = nullptr;  // null: none
  // Of contacts that the rollout has found for this step; null: the contacts are those of all
  // steps.
  ContactTables* tables = nullptr;
  nova::Operand forces;       // {n, 3}: on the particles; only read
  nova::Operand body_forces;  // {b, 6}: on the bodies; only read
  // {k, 3}, the rows of this step from `first_target` on: where held particles go; without a range:
  // they stay.
  nova::Operand targets;
  size_t first_target = 0;
  float dt = 0.0f;
  int32_t step = -1;  // of a rollout: from its state `step` to the next

  // Of a rollout over a trajectory that does not keep all states.
  struct Checkpoints {
    int32_t step = 0;               // from state `step` to the next
    bool next_is_kept = false;      // the state after it
    bool is_recomputed = false;     // by Trajectory::recompute, after the rollout
    std::map<int32_t, Array> kept;  // what a solver carries besides the state, at kept states
  };
  std::shared_ptr<Checkpoints> checkpoints;  // null: all are kept, or no rollout
};

class NOVAPHY_DYNAMICS_API DiffSolverBase : public SolverBase {
 public:
  using SolverBase::SolverBase;

  // One record_step for each step, recorded on an active tape; between two kept states the steps
  // are run once more by backward. The forces of the options have gradients, and so have the
  // controls as far as the solver says. May be captured. With a pipeline every kept step remembers
  // contacts of its own.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;

 protected:
  // The arrays that a step writes besides its state and that its gradient may read.
  virtual std::vector<ScratchSpec> step_scratch() const { return {}; }
  // Whether a step writes memory that the solver keeps from call to call. Then graphs and backward,
  // which run steps later, are refused while another call uses the solver.
  virtual bool step_writes_kept_memory() const { return true; }
  // Whether record_step only submits launches. A rollout of many particles then collects the
  // launches of several steps; nothing may read memory on the host before it called
  // nova::flush_deferred().
  virtual bool only_submits() const { return false; }
  // Checks, and what the steps of a rollout have in common. False: no step does anything.
  virtual bool begin_rollout(const RolloutInputs& inputs) = 0;
  // Submits the launches of one step from `in` to `out`, the carried arrays of which it writes in
  // full. It reads the forces of the inputs instead of those in `in`. Custom operations need their
  // `forward`, or trajectories with checkpoints are refused.
  virtual void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                           StepScratch scratch) = 0;
};

// Makes leaves of positions and velocities where the state's requires_grad is set. Its views
// (diff/tensor_views.h) do so, and the solvers with the state that a recorded step or rollout
// starts from. Forces are leaves on request only (state_particle_f_tensor(state, true)), because a
// leaf costs.
NOVAPHY_DYNAMICS_API void make_leaves(const SimState& state);

namespace detail {
// {n, 3} or {n, 6}: `applied` plus those of `forces` that begin at a row of it: into `sum`. On a
// tape, exact gradients for both.
void add_forces(nova::Operand applied, nova::Operand forces, size_t first_row, nova::Operand sum);
}  // namespace detail

}  // namespace novaphy::diff
