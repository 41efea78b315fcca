// Differentiable integration of particles. Compiled into novaphy::dynamics if nova is built.
//
// The gradient of each input:
//   particle_q, particle_qd, particle_f   exact
//   gravity of each world                 exact
//   particle_mass                         exact (through particle_inv_mass = 1/mass; 0 for mass 0)
//   particle_radius, shape_material_*     exact, if static contacts are part of the operator
//   particle_flags, particle_max_velocity, dt   none (flags select; dt and the limit are constants)
#pragma once

#include <utility>

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff {

// Returns positions {n, 3} (m) and velocities {n, 3} (m/s) after dt (s) by symplectic Euler
// (particle_integrator_trace.h). Inputs are {n, 3} packed float32 on the model's device. dt is
// finite and > 0. ErrorKind::Type, ErrorKind::Value: other inputs.
NOVAPHY_DYNAMICS_API std::pair<nova::Tensor, nova::Tensor> integrate_particles_generated(
    const Model& model, const nova::Tensor& particle_q, const nova::Tensor& particle_qd,
    const nova::Tensor& particle_f, float dt);

// Computes the forces of all static shapes (eval_static_particle_shape_contact_forces_generated)
// and the integration in one kernel. The bits are those of two separate calls.
NOVAPHY_DYNAMICS_API std::pair<nova::Tensor, nova::Tensor>
integrate_particles_with_static_contacts_generated(const Model& model,
                                                   const nova::Tensor& particle_q,
                                                   const nova::Tensor& particle_qd,
                                                   const nova::Tensor& particle_f,
                                                   float soft_contact_margin, float dt);

// Integrates particles into given memory, for solvers. The caller must check that the particles'
// worlds are supported (WorldRows).
NOVAPHY_DYNAMICS_API void integrate_particles(const Model& model, const nova::Operand& particle_q,
                                              const nova::Operand& particle_qd,
                                              const nova::Operand& particle_f, float dt,
                                              const nova::Operand& q_out,
                                              const nova::Operand& qd_out);

// Computes the forces of all static shapes and the integration into given memory. kf_rate: the
// symbol r of diff_soft_contact_trace.h, which the functions above leave out.
NOVAPHY_DYNAMICS_API void step_particles_with_static_contacts(
    const Model& model, const WorldRows& rows, const nova::Operand& particle_q,
    const nova::Operand& particle_qd, const nova::Operand& particle_f, float kf_rate,
    float soft_contact_margin, float dt, const nova::Operand& q_out, const nova::Operand& qd_out);

// Computes the forces of stored contacts (eval_soft_contact_forces) and the integration in one
// kernel. The bits are those of two separate calls. `particle_f` is only read.
NOVAPHY_DYNAMICS_API void step_particles(const Model& model, const Contacts& contacts,
                                         const nova::Incidence& contacts_of,
                                         const nova::Operand& particle_q,
                                         const nova::Operand& particle_qd,
                                         const nova::Operand& particle_f, float kf_rate, float dt,
                                         const nova::Operand& q_out, const nova::Operand& qd_out);

}  // namespace novaphy::diff
