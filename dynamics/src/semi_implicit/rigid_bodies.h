// The rigid bodies of a step: contact forces row by row, their sum on each body in the order of the
// rows, then the integration of each body. So nothing depends on the number of threads.
#pragma once

#include <vector>

#include "../sleep_step.h"
#include "joint_forces.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "particle_contacts.h"
#include "stick_springs.h"

namespace novaphy {

struct RigidStep {
  FrictionLaw friction_law;
  float friction_smoothing;  // m/s
  float angular_damping;     // 1/s
  float dt;                  // s
  float stick_ke = 0.0f;     // N/m, of friction; 0: none sticks
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
};

class RigidBodies {
 public:
  // Checks what step reads, and finds the rows of every body if the contacts are others than at the
  // last call. Keeps its memory. ErrorKind::Index: a contact of a shape, a shape of a body, or a
  // body of a world that is not there. ErrorKind::Value: a material of a row that none can have.
  void prepare(const Model& model, const Contacts* contacts);
  // Adds the wrenches of `joints`, which were evaluated, to body_f, then those of the contacts.
  // Writes the bodies of `out`, and rigid_contact_force of the contacts that were prepared.
  // `particles`: those that touch bodies, evaluated; null: none. `watch` looks at the contacts
  // before bodies are written. `sleep` null: no body sleeps.
  void step(const Model& model, const SimState& in, SimState& out, const Contacts* contacts,
            const JointForces& joints, const ParticleContacts* particles, const RigidStep& how,
            ContactWatch& watch, SleepStep* sleep = nullptr);
  // The poses that a step wrote are now in `to`, from which the next step goes on.
  void were_copied(const Array& from, const Array& to) { sticks_.were_copied(from, to); }
  // Adds what the contacts that were prepared do to the bodies at `q` with the velocities `qd` to
  // their wrenches {body_count}; writes rigid_contact_force. Reads friction_law and
  // friction_smoothing.
  void add_contact_wrenches(const Model& model, const Transformf* q, const SpatialVectorf* qd,
                            const Contacts& contacts, const RigidStep& how,
                            SpatialVectorf* wrenches);

 private:
  void find_sleepers(const Model& model, const SimState& in, const Contacts* contacts,
                     const JointForces& joints, const ParticleContacts* particles,
                     SleepStep& sleep);
  void evaluate(const Model& model, const Transformf* q, const SpatialVectorf* qd,
                const Contacts& contacts, const RigidStep& how);

  int32_t rows_ = 0;  // contacts that act
  ArrayStamp count_, shape0_, shape1_, shape_body_;
  std::vector<int32_t> bodies_;           // of the two sides of every row; -1: the world
  IndexRows sides_;                       // of every body
  std::vector<SpatialVectorf> wrenches_;  // what every side adds to its body
  StickSprings sticks_;
  std::vector<int32_t> forced_;  // bodies on which joints or particles act
};

}  // namespace novaphy
