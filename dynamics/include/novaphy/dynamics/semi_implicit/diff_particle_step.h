// One semi-implicit step of particles as generated kernels: forces of the elements and of contacts,
// then integration. What DiffSemiImplicitSolver records, and what SolverSemiImplicit runs on other
// devices than the CPU. Compiled into novaphy::dynamics where nova is built.
#pragma once

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/nova/incidence.h"

namespace novaphy::diff {

struct ParticleStepOptions {
  ElementSet elements;
  bool contacts = true;                // those of a Contacts act
  bool refuse_overflow = false;        // of the slots of a Contacts
  bool static_contacts = false;        // world-owned shapes at their true distance instead
  float static_contact_margin = 0.0f;  // m
};

// Keeps memory from call to call; one thread at a time may use it.
class NOVAPHY_DYNAMICS_API ParticleStep {
 public:
  // ErrorKind::NotImplemented: with static contacts, a shape that they do not cover.
  ParticleStep(const Model& model, const ParticleStepOptions& options);

  bool has_elements() const { return !elements_.empty(); }
  // The arrays that `record` writes besides its outputs.
  std::vector<ScratchSpec> scratch() const;
  // What the steps of a call have in common; `function` starts the messages. Reads the contacts on
  // the host: before anything is deferred.
  void begin(const Model& model, const Contacts* contacts, const char* function);
  // From `in` to `out`; forces are added to in.particle_f, in the order of SolverSemiImplicit.
  void run(const Model& model, SimState& in, SimState& out, const Control* control,
           const Contacts* contacts, float dt);
  // The same with forces that are only read, and contacts and integration in one kernel.
  void record(const Model& model, const SimState& in, SimState& out, const StepInputs& inputs,
              StepScratch scratch);

 private:
  // f plus the forces of the elements: in `to`, which is returned; f itself without elements.
  nova::Operand add_elements(const Model& model, const Control* control, const nova::Operand& q,
                             const nova::Operand& qd, const nova::Operand& f,
                             const nova::Operand& to);
  // The slots of every particle, or null when no contact acts.
  const nova::Incidence* contacts_of_particles(const Model& model, const Contacts* contacts);

  ParticleStepOptions options_;
  nova::Incidence contacts_of_;  // of the last contacts
  WorldRows rows_;               // of a model of several worlds
  ElementOperators elements_;
};

}  // namespace novaphy::diff
