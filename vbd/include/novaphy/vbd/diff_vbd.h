// DiffSolverVBD: a step of VBD as one operation of a tape, with its derivatives. If the build has
// the library novaphy::diff, this code is a part of that library.
#pragma once

#include <memory>
#include <string>

#include "novaphy/core/sim/edited_values.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/vbd/differentiable_bodies.h"
#include "novaphy/vbd/differentiable_vbd.h"

namespace novaphy::diff {

struct RecordedStep;    // defined in diff_vbd_step.h
struct RecordedBodies;  // defined in diff_vbd_bodies.h

// How exact the last gradient was. With implicit gradients `residual` of the base is the larger of
// two relative residuals: that of the step and that of the linear system.
struct DiffVbdGradientInfo : GradientInfo {
  VbdResidual primal;          // residual of the step that the last backward or jvp ran
  double linear_residual = 0;  // implicit: relative residual of the linear system; else 0
  int32_t linear_sweeps = 0;   // implicit: sweeps for the linear system
  bool converged = true;       // implicit: both residuals are within the tolerance
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

struct StepReport;
class UnsolvedSteps;

// Runs a step with the same bits as SolverVBD and records the step on an active tape. With implicit
// gradients the step is iterated to its solution. backward and Tape::jvp run each step once more.
//
//   input                                                gradient
//   particle_q, particle_qd, particle_f, targets         exact; particle_q also of kinematic
//                                                        particles
//   gravity, particle_mass and its inverse, particle_radius                              exact
//   particle_spring_stiffness, _damping, _rest_length                                    exact
//   particle_tri_pose, _area, _material (ke, ka, kd), particle_tet_pose, _material       exact
//   particle_edge_material, _rest_angle, _rest_length                                    exact
//   activations of triangles and tetrahedra, of the control or the model                 exact
//   shape_margin, shape_material_ke, _kd, _mu            exact
//   points, normals and set of the contacts              frozen; the tape keeps the contacts
//   other arrays of the model and the contacts           none: ErrorKind::NotImplemented names an
//                                                        array that has requires_grad
// particle_q and particle_qd are arrays of the state. A step does not read the arrays of the model
// with these names. A step skips an element whose coefficients are all 0. The gradient of this
// element is 0.
//
// A model with bodies and without particles has implicit gradients (DifferentiableBodies), on the
// CPU, outside of captures, and without checkpoints:
//   body_q, body_qd, body_f, gravity, body_mass and its inverse, body_inertia          exact
//   joint_f, joint_target_q, joint_target_qd, of the control or the model              exact
//   joint_target_ke, joint_target_kd, joint_damping, joint_armature, joint_friction    exact
//   shape_material_ke, _kd, _mu                          exact
//   points and normals of contacts                       frozen; endless planes: exact
//
// "Exact" refers to the iterations that ran. With implicit gradients "exact" refers to the solution
// of the step, within the residuals of gradient_info().
//
// The adaptive guess reads the velocity at the start of the previous step. The solver carries this
// velocity from step to step and from rollout to rollout until reset(). Unrolled gradients with
// respect to the velocity are exact over the steps and rollouts of a tape. Implicit gradients with
// respect to the velocity are 0, because a solution does not depend on the guess. A trajectory with
// checkpoints stores the velocity with each checkpoint. A replay of a capture continues from the
// velocity of the last step. If the capture contains reset(), each replay resets the velocity, too.
//
// Steps and rollouts can be captured, and so can their backward and jvp. A replay runs on the host,
// or on the device of the model. On a device the materials and rest shapes of elements may change
// from replay to replay if they carry a gradient. An element whose coefficients are all 0 must keep
// these values. gradient_info() throws if they changed. A capture on a device supports neither jvp
// nor implicit gradients (see DifferentiableVbd).
class NOVAPHY_VBD_API DiffSolverVBD : public DiffSolverBase {
 public:
  // Errors: as for DifferentiableVbd.
  explicit DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options = {});

  const DiffVbdOptions& options() const { return options_; }
  int32_t kinematic_count() const { return steps_ ? steps_->kinematic_count() : 0; }
  // Returns how exact the last backward or jvp was. The labels cover the latest chain of steps on a
  // tape, in which each step starts from the result of the previous step. For a capture the labels
  // cover the last replay. ErrorKind::Runtime: no backward or jvp ran yet, or a captured step or
  // backward failed in a replay since the last call. A failed replay writes NaN. The message names
  // the first failure and the step of the rollout. step and rollout raise this error, too. On a
  // device this function also raises the errors of SolverVBD::residual, for steps outside of
  // captures as well.
  DiffVbdGradientInfo gradient_info() const;
  void clear_gradient_info();

  // Errors: as for SolverVBD::step. ErrorKind::Runtime: a step with implicit gradients was not
  // solved. A step does not change particle_f.
  bool supports_graph_capture() const override { return bodies_ == nullptr; }
  // Forgets the velocity that the adaptive guess reads. A capture may record this call.
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
  StepReport note_step(NotedStep noted, bool keeps);
  void record_bodies(const SimState& in, const SimState& out, const StepInputs& inputs);
  int64_t number_of_step(const void* start, const void* end);
  void check_replays() const;
  void begin();
  bool looks_back() const {
    return bodies_ == nullptr && options_.initial_guess == VbdInitialGuess::Adaptive;
  }
  VbdGradientInfo last_info() const { return steps_ ? steps_->info() : bodies_->info(); }
  DeviceArray<Vec4f> new_velocities() const;
  nova::Tensor last_velocity(StepInputs::Checkpoints* checkpoints);
  void keep_velocity(const SimState& in, StepInputs::Checkpoints* checkpoints, StepScratch scratch);
  std::shared_ptr<const Contacts> kept(const Contacts* contacts);

  DiffVbdOptions options_;
  EditedValues values_{"DiffSolverVBD"};  // checks captures; steps_ has a separate check
  // One of the two: steps of particles, or steps of bodies.
  std::shared_ptr<DifferentiableVbd> steps_;
  std::shared_ptr<DifferentiableBodies> bodies_;
  // the first failure of a replay
  std::shared_ptr<std::string> failure_ = std::make_shared<std::string>();
  std::shared_ptr<const Contacts> last_contacts_;  // a copy of the contacts of the last step
  GradientNotes notes_;
  std::shared_ptr<UnsolvedSteps> unsolved_;  // of the chain of recorded_step_
  // The address of the state at the end of the last recorded step, and the step's number.
  struct {
    const void* end = nullptr;
    int64_t number = 0;
  } recorded_step_;
  struct Witness;
  std::weak_ptr<Witness> witness_;
  // The previous velocities for the adaptive guess: see VbdStepInputs::last_velocity.
  // recorded_velocity_ holds the rows that the last step on a tape wrote, also in a capture.
  DeviceArray<Vec4f> last_velocity_;
  struct {
    const nova::OpList* capture = nullptr;
    nova::Tensor rows;
  } recorded_velocity_;
};

}  // namespace novaphy::diff
