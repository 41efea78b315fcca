// ArticulationStep: the step of articulations as one operation of a tape, with its exact adjoint
// and tangent.
//
// Gradients of joint_q, joint_qd, body_q and body_qd of the new state (articulation/step_vjp.h):
//   by joint_q, joint_qd, joint_f, body_f, joint_target_q, joint_target_qd,    exact
//   joint_target_ke, _kd, joint_damping, joint_armature, joint_limit_lower,
//   _upper, _ke, _kd, joint_effort_limit, joint_velocity_limit,
//   body_mass, body_com, body_inertia, gravity
//   by joint_friction, shape_material_mu, _restitution, _ke, _kd               see below
//   by joint_X_p, joint_X_c, joint_axis                                        none: it raises
// Branches (which limits and clamps act) stay constant, so "exact" excludes states where a limit,
// an effort clamp or a velocity clamp is just reached. Gradients by quaternions are tangent to the
// unit sphere. Only the symmetric part of body_inertia counts.
//
// With contacts (FeatherstoneOptions::contact Pgs) the PGS sweeps start from zero impulses. The
// sweeps end at pgs_tolerance, or after 1000 sweeps (pgs_iterations, if larger).
//
// The gradient is the implicit gradient of the converged impulses for the active rows
// (articulation/contact_adjoint.h). The label is "exact of the code" if the residual of the rows is
// at most 1e-4 of the largest impulse, else "surrogate". Where a contact is just breaking, sticking
// or sliding, the gradient is one-sided. ContactBranches counts the branches, and the events of
// contacts between steps (gradient_counts.h).
//
// If a step ends far from convergence (pgs.h), its adjoint and its tangent throw ErrorKind::Runtime
// with the step and the pair. On devices the error comes from the next step or rollout that waits.
// Captures do not report the error.
//
// Contact points and normals move as the collision search moves them, for the features of
// moving_contact_trace.h. These are planes with all shapes, spheres, capsules and boxes with each
// other, and nearest points of cylinders, cones and ellipsoids. For this the contacts must come
// from the state of the step (FoundContacts). All other points are constant in the frames of their
// bodies, and all other normals are constant in the world ("frozen"). ContactBranches counts these
// steps separately. The set of contacts is not differentiated.
//
// Dry friction of joints (joint_friction) is handled in the same way; a step with dry friction
// counts as a step with contacts. On the CPU a capture records these steps and adjoints as work of
// the host. If a replay fails, its results are NaN, and `begin` throws with the cause.
//
// Models on devices: steps, adjoints and tangents have the bits of the CPU, and captures record
// their launches. If an island's linear system exceeds its memory on the device
// (contact_steps_vjp.cpp), its gradients and tangents are NaN, and `check` throws.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/trajectory.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

// Whether the contacts of a step were found from the state of the step.
enum class FoundContacts : uint8_t {
  Before,       // no, or the state was written since: points and normals are constant
  BeforeAgain,  // the same, and they are found again whenever the step runs
  Now,          // yes, from the values that the state has now
  Always        // yes, and they are found again whenever the step runs
};

class NOVAPHY_DYNAMICS_API ArticulationStep {
 public:
  // Errors as for SolverFeatherstone. ErrorKind::Value: a model whose joints have no dofs.
  // `allow_unconverged`: adjoints and tangents of steps that are far from convergence do not throw.
  // ErrorKind::NotImplemented: DerivativeOf::Motion with a model on a device or with
  // compliant_contacts. With DerivativeOf::Auto these steps, steps in captures, and steps without
  // contacts have the derivative of the code.
  ArticulationStep(const Model& model, const FeatherstoneOptions& options, const char* user,
                   bool allow_unconverged = false,
                   DerivativeOf contact_gradient = DerivativeOf::Auto);
  ~ArticulationStep();
  ArticulationStep(ArticulationStep&&) noexcept;
  ArticulationStep& operator=(ArticulationStep&&) noexcept;

  // Returns the sizes of the memory that a step needs. With contacts (`contact_max` at most) the
  // third entry is the memory that a step keeps about its contacts.
  std::vector<ScratchSpec> scratch(const Model& model, int32_t contact_max) const;
  // Checks the model and control before one or several steps.
  void begin(const Model& model, const Control* control, const char* function);
  // Submits a step, recorded on an active tape. `body_f` {b, 6}: the wrenches on the bodies.
  // `scratch`: memory as in scratch(), which the adjoint reads. `join`: consecutive steps without
  // contacts form one operation of several steps. `flush` must be called after the last of them and
  // records the operation; `forget` drops the operation.
  void record(const Model& model, const SimState& in, SimState& out, const Control* control,
              const Contacts* contacts, FoundContacts found, const nova::Operand& body_f, float dt,
              StepScratch scratch, bool join = false);
  void flush();
  void forget();
  // Sets the number of the next step, for error messages. The first step has number 0.
  void count_from(int64_t number);
  // Returns the counts of branches over all steps with contacts since the last clear. Waits for a
  // device.
  ContactBranches branches() const;
  void clear_branches();
  // Returns the counts of events whose times move. Null with DerivativeOf::Code.
  const MotionCounts* motion_counts() const;
  // Throws ErrorKind::Runtime, with the dof, if the last step failed. Waits for a device.
  void check(const Model& model, const char* function) const;

  struct Shared;
  struct Step;

 private:
  bool joins(const Model& model, const SimState& in, SimState& out, const Control* control,
             const nova::Operand& body_f, float dt, StepScratch scratch);

  std::shared_ptr<Step> pending_;
  std::shared_ptr<Shared> shared_;
};

}  // namespace novaphy::diff
