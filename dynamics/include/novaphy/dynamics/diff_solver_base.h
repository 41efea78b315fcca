// DiffSolverBase: the base class of solvers whose steps are kernels of the tensor runtime, recorded
// or not. A derived solver defines one step; this class has the rollout. Compiled into
// novaphy::dynamics if nova is built.
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
  // Tables of contacts that the rollout found for this step. Null: the same contacts hold for all
  // steps.
  ContactTables* tables = nullptr;
  nova::Operand forces;       // {n, 3}: forces on the particles; only read
  nova::Operand body_forces;  // {b, 6}: wrenches on the bodies; only read
  // Kinematic targets {k, 3}; the rows of this step begin at `first_target`. Without a range,
  // kinematic particles stay.
  nova::Operand targets;
  size_t first_target = 0;
  float dt = 0.0f;
  int32_t step = -1;  // step of a rollout: from its state `step` to the next

  // For a rollout over a trajectory with checkpoints.
  struct Checkpoints {
    int32_t step = 0;               // from state `step` to the next
    bool next_is_kept = false;      // whether the state after the step is kept
    bool is_recomputed = false;     // whether Trajectory::recompute runs the step again
    std::map<int32_t, Array> kept;  // carried memory of a solver at kept states
  };
  std::shared_ptr<Checkpoints> checkpoints;  // null: all states are kept, or no rollout
};

class NOVAPHY_DYNAMICS_API DiffSolverBase : public SolverBase {
 public:
  using SolverBase::SolverBase;

  // Runs one record_step per step, recorded on an active tape. The backward pass recomputes the
  // steps between two kept states. The forces of the options have gradients, and so have the
  // controls that the solver supports. A capture may record the rollout. With a pipeline every kept
  // step stores its own contacts.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;

 protected:
  // The arrays that a step writes besides its state and that its gradient may read.
  virtual std::vector<ScratchSpec> step_scratch() const { return {}; }
  // Returns whether a step writes memory that the solver keeps between calls. Graphs and backward
  // run steps later, and are then refused while another call uses the solver.
  virtual bool step_writes_kept_memory() const { return true; }
  // Returns whether record_step only submits launches. A rollout of many particles then collects
  // the launches of several steps, and host reads need a call of nova::flush_deferred() first.
  virtual bool only_submits() const { return false; }
  // Makes the checks and preparations of a rollout. Returns false if no step has an effect.
  virtual bool begin_rollout(const RolloutInputs& inputs) = 0;
  // Submits the launches of one step from `in` to `out`, whose carried arrays it overwrites
  // completely. The forces are those of `inputs`, not those in `in`. Custom operations need their
  // `forward`, else trajectories with checkpoints are refused.
  virtual void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                           StepScratch scratch) = 0;
};

// Makes positions and velocities leaves if the state's requires_grad is set. Views of the state
// (diff/tensor_views.h) call this function, and so do solvers for the state at the start of a
// recorded step or rollout. Forces become leaves on request only (state_particle_f_tensor(state,
// true)), because a leaf costs memory and time.
NOVAPHY_DYNAMICS_API void make_leaves(const SimState& state);

namespace detail {
// Computes sum = applied + rows of `forces` from first_row on, for {n, 3} or {n, 6}. On a tape both
// have exact gradients.
void add_forces(nova::Operand applied, nova::Operand forces, size_t first_row, nova::Operand sum);
}  // namespace detail

}  // namespace novaphy::diff
