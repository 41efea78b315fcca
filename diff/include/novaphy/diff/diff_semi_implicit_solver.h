// DiffSemiImplicitSolver: the semi-implicit step as generated kernels, recorded on a tape.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/unsupported_materials.h"
#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/dynamics/semi_implicit/diff_body_step.h"
#include "novaphy/dynamics/semi_implicit/diff_joints.h"
#include "novaphy/dynamics/semi_implicit/diff_particle_step.h"
#include "novaphy/dynamics/semi_implicit/diff_touches.h"
#include "novaphy/dynamics/semi_implicit/particle_stability.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy::diff {

struct DiffSolverConfig {
  bool enable_particles = true;
  bool enable_particle_contacts = true;
  bool enable_tetrahedra = false;
  bool enable_triangles = false;
  bool enable_springs = false;
  bool enable_bending = false;
  // Contacts of particles with world-owned planes, boxes, spheres, capsules, cylinders, cones and
  // ellipsoids at their true distance in every substep, instead of those of a Contacts (which must
  // then be null). Their gradient follows the closest point and the normal. Likewise of bodies with
  // infinite planes of the world (diff_rigid_bodies.h).
  bool enable_static_contacts = false;
  float static_contact_margin = 0.0f;  // m, >= 0: how far a static contact is looked for
  // As SemiImplicitOptions::particle_kf_bound: the largest kf dt/m of contacts of particles.
  float particle_kf_bound = 1.0f;
  bool enable_rigid = true;                         // bodies move
  bool enable_rigid_contacts = true;                // their contacts act
  float angular_damping = 0.05f;                    // 1/s, of bodies
  FrictionLaw friction_law = FrictionLaw::Viscous;  // of their contacts; or Huber
  // m/s, of the law huber: 0.1 when empty. ErrorKind::Value with viscous.
  std::optional<float> friction_smoothing = {};
  // Of their contacts. The gradient of the mean is that of the motion.
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
  bool enable_joints = true;  // bodies are held by their joints
  // Of joints: N/m and N*m/rad; N*s/m, and 0.01 of it N*m*s/rad.
  float joint_attach_ke = 1.0e4f, joint_attach_kd = 1.0e2f;
  bool strict = true;  // refuse what is not covered instead of leaving it out
  // What gradients follow where contacts begin and end (diff_touches.h); states are the same.
  DerivativeOf contact_gradient = DerivativeOf::Code;
};

