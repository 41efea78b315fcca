// SolverSemiImplicit: forces as springs and dampers, then symplectic Euler.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/sleep.h"
#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy {

// All numbers finite and >= 0, particle_kf_bound perhaps infinite. enable_tri_contact acts on
// contacts of particles with triangles, of which there are none yet.
struct SemiImplicitOptions {
  // The largest kf dt/m of a contact of a particle of mass m: a larger kf counts as that. Friction
  // then takes at most this part of a slip in a step, and from 2 on gradients grow in every step
  // that it acts. Infinite: kf as it is, which is Newton's law.
  float particle_kf_bound = 1.0f;
  float angular_damping = 0.05f;                    // 1/s, of rigid bodies
  FrictionLaw friction_law = FrictionLaw::Viscous;  // of rigid contacts
  // m/s, of the laws huber and newton17: 0.1 when empty. ErrorKind::Value with the others.
  std::optional<float> friction_smoothing = {};
  // Of rigid contacts. The mean: with the friction laws viscous and huber, without stick_ke.
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
  // N/m, of every row of rigid contacts with the law viscous: a spring along the surface, kept from
  // step to step by rigid_contact_point_id (src/semi_implicit/stick_springs.h), with which friction
  // holds what is at rest. 0: none, and it creeps. There is no gradient of it.
  float stick_ke = 0.0f;
  // Of joints: N/m and N*m/rad; N*s/m, and 0.01 of it N*m*s/rad.
  float joint_attach_ke = 1.0e4f;
  float joint_attach_kd = 1.0e2f;
  bool enable_tri_contact = true;
  // Bodies at rest keep their bits (core/sim/sleep.h), on the CPU. Empty: none sleeps.
  std::optional<SleepConfig> sleep = {};
};

// Covers particles and elements over them: external forces, springs, triangles, bending edges,
// tetrahedra, soft contacts with world-owned shapes, gravity, the velocity limit; and rigid bodies:
// external forces, joints as springs, rigid contacts, gravity, the gyroscopic term, angular
// damping. Joint coordinates are not written: ask eval_ik. Other parts of a model throw
// ErrorKind::NotImplemented; there is no contact between particles, of particles with triangles, or
// of particles with bodies.
//
// One step, in this order:
//   1. every spring, then triangle, bending edge and tetrahedron adds its forces (spring_trace.h,
//      triangle_trace.h, bending_trace.h, tetrahedron_trace.h) to state_in.particle_f, for each
//      particle in the order of the elements. Activations are the control's, or the model's when
//      there is no control.
//   2. every soft contact adds its force (collision/diff_soft_contact_trace.h), for each particle
//   in
//      slot order
//   3. state_out.particle_q and particle_qd from symplectic Euler (particle_integrator_trace.h);
//      particles without ParticleFlags.ACTIVE keep position and velocity
// and for bodies:
//   1. every enabled joint adds, after state_in.body_f, a wrench to its bodies
//      (penalty_joint_trace.h), in the order of the joints, the parent's before the child's; that
//      of a FREE joint is joint_f. Forces and targets are the control's, or the model's without one
//   2. every rigid contact has a force (rigid_contact_trace.h), which is added to its bodies in the
//      order of the rows, shape A before shape B; body_f itself stays as it is, and
//      Contacts::rigid_contact_force holds the forces
//   3. state_out.body_q and body_qd from symplectic Euler (rigid_integrator_trace.h); a kinematic
//      body follows its velocity
// Of contacts that overflowed the slots that exist act; ask Contacts::overflowed().
// The result has the same bits for any number of threads, and those of Newton 1.8.0 on the cpu as
// far as the formulas' head comments say. A model on another device is stepped there, by the
// kernels of novaphy::diff, with the same bits; such a model has one world.
class NOVAPHY_DYNAMICS_API SolverSemiImplicit : public SolverBase {
 public:
  // ErrorKind::Value: a bad option, or a dynamic body without mass; ErrorKind::NotImplemented: a
  // model that has something that is not covered, or is on another device than the CPU in a build
  // without NOVAPHY_WITH_NOVA.
  explicit SolverSemiImplicit(std::shared_ptr<const Model> model,
                              const SemiImplicitOptions& options = {});
  ~SolverSemiImplicit() override;

  const SemiImplicitOptions& options() const { return options_; }

  // Besides the errors of SolverBase::step: ErrorKind::Value for a dt at which the attachment of a
  // joint diverges by itself; ErrorKind::Index for a contact of a particle or shape,
  // or an element of a particle, that is not there; ErrorKind::NotImplemented for a contact with a
  // shape of a body; ErrorKind::Value for a number of the model
  // that makes no sense (Model::check_numbers). It warns, once, of a dt at which ke or kd of what
  // touches diverges even with all but one body held, and of one at which a particle diverges by
  // its elements or contacts (needed_particle_dt); it asks now and then. On a tape it raises:
  // DiffSemiImplicitSolver is the differentiable one.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // On another device than the CPU by its kernels.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;
  void notify_model_changed(ModelFlags flags) override;
  // The smaller of stable_contact_dt (contact_stability.h) and enough_particle_dt
  // (particle_stability.h) of the contacts that touch in `state`; without contacts of elements.
  float stable_dt(const SimState& state, const Contacts& contacts) const;
  float stable_dt(const SimState& state) const;

 private:
  struct Cache;

  SemiImplicitOptions options_;
  std::unique_ptr<Cache> cache_;
  std::unique_ptr<SolverBase> on_device_;  // of a model that is not on the CPU
};

}  // namespace novaphy
