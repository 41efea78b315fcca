// DiffSemiImplicitSolver: the step of SolverSemiImplicit as generated kernels, recorded on a tape.
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
  // Whether each substep finds static contacts itself. These are contacts of particles with planes,
  // boxes, spheres, capsules, cylinders, cones and ellipsoids of the world, and contacts of bodies
  // with infinite planes of the world (diff_rigid_bodies.h). They replace a Contacts, which must
  // then be null. The gradient follows the closest point and the normal.
  bool enable_static_contacts = false;
  // m, >= 0: the distance up to which static contacts are found
  float static_contact_margin = 0.0f;
  // The largest kf dt/m of contacts of particles, as in SemiImplicitOptions::particle_kf_bound.
  float particle_kf_bound = 1.0f;
  bool enable_rigid = true;                         // whether bodies move
  bool enable_rigid_contacts = true;                // whether contacts of bodies act
  float angular_damping = 0.05f;                    // 1/s, for bodies
  FrictionLaw friction_law = FrictionLaw::Viscous;  // for contacts of bodies; Viscous or Huber
  // The slip speed (m/s) below which the friction law Huber is smooth; 0.1 if empty. With the law
  // Viscous a value is an error (ErrorKind::Value).
  std::optional<float> friction_smoothing = {};
  // The law of contacts of bodies. With Mean, the gradient is that of the motion.
  PenaltyLaw penalty_law = PenaltyLaw::Sampled;
  bool enable_joints = true;  // whether joints act on bodies
  // Stiffness of joints (N/m, and the same number in N*m/rad) and damping (N*s/m, and 0.01 times
  // the number in N*m*s/rad).
  float joint_attach_ke = 1.0e4f, joint_attach_kd = 1.0e2f;
  bool strict = true;  // refuses unsupported parts of a model instead of leaving them out
  // Whether the gradient includes the times at which contacts begin and end (diff_touches.h). The
  // states do not depend on this option.
  DerivativeOf contact_gradient = DerivativeOf::Auto;
};

