// DiffSolverVBD: a step of VBD as one operation of a tape, with its derivatives.
// Compiled into novaphy::diff where both are built.
#pragma once

#include <memory>
#include <string>

#include "novaphy/core/sim/edited_values.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/vbd/differentiable_vbd.h"

namespace novaphy::diff {

struct RecordedStep;  // of diff_vbd.cpp

// `residual`: of implicit gradients, that of the step or of the linear system.
struct DiffVbdGradientInfo : GradientInfo {
  VbdResidual primal;          // how far the step of the last backward was from its solution
  double linear_residual = 0;  // implicit: of its linear system, relative; else 0
  int32_t linear_sweeps = 0;   // that it took
  bool converged = true;       // implicit: both are within the tolerance
};

struct DiffVbdOptions {
  int32_t iterations = 10;         // sweeps over all colors, >= 0
  float friction_epsilon = 1e-2f;  // m/s, > 0, see VbdOptions
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;
  bool coarse = false;  // see VbdOptions; with implicit gradients
  float lhs_regularization = 1e-6f;
  VbdGradientOptions gradient = {};
};

// SolverVBD's step, in all bits, recorded on an active tape; with implicit gradients the solution
// of the step. Backward and Tape::jvp run each step once more.
//
//   input                                                gradient
//   particle_q, particle_qd, particle_f, targets         exact; particle_q also of kinematic ones
//   gravity, particle_mass (through its inverse too), particle_radius                    exact
//   particle_spring_stiffness, _damping, _rest_length                                    exact
//   particle_tri_pose, _area, _material (ke, ka, kd), particle_tet_pose, _material       exact
//   particle_edge_material, _rest_angle, _rest_length                                    exact
//   activations of triangles and tetrahedra, of the control or the model                 exact
//   shape_margin, shape_material_ke, _kd, _mu            exact
//   contacts (those of the step are kept)                frozen: points, normals, which touch
//   all else of the model and the contacts               none: ErrorKind::NotImplemented, by name,
//                                                        where it has requires_grad
// particle_q and particle_qd of the model are read by states, not by steps. An element whose
// coefficients are all 0 is left out of a step, and has no gradient.
//
// The adaptive guess looks at the velocity before the last step, which the solver carries from step
// to step and from rollout to rollout until reset(). Unrolled gradients by it are exact, over the
// steps and rollouts of a tape; a solution does not depend on the guess, so implicit ones are 0.
// Trajectories with checkpoints keep it where they keep states. A replay of a capture begins where
// the last step ended, or with reset() where the capture does.
// "Exact" is of the iterations that ran, or with implicit gradients of the solution, within the
// residuals: see gradient_info(). Steps, rollouts, their backward and jvp can be captured; a
// replay runs them on the host, or on the device of the model, where materials and rest shapes of
// elements that carry a gradient may change from replay to replay (an element whose coefficients
// are all 0 keeps them, or gradient_info() throws). On a device no jvp and no
// implicit gradients stand in a capture (see DifferentiableVbd).
class NOVAPHY_VBD_API DiffSolverVBD : public DiffSolverBase {
 public:
  // Errors as DifferentiableVbd.
  explicit DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options = {});

  const DiffVbdOptions& options() const { return options_; }
  int32_t kinematic_count() const { return steps_->kinematic_count(); }
  // Of the last backward or jvp. ErrorKind::Runtime: there was none; or a replay of a captured step
  // or backward failed since the last call, and wrote NaN (the first, with the step of a rollout;
  // step and rollout say so, too); on a device as SolverVBD::residual, of direct steps too.
  // The labels are of the last steps on a tape, each of which started where the one before ended;
  // of a capture, of its last replay.
  DiffVbdGradientInfo gradient_info() const;
  void clear_gradient_info() { notes_.clear(); }

  // particle_f is only read. Errors as SolverVBD::step; ErrorKind::Runtime with implicit
  // gradients where the step was not solved.
  bool supports_graph_capture() const override { return true; }
  // Forgets the last step, which the adaptive guess looks at. Can be captured.
  void reset();
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    step(state_in, state_out, control, contacts, dt, nullptr);
  }
  // `targets`: as SolverVBD::step; with a gradient.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets);

 protected:
  int32_t target_count() const override { return kinematic_count(); }
  std::vector<ScratchSpec> step_scratch() const override;
  bool begin_rollout(const RolloutInputs& inputs) override;
  void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                   StepScratch scratch) override;

 private:
  void note_step(const RecordedStep& step, const SimState& in, const SimState& out, bool keeps);
  void check_replays() const;
  void begin();
  bool looks_back() const { return options_.initial_guess == VbdInitialGuess::Adaptive; }
  DeviceArray<Vec4f> new_velocities() const;
  nova::Tensor last_velocity(StepInputs::Checkpoints* checkpoints);
  void keep_velocity(const SimState& in, StepInputs::Checkpoints* checkpoints, StepScratch scratch);
  std::shared_ptr<const Contacts> kept(const Contacts* contacts);

  DiffVbdOptions options_;
  EditedValues values_{"DiffSolverVBD"};  // of captures; steps_ checks its own
  std::shared_ptr<DifferentiableVbd> steps_;
  std::shared_ptr<std::string> failure_ = std::make_shared<std::string>();  // of a replay
  std::shared_ptr<const Contacts> last_contacts_;  // a copy of those of the last step
  GradientNotes notes_;
  struct Witness;
  std::weak_ptr<Witness> witness_;
  // Of the adaptive guess: see VbdStepInputs::last_velocity; and the same as the last step on a
  // tape and in a capture wrote it.
  DeviceArray<Vec4f> last_velocity_;
  struct {
    const nova::OpList* capture = nullptr;
    nova::Tensor rows;
  } recorded_velocity_;
};

}  // namespace novaphy::diff
