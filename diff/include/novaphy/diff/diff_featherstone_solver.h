// DiffFeatherstoneSolver: the step of articulations, recorded on a tape.
#pragma once

#include <memory>

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/featherstone/diff_articulation_step.h"
#include "novaphy/dynamics/gradient_info.h"

namespace novaphy::diff {

// The differentiable SolverFeatherstone. Without contacts the states have the same bits. With
// contacts the solve runs more sweeps than that of SolverFeatherstone. An active nova::Tape records
// each step as one operation with the exact adjoint. diff_articulation_step.h lists the gradients.
// rollout runs many steps, with the same bits as calls of step in a loop. With checkpoints,
// backward runs the steps between two kept states once more.
class NOVAPHY_DIFF_API DiffFeatherstoneSolver : public DiffSolverBase {
 public:
  // Errors are those of SolverFeatherstone. With `allow_unconverged`, gradients do not throw for
  // steps whose contact solve ended far from convergence. `contact_gradient`: see ArticulationStep.
  explicit DiffFeatherstoneSolver(std::shared_ptr<const Model> model,
                                  const FeatherstoneOptions& options = {},
                                  bool allow_unconverged = false,
                                  DerivativeOf contact_gradient = DerivativeOf::Auto);

  const FeatherstoneOptions& options() const { return options_; }
  // Describes the gradients of all steps since the last clear, with their contacts and dry
  // friction.
  GradientInfo gradient_info() const {
    return novaphy::gradient_info(branches().all, false, step_.motion_counts());
  }
  ContactBranches branches() const { return step_.branches(); }
  void clear_gradient_info() { step_.clear_branches(); }

  // Errors are those of SolverFeatherstone::step. ErrorKind::Runtime: a call inside a
  // ScopedCapture.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // Errors are those of step, for the last step that failed.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;
  void notify_model_changed(ModelFlags flags) override;
  bool supports_graph_capture() const override {
    return false;
  }  // step cannot be captured; rollout can

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
  int32_t rollout_contacts_ = 0;     // largest number of contacts in a step of the present rollout
};

}  // namespace novaphy::diff