// One step runs generated kernels: the forces of springs, triangles, bending edges and tetrahedra
// (two kernels for each kind that is enabled and present), of contacts, then the integration.
// Forces are added to state_in.particle_f in the order of SolverSemiImplicit. The result has the
// bits of that solver. An active nova::Tape records the kernels on the states' own arrays. Without
// a tape they only run.
//
// Joints are springs and dampers (diff_joints.h), two kernels for all joints. Forces and targets
// come from the control, or from the model without one.
//
// Bodies take one more kernel (step_rigid_bodies_with_static_contacts). The contacts of shapes in a
// Contacts take two, and those of particles with shapes of bodies three. A step only reads body_f.
// `rollout` takes a pipeline that finds the contacts of every step.
//
// Exact gradients: positions, velocities, applied forces, masses, radii, gravity, contact
// materials, activations, all materials, rest lengths and rest angles of elements, and the inputs
// of joints that diff_joints.h lists. Static contacts have exact points and normals. Points and
// normals of contacts of particles in a Contacts are frozen.
//
// Contacts between bodies follow the poses where contact_gradients.h says so, if they were found
// from the state of the step. This holds in `rollout` with a pipeline, and in `step` if the
// contacts are those of state_in. `rollout` with one Contacts for all steps freezes all contacts,
// as it does forward. See diff_elements.h, diff_soft_contacts.h, diff_particles.h and, for bodies,
// diff_rigid_bodies.h and diff_body_contacts.h.
//
// `strict` refuses three things:
// - a model with a kind of element that is not enabled, unless the elements exert no force: their
// stiffness, damping, drag and lift are 0 when the solver is made, as for the bending edges of
// add_soft_grid;
// - a step without contacts of a model with shapes that particles collide with when the solver is
// made, unless enable_static_contacts is true or enable_particle_contacts is false;
// - a model with bodies that would not move (enable_rigid false), or whose shapes may meet although
// enable_static_contacts is false, unless enable_rigid_contacts is false too.
//
// A dt that is too long for the stiffness of contacts of bodies warns once, as in
// SolverSemiImplicit. With enable_static_contacts the check looks at one row of a pair. A dt at
// which a particle diverges by its elements or a contact warns too (needed_particle_dt). Captures
// do not warn.
//
// A step leaves forces in state_in.particle_f for reading. They may not be the input of another
// recorded step, which raises: call clear_forces() first.
class NOVAPHY_DIFF_API DiffSemiImplicitSolver : public DiffSolverBase {
 public:
  // ErrorKind::NotImplemented: the friction laws newton17 and newton18, which have no gradient
  // here, or DerivativeOf::Motion for a model on a device, with enable_static_contacts or with
  // PenaltyLaw::Mean. Inside a ScopedCapture, steps with DerivativeOf::Motion throw. In all these
  // cases DerivativeOf::Auto gives the derivative of the code.
  explicit DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                  const DiffSolverConfig& config = {});

  const DiffSolverConfig& config() const { return config_; }
  // Describes the gradients of the last consecutive steps on a tape, where each step started from
  // the state in which the previous step ended. For a capture, describes the last replay.
  // ErrorKind::Runtime: a call inside a capture.
  GradientInfo gradient_info() const;
  void clear_gradient_info() {
    notes_.clear();
    touches_.clear();
  }

  // The activations of triangles and tetrahedra come from the control, or from the model without
  // one. Errors: as for SolverBase::step. ErrorKind::Runtime: a call inside a ScopedCapture, or
  // under `strict` contacts that overflowed their slots.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // Returns the longest stable dt (s) for elements and for contacts that touch in `state`, as
  // SolverSemiImplicit::stable_dt. Without contacts, each particle counts as touching each of its
  // static shapes.
  float stable_dt(const SimState& state, const Contacts& contacts) const;
  float stable_dt(const SimState& state) const;
  bool supports_graph_capture() const override {
    return false;
  }  // step cannot be captured; rollout can

  // Functions that DiffSolverBase calls. In a rollout, contacts and integration are one kernel per
  // step, after the kernels of the elements.

 protected:
  std::vector<ScratchSpec> step_scratch() const override;
  bool step_writes_kept_memory() const override;
  bool only_submits() const override {
    return motion_ == nullptr || nova::Tape::active() == nullptr;
  }
  bool begin_rollout(const RolloutInputs& inputs) override;
  void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                   StepScratch scratch) override;

 private:
  void check_elements() const;
  void check_bodies() const;
  // `found`: whether a pipeline finds the contacts of every step.
  void check_contacts(const char* function, const Contacts* contacts, bool found) const;
  static void check_overflow(const Contacts& contacts);
  void begin(const char* function, const Control* control, const Contacts* contacts, bool found,
             bool of_this_state, float dt);
  struct Witness;
  std::shared_ptr<Witness> witness();
  // Returns nothing without a tape, or if gradients do not include the times of contacts.
  std::optional<TouchedStep> begin_touches(const SimState& in, SimState& out,
                                           const nova::Operand& forces,
                                           const nova::Operand& body_forces, const Control* control,
                                           const Contacts* contacts, float dt);
  // Records a step for gradient_info. The kernels of the step read `from`, which is `in` or its
  // copy. `wrench` is the memory of the sum of wrenches.
  void note_step(const SimState& in, const SimState& from, const SimState& out,
                 const Contacts* contacts, const ContactTables& tables, const nova::Operand& wrench,
                 float dt, bool keeps);
  // Returns MotionCounts::held of all steps, or null.
  const char* without_motion() const;
  // Returns the name of the solver with the setting that AdjointRecord does not support, or null if
  // the record supports all settings.
  const char* without_record() const;
  bool moves_particles() const;
  bool moves_bodies() const;
  ParticleForces particle_forces(bool contacts) const;
  ContactTables::Wanted wanted_tables() const;
  DiffSolverConfig config_;
  // With `strict`: the number of shapes with which particles collide and which need a Contacts.
  int32_t uncovered_shapes_ = 0;
  bool needs_pairs_ = false;
  ParticleStep particles_;
  ParticleWatch particle_watch_{"DiffSemiImplicitSolver"};
  BodyStep bodies_;
  std::optional<DiffJoints> joints_;  // empty: joints are left out
  UnsupportedMaterials materials_;    // adhesion is supported between bodies only
  float friction_smoothing_;          // m/s; 0 for the law Viscous
  EditedValues values_{"DiffSemiImplicitSolver"};
  GradientNotes notes_;
  std::weak_ptr<Witness> witness_;
  TouchList touches_;
  std::unique_ptr<TouchMotion> motion_;  // null: gradients do not include times of contacts
  ContactTables tables_;                 // tables of a given Contacts
  DeviceArray<SpatialVectorf> body_f_;   // for step: body_f plus the wrenches of contacts
};

}  // namespace novaphy::diff
