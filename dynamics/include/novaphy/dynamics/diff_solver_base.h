// DiffSolverBase: the base class of solvers whose steps are kernels of the tensor runtime, with or
// without a tape. A derived class defines one step. The base class defines the rollout. Compiled
// into novaphy::dynamics if nova is built.
#pragma once

#include <map>
#include <memory>
#include <vector>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// The inputs of a recorded step besides the model.
struct StepInputs {
  const Control* control = nullptr;    // null: the model's defaults
  const Contacts* contacts = nullptr;  // null: none
  // Tables of the contacts that the rollout found for this step. Null: one set of contacts serves
  // all steps.
  ContactTables* tables = nullptr;
  nova::Operand forces;       // {n, 3}: forces on the particles; only read
  nova::Operand body_forces;  // {b, 6}: wrenches on the bodies; only read
  // Kinematic targets {k, 3}, from row `first_target` on. An operand without a range: kinematic
  // particles do not move.
  nova::Operand targets;
  size_t first_target = 0;
  float dt = 0.0f;
  int32_t step = -1;      // index in a rollout: the step goes from state `step` to the next
  bool is_first = false;  // first step of a rollout, from a state that the user may have written

  // For a rollout over a trajectory with checkpoints (some states are kept, others recomputed).
  struct Checkpoints {
    int32_t step = 0;               // the step goes from state `step` to the next
    bool next_is_kept = false;      // whether the state after the step is kept
    bool is_recomputed = false;     // whether Trajectory::recompute repeats the step
    std::map<int32_t, Array> kept;  // copies of SolverBase::carried() by kept state
  };
  std::shared_ptr<Checkpoints> checkpoints;  // null: all states are kept, or no rollout
};

class NOVAPHY_DYNAMICS_API DiffSolverBase : public SolverBase {
 public:
  using SolverBase::SolverBase;

  // Runs one record_step per step, and records the steps on an active tape. The backward pass
  // recomputes the steps between two kept states. The forces in `options` have gradients. Controls
  // have gradients as far as the derived solver supports this. A capture may record the rollout.
  // With a pipeline, every kept step stores its own contacts.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;

 protected:
  // Returns the arrays that a step writes besides its state, and that its gradient may read.
  virtual std::vector<ScratchSpec> step_scratch() const { return {}; }
  // Returns whether a step writes memory that the solver keeps between calls. If so, a graph or a
  // backward pass, which runs steps later, is refused while another call uses the solver.
  virtual bool step_writes_kept_memory() const { return true; }
  // Returns whether record_step only submits launches, without a read on the host. A rollout of
  // many particles then merges the launches of several steps. Reads on the host need a call of
  // nova::flush_deferred() first.
  virtual bool only_submits() const { return false; }
  // Checks and prepares a rollout. Returns false if no step has an effect.
  virtual bool begin_rollout(const RolloutInputs& inputs) = 0;
  // Submits the launches of one step from `in` to `out`. The step overwrites all arrays of `out`
  // except the applied forces. Forces come from `inputs`, not from `in`. A custom operation needs
  // a `forward` function, else trajectories with checkpoints are refused.
  virtual void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                           StepScratch scratch) = 0;
};

// Makes the state's positions and velocities leaves of the tape if requires_grad is set. Views of
// the state (diff/tensor_views.h) call this function, and solvers call it for the first state of a
// recorded step or rollout. Forces become leaves only on request, because a leaf costs memory and
// time: state_particle_f_tensor(state, true).
NOVAPHY_DYNAMICS_API void make_leaves(const SimState& state);

namespace detail {
// Computes sum = applied + rows of `forces` from first_row on, for shapes {n, 3} or {n, 6}. On a
// tape both terms have exact gradients.
void add_forces(nova::Operand applied, nova::Operand forces, size_t first_row, nova::Operand sum);
}  // namespace detail

}  // namespace novaphy::diff
