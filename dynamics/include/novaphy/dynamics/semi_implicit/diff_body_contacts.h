// Differentiable contacts of bodies stored in a Contacts: of shapes with each other, and of
// particles with shapes of bodies. Compiled into novaphy::dynamics if nova is built.
//
// Each evaluation has two steps. First, a kernel over the contacts writes the forces of each
// contact. Then a sum over the bodies (or particles) adds these forces in the order of the
// contacts. The sums need no atomics, forward or backward, and the bits are those of
// SolverSemiImplicit.
//
// The gradient of each input:
//   body_q, body_qd, body_f; particle_q, particle_qd, particle_f    through the forces: exact. The
//       points and normals of the features in moving_contact_trace.h move with both bodies
//       (contact_gradients.h finds these rows). All other contacts are frozen: points stay in the
//       frames of their bodies and normals in the world (docs/coverage.md). Rows that were not
//       found from the present state of the step are all frozen
//       (Contacts::rigid_contacts_found_from). Points and normals of particle contacts move if a
//       rollout finds them in every step (for hulls and meshes as if the face were a plane);
//       otherwise they are frozen
//   model: body_com, particle_radius, shape_material_ke, _kd, _kf, _mu    exact
//   contacts: rigid_contact_stiffness, _damping, _friction    exact where > 0, else 0
//   which contacts exist, shape_material_ka, particle_adhesion, smoothing    none
#pragma once

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

// The tables by which bodies and particles sum the forces of a Contacts. Each Contacts needs its
// own object on a tape.
class NOVAPHY_DYNAMICS_API ContactTables {
 public:
  struct Wanted {
    bool particles = false;            // contacts of particles
    bool particles_on_bodies = false;  // whether some contacts may touch bodies
    bool bodies = false;               // contacts of shapes
    // Whether contacts of shapes were found from the state of the step, so that points and normals
    // move with the state. false: points and normals are frozen.
    bool of_this_state = true;
    // The same for contacts of particles. The bodies of these contacts are found, too.
    bool particles_move = false;
  };
  // Updates the tables from the contacts, unless they are up to date. In a capture each replay
  // rebuilds the tables of bodies. ErrorKind::Index: a contact names a particle that does not
  // exist.
  void update(const Model& model, const Contacts& contacts, const Wanted& wanted);
  // Rebuilds the tables by launches, from contacts that an earlier launch has written. If the
  // contacts have the same memory as in the last call, the tables keep their memory, too.
  void rebuild(const Model& model, const Contacts& contacts, const Wanted& wanted);

  // Null: not requested, or the contacts have no rows. A slot is a row of soft_contact_*; a side is
  // a body of a row of rigid_contact_*.
  const nova::Incidence& slots_of_particles() const { return slots_of_particles_; }
  const nova::Incidence& slots_of_bodies() const { return slots_of_bodies_; }
  const nova::Incidence& sides_of_bodies() const { return sides_of_bodies_; }
  const DeviceArray<int32_t>& soft_bodies() const { return soft_bodies_; }    // {slots}
  const DeviceArray<int32_t>& rigid_bodies() const { return rigid_bodies_; }  // {rows, 2}
  bool of_this_state() const { return of_this_state_; }
  bool particles_move() const { return particles_move_; }

 private:
  void rebuild_bodies(const Model& model, const Contacts& contacts, const Wanted& wanted);
  nova::Incidence slots_of_particles_, slots_of_bodies_, sides_of_bodies_;
  DeviceArray<int32_t> soft_bodies_, rigid_bodies_;
  bool of_this_state_ = true, particles_move_ = false;
  // stamps of the arrays from which the tables of bodies were made
  ArrayStamp soft_shape_, shape0_, shape1_, shape_body_;
};

// Computes wrenches {rows, 12}: the wrench of each row of rigid_contact_* on its body A, then on
// its body B. Only friction laws with smoothing use law.smoothing (m/s); huber with 0 is viscous.
NOVAPHY_DYNAMICS_API void eval_rigid_contacts(const Model& model, const Contacts& contacts,
                                              const ContactTables& tables,
                                              const nova::Operand& body_q,
                                              const nova::Operand& body_qd,
                                              const RigidContactLaw<float>& law,
                                              const nova::Operand& wrenches);

// Writes Contacts::rigid_contact_force of the valid rows from the result of eval_rigid_contacts.
// Not recorded on a tape.
NOVAPHY_DYNAMICS_API void write_rigid_contact_forces(const Contacts& contacts,
                                                     const nova::Operand& wrenches);

// Computes forces {slots, 3} and wrenches {slots, 6}: the force of each slot of soft_contact_* on
// its particle, and its wrench on its body.
NOVAPHY_DYNAMICS_API void eval_soft_contacts(
    const Model& model, const Contacts& contacts, const ContactTables& tables,
    const nova::Operand& particle_q, const nova::Operand& particle_qd, const nova::Operand& body_q,
    const nova::Operand& body_qd, float kf_rate, const nova::Operand& forces,
    const nova::Operand& wrenches);

// Computes sum {b, 6} = body_f plus the rows of `wrenches` {n, 6} that belong to each body, in
// order.
NOVAPHY_DYNAMICS_API void add_wrenches(const nova::Operand& body_f, const nova::Operand& wrenches,
                                       const nova::Incidence& of_bodies, const nova::Operand& sum);

}  // namespace novaphy::diff
