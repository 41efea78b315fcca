// SolverSemiImplicit: forces from springs and dampers, then symplectic Euler.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/sleep.h"
#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy {

// All numbers are finite and >= 0, except that particle_kf_bound may be infinite.
// enable_tri_contact is for contacts of particles with triangles, which are not supported yet.
struct SemiImplicitOptions {
  // Bound of kf dt/m for contacts of a particle of mass m; a larger kf is reduced to this bound.
  // Friction then removes at most this fraction of the slip in a step. From 2 on, gradients grow in
  // every step with friction. Infinite: kf is not bounded, as in Newton.
  float particle_kf_bound = 1.0f;
  float angular_damping = 0.05f;                    // 1/s, for rigid bodies
  FrictionLaw friction_law = FrictionLaw::Viscous;  // for rigid contacts
  // m/s: slip speed below which the laws huber and newton17 are smoothed; empty: 0.1.
  // ErrorKind::Value with other laws.
  std::optional<float> friction_smoothing = {};
  // For rigid contacts: force at the start of a step, or mean over a step. Mean needs the friction
  // law viscous or huber, and no stick_ke.
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
  // N/m, stiffness of a tangential spring at every rigid contact, only with the law viscous. The
  // spring persists from step to step by rigid_contact_point_id
  // (src/semi_implicit/stick_springs.h), so that friction holds resting bodies. 0: no spring, and
  // resting bodies creep. No gradient.
  float stick_ke = 0.0f;
  // Spring and damper that hold the bodies of a joint together. Stiffness: N/m and N*m/rad.
  // Damping: joint_attach_kd (N*s/m), and 0.01 joint_attach_kd in N*m*s/rad for rotations.
  float joint_attach_ke = 1.0e4f;
  float joint_attach_kd = 1.0e2f;
  bool enable_tri_contact = true;
  // Resting bodies fall asleep: their state keeps its bits (core/sim/sleep.h). CPU only. Empty: no
  // body sleeps.
  std::optional<SleepConfig> sleep = {};
};

// Supported for particles and their elements: external forces, springs, triangles, bending edges,
// tetrahedra, soft contacts with world-owned shapes, gravity, the velocity limit. Supported for
// rigid bodies: external forces, penalty joints, rigid contacts, gravity, the gyroscopic term,
// angular damping. Joint coordinates are not written; use eval_ik. Other features throw
// ErrorKind::NotImplemented. Contacts between particles, of particles with triangles, and of
// particles with bodies are not supported.
//
// One step for particles, in this order:
//   1. Every spring, then triangle, bending edge and tetrahedron adds its forces (spring_trace.h,
//      triangle_trace.h, bending_trace.h, tetrahedron_trace.h) to state_in.particle_f, for each
//      particle in the order of the elements. Activations are the control's, or the model's without
//      a control.
//   2. Every soft contact adds its force (collision/diff_soft_contact_trace.h). The contacts of a
//      particle are in slot order.
//   3. Symplectic Euler gives state_out.particle_q and particle_qd (particle_integrator_trace.h).
//      Particles without ParticleFlags.ACTIVE keep position and velocity.
// One step for bodies:
//   1. The wrench of a body starts from state_in.body_f. Every enabled joint adds a wrench to its
//      bodies (penalty_joint_trace.h), in the order of the joints, to the parent before the child.
//      The wrench of a FREE joint is joint_f. Forces and targets are the control's, or the model's
//      without a control.
//   2. Every rigid contact adds its force (rigid_contact_trace.h) to its bodies in the order of the
//      rows, shape A before shape B. body_f itself is unchanged, and Contacts::rigid_contact_force
//      has the forces.
//   3. Symplectic Euler gives state_out.body_q and body_qd (rigid_integrator_trace.h). A kinematic
//      body moves with its velocity.
// If contacts have overflowed, only the contacts that found a slot act (see
// Contacts::overflowed()). The result has the same bits for any number of threads. It has the bits
// of Newton 1.8.0 on the CPU as far as the files of the formulas state. The kernels of
// novaphy::diff step a model on another device, with the same bits; such a model has one world.
class NOVAPHY_DYNAMICS_API SolverSemiImplicit : public SolverBase {
 public:
  // ErrorKind::Value: a bad option, or a dynamic body without mass. ErrorKind::NotImplemented: an
  // unsupported feature of the model, or a model on another device than the CPU in a build without
  // NOVAPHY_WITH_NOVA.
  explicit SolverSemiImplicit(std::shared_ptr<const Model> model,
                              const SemiImplicitOptions& options = {});
  ~SolverSemiImplicit() override;

  const SemiImplicitOptions& options() const { return options_; }

  // Errors besides those of SolverBase::step:
  //   ErrorKind::Value           a dt at which the spring of a joint diverges by itself; an
  //                              invalid number of the model (Model::check_numbers)
  //   ErrorKind::Index           a contact or element of a particle or shape that does not exist
  //   ErrorKind::NotImplemented  a contact of a particle with a shape of a body
  // Warns once of a dt at which ke or kd of touching contacts diverges even if all other bodies are
  // fixed. Also warns of a dt at which a particle diverges by its elements or contacts
  // (needed_particle_dt). The checks do not run in every step. On an active tape the step throws;
  // DiffSemiImplicitSolver is the differentiable solver.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // Runs a rollout. On devices other than the CPU, generated kernels step the model.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;
  void notify_model_changed(ModelFlags flags) override;
  // Returns a stable dt (s): the smaller of stable_contact_dt (contact_stability.h) and
  // enough_particle_dt (particle_stability.h) for the touching contacts of `state`. Without
  // contacts, the limit of elements.
  float stable_dt(const SimState& state, const Contacts& contacts) const;
  float stable_dt(const SimState& state) const;

 private:
  struct Cache;

  SemiImplicitOptions options_;
  std::unique_ptr<Cache> cache_;
  std::unique_ptr<SolverBase> on_device_;  // for a model on another device than the CPU
};

}  // namespace novaphy
