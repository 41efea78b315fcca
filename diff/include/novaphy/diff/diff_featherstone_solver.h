// DiffFeatherstoneSolver: the step of articulations, recorded on a tape.
#pragma once

#include <memory>

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/featherstone/diff_articulation_step.h"
#include "novaphy/dynamics/gradient_info.h"

namespace novaphy::diff {

// Steps with the bits of SolverFeatherstone; with contacts the impulses are those of
// more sweeps. Inside an active nova::Tape each is one operation with
// the exact adjoint; gradients and what they are: diff_articulation_step.h. rollout runs many, with
// the bits of a loop of step; with checkpoints backward runs the stretches between kept states once
// more.
class NOVAPHY_DIFF_API DiffFeatherstoneSolver : public DiffSolverBase {
 public:
  // Errors as SolverFeatherstone. `allow_unconverged`: gradients of steps whose sweeps ended far
  // from converged do not throw. `contact_gradient`: see ArticulationStep.
  explicit DiffFeatherstoneSolver(std::shared_ptr<const Model> model,
                                  const FeatherstoneOptions& options = {},
                                  bool allow_unconverged = false,
                                  DerivativeOf contact_gradient = DerivativeOf::Code);

  const FeatherstoneOptions& options() const { return options_; }
  // Of all steps since the last clear: what their gradients are, and their contacts and dry
  // friction.
  GradientInfo gradient_info() const {
    return novaphy::gradient_info(branches().all, false, step_.motion_counts());
  }
  ContactBranches branches() const { return step_.branches(); }
  void clear_gradient_info() { step_.clear_branches(); }

  // Errors as SolverFeatherstone::step; ErrorKind::Runtime inside a ScopedCapture.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // Errors as step, of the last step that failed.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;
  void notify_model_changed(ModelFlags flags) override;
  bool supports_graph_capture() const override {
    return false;
  }  // of step; rollout may be captured

 protected:
  std::vector<ScratchSpec> step_scratch() const override;
  bool begin_rollout(const RolloutInputs& inputs) override;
  void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                   StepScratch scratch) override;

 private:
  void check_contacts(const char* function, const Contacts* contacts, bool touching) const;
  bool poses_follow(const SimState& state);

  FeatherstoneOptions options_;
  bool allow_unconverged_;
  DerivativeOf contact_gradient_;
  ArticulationStep step_;
  std::shared_ptr<SimState> poses_;  // memory of poses_follow
  int32_t rollout_contacts_ = 0;     // at most, in a step of the rollout that has begun
};

}  // namespace novaphy::diff
