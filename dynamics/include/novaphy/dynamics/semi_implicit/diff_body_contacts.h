// Differentiable contacts of bodies that a Contacts holds: of shapes with each other, and of
// particles with the shapes of bodies. Compiled into novaphy::dynamics where nova is built.
//
// Each is two steps: a kernel over the contacts, which writes the forces of each contact, and a sum
// over the bodies (the particles) in the order of the contacts. No sum needs atomics, forward or
// backward, and the bits are those of SolverSemiImplicit.
//
// The gradient of each input:
//   body_q, body_qd, body_f; particle_q, particle_qd, particle_f    through the forces: exact. The
//       points and normals of planes, spheres, capsules and boxes follow both bodies
//       (moving_contact_trace.h, contact_gradients.h says which rows); those of other shapes are
//       frozen: the points stay in the frames of their bodies, the normals in the world
//       (docs/coverage.md). Rows that were not found from the state of the step, as it is then, are
//       all held so (Contacts::rigid_contacts_found_from). Points and normals of particles with
//       shapes follow both where a rollout finds them in every step (of hulls and meshes as if
//       their face went on); else they are held
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

// By what tables bodies and particles add up what a Contacts does to them. A tape needs one for
// each Contacts.
class NOVAPHY_DYNAMICS_API ContactTables {
 public:
  struct Wanted {
    bool particles = false;            // contacts of particles
    bool particles_on_bodies = false;  // of which some may touch bodies
    bool bodies = false;               // contacts of shapes
    // They were found from the state of the step, so that their points and normals follow it; else
    // they are held as they are.
    bool of_this_state = true;
    // So were those of particles.
    bool particles_follow = false;
  };
  // From what the contacts hold, unless that is known already. Inside a capture the tables of
  // bodies are found anew by each replay. ErrorKind::Index where they name a particle that is not
  // there.
  void update(const Model& model, const Contacts& contacts, const Wanted& wanted);
  // From what a launch before has written to the contacts, by launches; keeps its memory for
  // contacts in the same memory.
  void rebuild(const Model& model, const Contacts& contacts, const Wanted& wanted);

  // Null where not wanted, or where the contacts have no rows.
  const nova::Incidence& slots_of_particles() const { return slots_of_particles_; }
  const nova::Incidence& slots_of_bodies() const { return slots_of_bodies_; }
  const nova::Incidence& sides_of_bodies() const { return sides_of_bodies_; }
  const DeviceArray<int32_t>& soft_bodies() const { return soft_bodies_; }    // {slots}
  const DeviceArray<int32_t>& rigid_bodies() const { return rigid_bodies_; }  // {rows, 2}
  bool of_this_state() const { return of_this_state_; }
  bool particles_follow() const { return particles_follow_; }

 private:
  void rebuild_bodies(const Model& model, const Contacts& contacts, const Wanted& wanted);
  nova::Incidence slots_of_particles_, slots_of_bodies_, sides_of_bodies_;
  DeviceArray<int32_t> soft_bodies_, rigid_bodies_;
  bool of_this_state_ = true, particles_follow_ = false;
  ArrayStamp soft_shape_, shape0_, shape1_, shape_body_;  // that the tables of bodies are made of
};

// wrenches {rows, 12}: what each row of rigid_contact_* adds to the wrench of its body A, then of
// body B. law.smoothing (m/s): of the laws that have one; huber of 0 is viscous.
NOVAPHY_DYNAMICS_API void eval_rigid_contacts(const Model& model, const Contacts& contacts,
                                              const ContactTables& tables,
                                              const nova::Operand& body_q,
                                              const nova::Operand& body_qd,
                                              const RigidContactLaw<float>& law,
                                              const nova::Operand& wrenches);

// Contacts::rigid_contact_force, of the rows that there are, from what eval_rigid_contacts gave.
// Not recorded.
NOVAPHY_DYNAMICS_API void write_rigid_contact_forces(const Contacts& contacts,
                                                     const nova::Operand& wrenches);

// forces {slots, 3} and wrenches {slots, 6}: what each slot of soft_contact_* adds to the force on
// its particle, and to the wrench of its body.
NOVAPHY_DYNAMICS_API void eval_soft_contacts(
    const Model& model, const Contacts& contacts, const ContactTables& tables,
    const nova::Operand& particle_q, const nova::Operand& particle_qd, const nova::Operand& body_q,
    const nova::Operand& body_qd, float kf_rate, const nova::Operand& forces,
    const nova::Operand& wrenches);

// sum {b, 6} = body_f plus the wrenches {n, 6} that belong to each body, in their order.
NOVAPHY_DYNAMICS_API void add_wrenches(const nova::Operand& body_f, const nova::Operand& wrenches,
                                       const nova::Incidence& of_bodies, const nova::Operand& sum);

}  // namespace novaphy::diff
