// One semi-implicit step of bodies as generated kernels: the wrenches of contacts, then
// integration. DiffSemiImplicitSolver records these kernels. Compiled into novaphy::dynamics where
// nova is built.
#pragma once

#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/dynamics/semi_implicit/diff_joints.h"
#include "novaphy/dynamics/semi_implicit/diff_rigid_bodies.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy::diff {

struct BodyStepOptions {
  const char* solver = "";        // its step starts messages
  bool static_contacts = false;   // planes of the world, found inside of the kernel, instead
  float angular_damping = 0.05f;  // 1/s
  FrictionLaw friction_law = FrictionLaw::Huber;
  float friction_smoothing = 0.1f;  // m/s
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
};

// Keeps memory from call to call; one thread at a time may use it.
class NOVAPHY_DYNAMICS_API BodyStep {
 public:
  explicit BodyStep(const BodyStepOptions& options) : options_(options), watch_(options.solver) {
    const FrictionLaw law = options.friction_law;
    if (options.friction_smoothing > 0.0f &&
        (law == FrictionLaw::Huber || law == FrictionLaw::Newton17))
      watch_.leave_out_friction();
  }

  // What the steps of a call have in common. ErrorKind::NotImplemented: with static contacts, a
  // pair of shapes that they do not cover.
  void begin(const Model& model);
  // From `in` to `out`: the wrenches `body_f` {b, 6}, then those of `joints` (null: none) with
  // their control, of the contacts of shapes, and `of_particles` {slots, 6} (null: none), in the
  // order of SolverSemiImplicit. `tables`: of the contacts. `total` {b, 6}: where their sum is kept
  // for the adjoint. Warns of a dt that is too long for what touches (ContactWatch), not in a
  // capture.
  void run(const Model& model, const SimState& in, SimState& out, const nova::Operand& body_f,
           DiffJoints* joints, const Control* control, const Contacts* contacts,
           const ContactTables& tables, const nova::Operand* of_particles, float dt,
           const nova::Operand& total);
  const PlanePairs& plane_pairs() const { return plane_pairs_; }
  // Contacts::rigid_contact_force, of the last run, which these contacts were given to.
  void write_contact_forces(const Contacts& contacts) const;

 private:
  void look(const Model& model, const SimState& in, const Contacts* contacts,
            const ContactTables& tables, float dt);

  bool touches_ = false;  // in the last run
  BodyStepOptions options_;
  ContactWatch watch_;
  PlanePairs plane_pairs_;
  nova::Operand wrenches_;                    // of each side of each row, which no adjoint reads
  nova::Operand sum_;                         // of these, where more follow: likewise
  nova::Operand joint_wrenches_, joint_sum_;  // likewise
};

}  // namespace novaphy::diff
