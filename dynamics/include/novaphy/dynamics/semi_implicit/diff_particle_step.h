// ParticleStep: one semi-implicit step of particles as generated kernels, first the forces of
// elements and contacts and then integration. DiffSemiImplicitSolver records the kernels, and
// SolverSemiImplicit runs them on devices other than the CPU. Compiled into novaphy::dynamics if
// nova is built.
#pragma once

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"

namespace novaphy::diff {

struct ParticleStepOptions {
  ElementSet elements;
  bool contacts = true;                // whether the contacts of a Contacts act
  bool static_contacts = false;        // use world-owned shapes at their true distance instead of
                                       // contacts
  float static_contact_margin = 0.0f;  // m
  float kf_bound = 1.0f;               // see SemiImplicitOptions::particle_kf_bound
};

// Keeps memory between calls. Only one thread at a time may use an object.
class NOVAPHY_DYNAMICS_API ParticleStep {
 public:
  // ErrorKind::NotImplemented: a shape that static contacts do not support.
  ParticleStep(const Model& model, const ParticleStepOptions& options);

  float kf_bound() const { return options_.kf_bound; }
  const WorldRows& rows() const { return rows_; }
  bool has_elements() const { return !elements_.empty(); }
  bool meets_bodies() const { return meets_bodies_; }  // whether contacts may touch bodies
  // Returns whether the normal of a contact may depend on the particle's position or a body's pose.
  // The normals of planes of the world are constant.
  bool contacts_move() const { return contacts_move_; }
  // Returns the arrays that `record` writes besides its outputs.
  std::vector<ScratchSpec> scratch() const;
  // Call this before the steps of a solver call: updates what all of these steps read. Messages
  // begin with `function`.
  void begin(const Model& model, const char* function);
  // Steps from `in` to `out`, and adds the forces to in.particle_f in the order of
  // SolverSemiImplicit. `tables`: tables of the contacts.
  void run(const Model& model, SimState& in, SimState& out, const Control* control,
           const Contacts* contacts, const ContactTables& tables, float dt);
  // Steps from `in` to `out`, and only reads in.particle_f. Contacts and integration are one kernel
  // unless `tables` has the bodies of the contacts.
  void record(const Model& model, const SimState& in, SimState& out, const StepInputs& inputs,
              const ContactTables& tables, StepScratch scratch);
  // Returns the wrenches {slots, 6} of the last step's particle contacts on bodies. Null: no
  // wrenches.
  const nova::Operand* wrenches() const { return touches_ ? &wrenches_ : nullptr; }

 private:
  // Computes `to` = f plus the forces of the elements, and returns `to`. Without elements returns
  // f.
  nova::Operand add_elements(const Model& model, const Control* control, const nova::Operand& q,
                             const nova::Operand& qd, const nova::Operand& f,
                             const nova::Operand& to);
  // Computes `to` = f plus the forces of the contacts.
  void add_contacts(const Model& model, const SimState& in, const Contacts& contacts,
                    const ContactTables& tables, const nova::Operand& f, float dt,
                    const nova::Operand& to);

  ParticleStepOptions options_;
  WorldRows rows_;  // for models with several worlds
  ElementOperators elements_;
  bool meets_bodies_ = false, contacts_move_ = false, touches_ = false;
  // The force of each contact on its particle and its wrench on its body. No adjoint reads them.
  nova::Operand forces_, wrenches_;
};

}  // namespace novaphy::diff
