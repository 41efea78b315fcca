// One semi-implicit step of particles as generated kernels: forces of the elements and of contacts,
// then integration. DiffSemiImplicitSolver records the kernels, and SolverSemiImplicit runs them on
// devices other than the CPU. Compiled into novaphy::dynamics where nova is built.
#pragma once

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"

namespace novaphy::diff {

struct ParticleStepOptions {
  ElementSet elements;
  bool contacts = true;                // those of a Contacts act
  bool static_contacts = false;        // world-owned shapes at their true distance instead
  float static_contact_margin = 0.0f;  // m
  float kf_bound = 1.0f;               // see SemiImplicitOptions::particle_kf_bound
};

// Keeps memory from call to call; one thread at a time may use it.
class NOVAPHY_DYNAMICS_API ParticleStep {
 public:
  // ErrorKind::NotImplemented: with static contacts, a shape that they do not cover.
  ParticleStep(const Model& model, const ParticleStepOptions& options);

  float kf_bound() const { return options_.kf_bound; }
  const WorldRows& rows() const { return rows_; }
  bool has_elements() const { return !elements_.empty(); }
  bool meets_bodies() const { return meets_bodies_; }  // contacts may touch bodies
  // The arrays that `record` writes besides its outputs.
  std::vector<ScratchSpec> scratch() const;
  // What the steps of a call have in common; `function` starts the messages.
  void begin(const Model& model, const char* function);
  // From `in` to `out`; forces are added to in.particle_f, in the order of SolverSemiImplicit.
  // `tables`: of the contacts.
  void run(const Model& model, SimState& in, SimState& out, const Control* control,
           const Contacts* contacts, const ContactTables& tables, float dt);
  // The same with forces that are only read, and contacts and integration in one kernel where no
  // contact touches a body.
  void record(const Model& model, const SimState& in, SimState& out, const StepInputs& inputs,
              const ContactTables& tables, StepScratch scratch);
  // What the contacts of the last step do to bodies: {slots, 6}; null: nothing.
  const nova::Operand* wrenches() const { return touches_ ? &wrenches_ : nullptr; }

 private:
  // f plus the forces of the elements: in `to`, which is returned; f itself without elements.
  nova::Operand add_elements(const Model& model, const Control* control, const nova::Operand& q,
                             const nova::Operand& qd, const nova::Operand& f,
                             const nova::Operand& to);
  // f plus the forces of the contacts, of which some may touch bodies, into `to`.
  void add_contacts(const Model& model, const SimState& in, const Contacts& contacts,
                    const ContactTables& tables, const nova::Operand& f, float dt,
                    const nova::Operand& to);

  ParticleStepOptions options_;
  WorldRows rows_;  // of a model of several worlds
  ElementOperators elements_;
  bool meets_bodies_ = false, touches_ = false;
  // What each contact adds to its particle and to its body, which no adjoint reads.
  nova::Operand forces_, wrenches_;
};

}  // namespace novaphy::diff
