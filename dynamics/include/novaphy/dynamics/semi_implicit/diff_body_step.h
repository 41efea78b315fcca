// BodyStep: one semi-implicit step of bodies as generated kernels, first the wrenches of contacts
// and then integration. DiffSemiImplicitSolver records these kernels. Compiled into
// novaphy::dynamics if nova is built.
#pragma once

#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/dynamics/semi_implicit/diff_joints.h"
#include "novaphy/dynamics/semi_implicit/diff_rigid_bodies.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy::diff {

struct BodyStepOptions {
  const char* solver = "";        // messages begin with the name of its step
  bool static_contacts = false;   // use planes of the world, found inside of the kernel, instead of
                                  // contacts
  float angular_damping = 0.05f;  // 1/s
  FrictionLaw friction_law = FrictionLaw::Huber;
  float friction_smoothing = 0.1f;  // m/s
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
};

// Returns whether the host can read the arrays of a model in place.
NOVAPHY_DYNAMICS_API bool is_on_host(const Model& model);

// Keeps memory between calls. Only one thread at a time may use an object.
class NOVAPHY_DYNAMICS_API BodyStep {
 public:
  explicit BodyStep(const BodyStepOptions& options) : options_(options), watch_(options.solver) {
    const FrictionLaw law = options.friction_law;
    if (options.friction_smoothing > 0.0f &&
        (law == FrictionLaw::Huber || law == FrictionLaw::Newton17))
      watch_.leave_out_friction();
  }

  // Call this before the steps of a solver call: updates the tables that all of these steps read.
  // ErrorKind::NotImplemented: a pair of shapes that static contacts do not support.
  void begin(const Model& model);
  // Steps from `in` to `out`. Wrenches are summed in the order of SolverSemiImplicit: `body_f` {b,
  // 6}, the wrenches of `joints` (null: none) with their control, those of contacts between shapes,
  // and `of_particles` {slots, 6} (null: none). `tables`: tables of the contacts. `total` {b, 6}:
  // memory for the sum, which the adjoint needs. Outside of captures, warns if dt is too large for
  // the contacts (ContactWatch).
  void run(const Model& model, const SimState& in, SimState& out, const nova::Operand& body_f,
           DiffJoints* joints, const Control* control, const Contacts* contacts,
           const ContactTables& tables, const nova::Operand* of_particles, float dt,
           const nova::Operand& total);
  const PlanePairs& plane_pairs() const { return plane_pairs_; }
  // Writes Contacts::rigid_contact_force of the last run, which must have had these contacts.
  void write_contact_forces(const Contacts& contacts) const;

 private:
  void look(const Model& model, const SimState& in, const Contacts* contacts,
            const ContactTables& tables, float dt);

  bool touches_ = false;  // whether the last run had contacts
  BodyStepOptions options_;
  ContactWatch watch_;
  PlanePairs plane_pairs_;
  nova::Operand wrenches_;                    // per side of each contact row; no adjoint reads them
  nova::Operand sum_;                         // partial sum; no adjoint reads it
  nova::Operand joint_wrenches_, joint_sum_;  // no adjoint reads them
};

}  // namespace novaphy::diff
