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

struct RecordedStep;  // defined in diff_vbd_step.h

// `residual` of the base is the larger of the relative residuals of the step and the linear system
// with implicit gradients.
struct DiffVbdGradientInfo : GradientInfo {
  VbdResidual primal;          // residual of the step of the last backward or jvp
  double linear_residual = 0;  // implicit: relative residual of the linear system; else 0
  int32_t linear_sweeps = 0;   // implicit: sweeps for the linear system
  bool converged = true;       // implicit: both are within the tolerance
  int32_t halvings = 0;        // see VbdGradientInfo
};

struct DiffVbdOptions {
  int32_t iterations = 10;         // sweeps over all colors, >= 0
  float friction_epsilon = 1e-2f;  // m/s, > 0, see VbdOptions
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;
  bool coarse = false;  // see VbdOptions
  float lhs_regularization = 1e-6f;
  VbdGradientOptions gradient = {};
};

// A step with the bits of SolverVBD, recorded on an active tape. With implicit gradients the step
// is iterated to its solution. Backward and Tape::jvp run each step once more.
//
//   input                                                gradient
//   particle_q, particle_qd, particle_f, targets         exact; particle_q also of kinematic ones
//   gravity, particle_mass (through its inverse too), particle_radius                    exact
//   particle_spring_stiffness, _damping, _rest_length                                    exact
//   particle_tri_pose, _area, _material (ke, ka, kd), particle_tet_pose, _material       exact
//   particle_edge_material, _rest_angle, _rest_length                                    exact
//   activations of triangles and tetrahedra, of the control or the model                 exact
//   shape_margin, shape_material_ke, _kd, _mu            exact
//   contacts (the tape keeps those of the step)          frozen: points, normals, which touch
//   all else of the model and the contacts               none: ErrorKind::NotImplemented, by name,
//                                                        where it has requires_grad
// States start from particle_q and particle_qd of the model. Steps do not read these two arrays. A
// step leaves out an element whose coefficients are all 0. Such an element has no gradient.
//
// "Exact" refers to the iterations that ran. With implicit gradients "exact" refers to the solution
// of the step, within the residuals of gradient_info().
//
// The adaptive guess reads the velocity before the last step. The solver carries this velocity from
// step to step and from rollout to rollout until reset(). Unrolled gradients with respect to the
// velocity are exact over the steps and rollouts of a tape. Implicit gradients are 0, because a
// solution does not depend on the guess. Trajectories with checkpoints keep the velocity with each
// kept state. A replay of a capture begins where the last step ended, or with reset() if the
// capture starts with reset().
//
// Steps, rollouts, their backward and jvp can be captured. A replay runs on the host, or on the
// device of the model. On a device, materials and rest shapes of elements that carry a gradient may
// change from replay to replay. An element whose coefficients are all 0 has to keep them, or
// gradient_info() throws. A capture on a device supports neither jvp nor implicit gradients (see
// DifferentiableVbd).
class NOVAPHY_VBD_API DiffSolverVBD : public DiffSolverBase {
 public:
  // Errors: as for DifferentiableVbd.
  explicit DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options = {});

  const DiffVbdOptions& options() const { return options_; }
  int32_t kinematic_count() const { return steps_->kinematic_count(); }
  // Returns how exact the last backward or jvp was. The labels describe the last consecutive steps
  // on a tape: each of them started where the one before ended. For a capture the labels describe
  // the last replay.
  // ErrorKind::Runtime: no backward or jvp ran yet. Or a replay of a captured step or backward
  // failed since the last call and wrote NaN: the message names the first failure and the step of a
  // rollout. step and rollout report such a failure too. On a device the errors of
  // SolverVBD::residual are reported, of direct steps too.
  DiffVbdGradientInfo gradient_info() const;
  void clear_gradient_info() { notes_.clear(); }

  // A step only reads particle_f. Errors: as for SolverVBD::step. ErrorKind::Runtime: a step with
  // implicit gradients was not solved.
  bool supports_graph_capture() const override { return true; }
  // Forgets the velocity that the adaptive guess reads. Can be captured.
  void reset();
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    step(state_in, state_out, control, contacts, dt, nullptr);
  }
  // `targets`: as for SolverVBD::step. The targets have a gradient.
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
  EditedValues values_{"DiffSolverVBD"};  // checks captures; steps_ has a check of its own
  std::shared_ptr<DifferentiableVbd> steps_;
  // the first failure of a replay
  std::shared_ptr<std::string> failure_ = std::make_shared<std::string>();
  std::shared_ptr<const Contacts> last_contacts_;  // a copy of the contacts of the last step
  GradientNotes notes_;
  struct Witness;
  std::weak_ptr<Witness> witness_;
  // For the adaptive guess: see VbdStepInputs::last_velocity. recorded_velocity_ has the same rows
  // as the last step on a tape and in a capture wrote them.
  DeviceArray<Vec4f> last_velocity_;
  struct {
    const nova::OpList* capture = nullptr;
    nova::Tensor rows;
  } recorded_velocity_;
};

}  // namespace novaphy::diff
