// The step of articulations as one operation of a tape, with its exact adjoint and tangent.
//
// Gradients (articulation/step_vjp.h), of joint_q, joint_qd, body_q and body_qd of the new state:
//   joint_q, joint_qd, joint_f, body_f, joint_target_q, joint_target_qd,       exact
//   joint_target_ke, _kd, joint_damping, joint_armature, joint_limit_lower,
//   _upper, _ke, _kd, joint_effort_limit, joint_velocity_limit,
//   body_mass, body_com, body_inertia, gravity
//   joint_friction, shape_material_mu, _restitution, _ke, _kd                  below
//   joint_X_p, joint_X_c, joint_axis                                           none: it raises
// Exact where no limit, effort or velocity clamp is just reached: branches stay as they were.
// Gradients of quaternions are tangent to the unit sphere. body_inertia counts by its symmetric
// part.
//
// With contacts (FeatherstoneOptions::contact Pgs) the sweeps start from zero impulses and go on to
// pgs_tolerance, at most 1000 times (more where pgs_iterations is more).
//
// The gradient is that of the converged impulses by the active rows
// (articulation/contact_adjoint.h). The gradient is exact of the code where the rows miss their law
// by at most 1e-3 of the largest impulse, else a surrogate. Where a contact is just breaking,
// sticking or sliding, it is that to one side. ContactBranches counts the branches, and the events
// of contacts between steps (gradient_counts.h).
//
// Where the sweeps of a step ended far from converged (pgs.h), its adjoint and its tangent throw
// ErrorKind::Runtime, with the step and the pair. (On devices the step or rollout that waits looks;
// captures do not.)
//
// Points and normals move as the search moves them for planes with all shapes, and for spheres,
// capsules and boxes with each other (moving_contact_trace.h). The contacts must come from the
// state of the step (FoundContacts). Other points and normals are frozen: points stay in the
// frames of their bodies, normals in the world. ContactBranches counts such steps apart. The making
// and breaking of contacts is not differentiated.
//
// Dry friction of joints (joint_friction) is treated likewise, and counts as a step with contacts.
// A capture records such steps and their adjoints as work of the host; where a replay fails its
// results are NaN, and begin says why.
//
// Models on devices as SolverFeatherstone, steps, adjoints and tangents with the bits of the cpu,
// and captures record launches. Where an island of contacts has no room there for its system
// (launched_contacts_vjp.cpp), its gradients and tangents are NaN and check says so.
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

// When the contacts of a step were found.
enum class FoundContacts : uint8_t {
  Before,  // from another state, or one that was written since: the step holds them
  Now,     // from the state of the step, as it is
  Always   // so, anew whenever the step runs
};

class NOVAPHY_DYNAMICS_API ArticulationStep {
 public:
  // Errors as SolverFeatherstone; ErrorKind::Value: a model whose joints have no dofs.
  // `allow_unconverged`: adjoints and tangents of steps that are far from converged do not throw.
  // ErrorKind::NotImplemented: DerivativeOf::Motion of a model on a device, or with
  // compliant_contacts.
  ArticulationStep(const Model& model, const FeatherstoneOptions& options, const char* user,
                   bool allow_unconverged = false,
                   DerivativeOf contact_gradient = DerivativeOf::Code);
  ~ArticulationStep();
  ArticulationStep(ArticulationStep&&) noexcept;
  ArticulationStep& operator=(ArticulationStep&&) noexcept;

  // With contacts, `contact_max` of them at most, the third is what a step keeps of them.
  std::vector<ScratchSpec> scratch(const Model& model, int32_t contact_max) const;
  // Checks before some steps.
  void begin(const Model& model, const Control* control, const char* function);
  // Submits a step, recorded on an active tape. `body_f` {b, 6}: the wrenches on the bodies;
  // `scratch` as the specs say: what the adjoint reads.
  // `join`: steps without contacts that follow each other become one operation, some at a time;
  // flush, behind the last of them, records it. forget: instead of that.
  void record(const Model& model, const SimState& in, SimState& out, const Control* control,
              const Contacts* contacts, FoundContacts found, const nova::Operand& body_f, float dt,
              StepScratch scratch, bool join = false);
  void flush();
  void forget();
  // The number of the next step, for errors; 0 at first.
  void count_from(int64_t number);
  // Returns the branches of all steps with contacts since the last clear. Waits for a device.
  ContactBranches branches() const;
  void clear_branches();
  // Returns the counts of DerivativeOf::Motion; null with another derivative.
  const MotionCounts* motion_counts() const;
  // ErrorKind::Runtime, naming the dof, when the last step failed. Waits for a device.
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