// One step runs generated kernels: the forces of springs, triangles, bending edges and tetrahedra
// (two kernels for each kind that is enabled and there), of contacts, then integration. Forces are
// added to state_in.particle_f in the order of SolverSemiImplicit, and the result has its bits.
// Inside an active nova::Tape the kernels are recorded on the states' own arrays; outside they just
// run.
//
// Joints are springs and dampers (diff_joints.h), two kernels for all of them. Forces and targets
// are the control's, or the model's without one.
//
// Bodies move by one kernel more (step_rigid_bodies_with_static_contacts), and two for the contacts
// of shapes in a Contacts, three for those of particles with shapes of bodies. body_f is only read.
// Where contacts move with the bodies, `rollout` takes a pipeline and finds them anew in every
// step.
//
// Gradients: positions, velocities, applied forces, masses, radii, gravity, contact materials,
// activations and all materials, rest lengths and rest angles of elements, and what diff_joints.h
// lists of joints, are exact. Points and
// normals of contacts of particles are frozen; those of static contacts are exact. Those between
// bodies follow the poses where contact_gradients.h says so, if the contacts are found from the
// state of the step: by `rollout` with a pipeline, and in `step`, whose contacts are taken to be
// those of state_in. `rollout` with one Contacts for all steps holds them all, as it does forward.
// See diff_elements.h, diff_soft_contacts.h, diff_particles.h and, for bodies, diff_rigid_bodies.h
// and diff_body_contacts.h.
//
// Under `strict` a model whose elements would be left out is refused: the element kind must be
// enabled, unless it exerts no force (all its stiffness, damping, drag and lift are 0 when the
// solver is made; so it is with the bending edges that add_soft_grid makes). So is a step without
// contacts of a model with shapes that particles collide with when the solver is made: it needs a
// Contacts, enable_static_contacts, or enable_particle_contacts = false. So is a model with bodies
// that would not move (enable_rigid false), or whose shapes may meet while enable_static_contacts
// is false, unless enable_rigid_contacts is false too.
//
// A dt that is too long for the stiffness of contacts of bodies warns, once, as in
// SolverSemiImplicit; with enable_static_contacts as far as one row of a pair says. So does one at
// which a particle diverges by its elements or a contact (needed_particle_dt). Not in captures.
//
// The forces that a step leaves in state_in.particle_f are for reading. Using them as input of
// another recorded step raises: clear_forces() first.
class NOVAPHY_DIFF_API DiffSemiImplicitSolver : public DiffSolverBase {
 public:
  // ErrorKind::NotImplemented: the friction laws newton17 and newton18, which have no gradient
  // here; DerivativeOf::Motion of a model on a device, or with enable_static_contacts. Steps with
  // the latter raise inside a ScopedCapture.
  explicit DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                  const DiffSolverConfig& config = {});

  const DiffSolverConfig& config() const { return config_; }
  // What the gradients are of the last steps on a tape, each of which started where the one before
  // ended; of a capture, of its last replay. ErrorKind::Runtime inside of one.
  GradientInfo gradient_info() const;
  void clear_gradient_info() {
    notes_.clear();
    touches_.clear();
  }

  // The activations of triangles and tetrahedra are the control's, or the model's without one.
  // Errors as SolverBase::step; ErrorKind::Runtime inside a ScopedCapture, and under `strict` for
  // contacts that overflowed their slots.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // As SolverSemiImplicit::stable_dt: the longest dt (s) for elements and for what touches in
  // `state`. Without contacts, static ones are one of each particle with each of its shapes.
  float stable_dt(const SimState& state, const Contacts& contacts) const;
  float stable_dt(const SimState& state) const;
  bool supports_graph_capture() const override {
    return false;
  }  // of step; rollout may be captured

  // rollout: contacts and integration in one kernel per step, after those of the elements.

 protected:
  std::vector<ScratchSpec> step_scratch() const override;
  bool step_writes_kept_memory() const override;
  bool only_submits() const override { return motion_ == nullptr; }
  bool begin_rollout(const RolloutInputs& inputs) override;
  void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                   StepScratch scratch) override;

 private:
  void check_elements() const;
  void check_bodies() const;
  // `found`: a pipeline finds the contacts of every step.
  void check_contacts(const char* function, const Contacts* contacts, bool found) const;
  static void check_overflow(const Contacts& contacts);
  void begin(const char* function, const Control* control, const Contacts* contacts, bool found,
             bool of_this_state, float dt);
  struct Witness;
  std::shared_ptr<Witness> witness();
  // On a tape, where gradients follow the motion; else nothing.
  std::optional<TouchedStep> begin_touches(const SimState& in, SimState& out,
                                           const nova::Operand& forces,
                                           const nova::Operand& body_forces, const Control* control,
                                           const Contacts* contacts, float dt);
  void note_step(const SimState& in, const SimState& out, const Contacts* contacts,
                 const ContactTables& tables, float dt, bool keeps);
  bool moves_particles() const;
  bool moves_bodies() const;
  ParticleForces particle_forces(bool contacts) const;
  ContactTables::Wanted wanted_tables() const;
  DiffSolverConfig config_;
  // Under strict: the number of shapes that particles collide with, which need a Contacts to act.
  int32_t uncovered_shapes_ = 0;
  bool needs_pairs_ = false;
  ParticleStep particles_;
  ParticleWatch particle_watch_{"DiffSemiImplicitSolver"};
  BodyStep bodies_;
  std::optional<DiffJoints> joints_;  // null: they are left out
  UnsupportedMaterials materials_;    // adhesion is of contacts of bodies
  float friction_smoothing_;          // m/s, 0 with the law viscous
  EditedValues values_{"DiffSemiImplicitSolver"};
  GradientNotes notes_;
  std::weak_ptr<Witness> witness_;
  TouchList touches_;
  std::unique_ptr<TouchMotion> motion_;  // null: gradients of the code
  ContactTables tables_;                 // of contacts that are given
  DeviceArray<SpatialVectorf> body_f_;   // of step: with the wrenches of contacts
};

}  // namespace novaphy::diff
