// RigidBodies: the rigid bodies of a step. First the contact forces row by row, then their sum on
// each body in the order of the rows, then the integration of each body. The result does not depend
// on the number of threads.
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
  float stick_ke = 0.0f;     // N/m, stiffness of static friction; 0: no static friction
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
};

class RigidBodies {
 public:
  // Checks the arrays that a step reads. If the contacts differ from those of the last call, finds
  // the contact rows of every body again. Reuses its memory. ErrorKind::Index: a contact names a
  // shape, a shape a body, or a body a world that does not exist. ErrorKind::Value: a row has an
  // invalid material.
  void prepare(const Model& model, const Contacts* contacts);
  // Steps the bodies from `in` to `out`. Adds to body_f first the wrenches of `joints`, which must
  // be evaluated, and then those of the contacts. Also writes rigid_contact_force of the prepared
  // contacts. `particles`: the evaluated contacts between particles and bodies; null: none. `watch`
  // checks the contacts before bodies are written. `sleep` null: no body sleeps.
  void step(const Model& model, const SimState& in, SimState& out, const Contacts* contacts,
            const JointForces& joints, const ParticleContacts* particles, const RigidStep& how,
            ContactWatch& watch, SleepStep* sleep = nullptr);
  // Call this if the poses that a step wrote were copied to `to`, and the next step starts from
  // `to`.
  void were_copied(const Array& from, const Array& to) { sticks_.were_copied(from, to); }
  // Adds the wrenches of the prepared contacts to `wrenches` {body_count}, for bodies at the poses
  // `q` with the velocities `qd`. Writes rigid_contact_force. Uses only friction_law and
  // friction_smoothing of `how`.
  void add_contact_wrenches(const Model& model, const Transformf* q, const SpatialVectorf* qd,
                            const Contacts& contacts, const RigidStep& how,
                            SpatialVectorf* wrenches);

 private:
  void find_sleepers(const Model& model, const SimState& in, const Contacts* contacts,
                     const JointForces& joints, const ParticleContacts* particles,
                     SleepStep& sleep);
  void evaluate(const Model& model, const Transformf* q, const SpatialVectorf* qd,
                const Contacts& contacts, const RigidStep& how);

  int32_t rows_ = 0;  // number of contact rows that act
  ArrayStamp count_, shape0_, shape1_, shape_body_;
  std::vector<int32_t> bodies_;           // bodies of the two sides of every row; -1: the world
  IndexRows sides_;                       // rows of each body
  std::vector<SpatialVectorf> wrenches_;  // wrench on the body of each side of each row
  StickSprings sticks_;
  std::vector<int32_t> forced_;  // bodies on which joints or particles act
};

}  // namespace novaphy
