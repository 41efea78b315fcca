// SolverFeatherstone: articulated bodies in the coordinates of their joints.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/sleep.h"
#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

struct ArticulationStepArguments;

// How articulations meet each other and the world.
enum class ArticulationContact {
  None,     // contacts raise
  Pgs,      // articulation/pgs.h: impulses that keep gaps open and friction in its cone
  Penalty,  // semi_implicit/rigid_contact_trace.h (law huber): explicit springs, as Newton
};
enum class FrictionCone { Cone, Pyramid };

// All numbers finite and >= 0. What only one way of contact reads must have its default in the
// others.
struct FeatherstoneOptions {
  float angular_damping = 0.0f;  // 1/s, of angular dofs: velocities times 1 - dt angular_damping
  // Drives, limits and damping of the end of the step, stable for any gains, with limits that only
  // push. False: those of its start, and limits that also pull, as Newton 1.8.
  bool implicit_drives = true;
  ArticulationContact contact = ArticulationContact::Pgs;
  // Of Pgs:
  FrictionCone friction_cone = FrictionCone::Cone;
  int32_t pgs_iterations = 30;               // sweeps at most, >= 1
  float pgs_tolerance = 1e-6f;               // m/s: an island ends when a sweep changes less
  float pgs_erp = 0.2f;                      // the part of an overlap that a step takes away
  float pgs_slop = 0.005f;                   // m, an overlap that stays
  float pgs_cfm = 0.0f;                      // (m/s) / (N s), softness of contacts
  float max_depenetration_velocity = 10.0f;  // m/s
  float restitution_threshold = 0.2f;        // m/s: slower approaches do not bounce
  bool warm_start = true;  // from the impulses of the step before, by pair of shapes and point id
  // Overlaps push by shape_material_ke and _kd, instead of by pgs_erp.
  bool compliant_contacts = false;
  // Of Penalty: m/s, below which friction is smoothed.
  float friction_smoothing = 0.1f;
  // Islands of bodies on FREE joints that rest keep their bits (core/sim/sleep.h), on the CPU, with
  // Pgs or None. Bodies of other articulations never sleep. Empty: none sleeps.
  std::optional<SleepConfig> sleep = {};
};

// Covers joints of all types but DISTANCE in articulations, in any order with parents first: drives
// by target mode, limits, effort and velocity limits, damping, armature, joint forces, wrenches on
// bodies (body_f, and joint_f of FREE joints: world axes, about the center of mass), gravity,
// angular damping, dry friction (joint_friction), and contacts of the shapes of articulations with
// each other and the world. Friction, restitution, stiffness and damping of a contact are the mean
// of the two shapes'. Kinematic bodies, with a joint FREE or FIXED to the world, follow their
// joint_qd; their mass has no end. Other parts of a model throw ErrorKind::NotImplemented.
//
// One step: articulation/step.h, with Pgs between velocities and positions; rigid_contact_force of
// the contacts is then their mean force over the step. It reads joint_q and joint_qd of state_in
// and body_f, and writes joint_q, joint_qd, body_q and body_qd of state_out. Articulations move the
// same, to the bit, wherever they stand and however many threads there are. No memory is allocated
// in a step. Inside an active nova::Tape a step runs and is not recorded: what it wrote may be no
// input there, unless diff::record_planar_2r_featherstone_step records it. DiffFeatherstoneSolver
// is the differentiable one.
//
// A model on a device is stepped there with the bits of the cpu, by launches, which a capture
// records; contacts by Penalty throw ErrorKind::NotImplemented. With contacts or dry friction a
// thread steps a world (all of them where an articulation belongs to all), in memory that the first
// step with contacts takes, and a later one with a larger capacity, which also forgets impulses.
// Nobody waits for it: an articulation that fails, and with rows its island, gets NaN, and
// check_last_step says why.
class NOVAPHY_DYNAMICS_API SolverFeatherstone : public SolverBase {
 public:
  // ErrorKind::Value: a bad option; ErrorKind::NotImplemented: what is not covered.
  explicit SolverFeatherstone(std::shared_ptr<const Model> model,
                              const FeatherstoneOptions& options = {});
  ~SolverFeatherstone() override;

  const FeatherstoneOptions& options() const { return options_; }

  // Besides the errors of SolverBase::step: ErrorKind::Value for contacts without a way of contact;
  // ErrorKind::NotImplemented for a value without effect (joint_enabled, joint_act, rolling
  // friction of shapes that may meet, ...); ErrorKind::Index: contacts of shapes that are not
  // there; ErrorKind::Runtime, naming the dof, where the mass matrix is singular or an acceleration
  // is not finite: the articulation keeps its rows of state_out.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // False on the cpu.
  bool supports_graph_capture() const override { return !device().is_cpu(); }
  // Of a model on a device: waits for the last step or replay. ErrorKind::Runtime where it failed,
  // naming the dof as step does on the cpu; ErrorKind::Index for a row of the contacts that names
  // no shape, or joins two worlds.
  void check_last_step() const;
  // Also forgets the impulses that a step starts from, those of captured steps too. What else was
  // read from the model stays in captures as it was when they were made; check_last_step,
  // pgs_sweeps and pgs_residual speak of steps and captures made since.
  void notify_model_changed(ModelFlags flags) override;
  // Of the last step: the most sweeps of an island, and the largest change of velocity (m/s) of a
  // last sweep. 0 without rows.
  int32_t pgs_sweeps() const;
  float pgs_residual() const;

 private:
  struct Cache;
  void make_cache();
  void finish(const Contacts* contacts, const Control* control, const SimState& from, SimState& to,
              float dt);
  void add_penalties(const Contacts& contacts, ArticulationStepArguments& arguments);

  FeatherstoneOptions options_;
  std::unique_ptr<Cache> cache_;
};

}  // namespace novaphy
