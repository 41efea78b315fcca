// SolverFeatherstone: articulated bodies in generalized coordinates.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/sleep.h"
#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

struct ArticulationStepArguments;

// The contact model for contacts between articulations and with the world.
enum class ArticulationContact {
  None,     // a step with contacts throws
  Pgs,      // impulse contacts with a friction cone (articulation/pgs.h)
  Penalty,  // explicit penalty contacts, as in Newton (the Huber law of
            // semi_implicit/rigid_contact_trace.h)
};
enum class FrictionCone { Cone, Pyramid };
// The law of position limits of one-dof joints.
enum class JointLimits {
  Spring,  // a spring (joint_limit_ke, _kd) acts while the dof is outside of the limits
  Row      // a constraint row, as the normal of a contact (articulation/rate_bounds.h)
};

// All numbers are finite and >= 0. Options of a contact model that is not selected must have their
// defaults.
struct FeatherstoneOptions {
  float angular_damping = 0.0f;  // 1/s, scales angular velocities by 1 - dt angular_damping
  // Whether drives, limits and damping act at the end of the step. Then any gains are stable, and
  // limits only push. False: they act at the start of the step, and limits may pull, as in Newton
  // 1.8.
  bool implicit_drives = true;
  JointLimits joint_limits = JointLimits::Spring;
  float joint_limit_restitution = 0.0f;  // 0 to 1, of Row: for approaches above the threshold
  ArticulationContact contact = ArticulationContact::Pgs;
  // Options of Pgs:
  FrictionCone friction_cone = FrictionCone::Cone;
  int32_t pgs_iterations = 30;               // largest number of sweeps, >= 1
  float pgs_tolerance = 1e-6f;               // m/s: sweeps end when they change less
  float pgs_erp = 0.2f;                      // fraction of an overlap that a step corrects
  float pgs_slop = 0.005f;                   // m, overlap that is not corrected
  float pgs_cfm = 0.0f;                      // (m/s) / (N s), softness of contacts
  float max_depenetration_velocity = 10.0f;  // m/s
  // m/s, for joint limits also rad/s: slower approaches do not bounce.
  float restitution_threshold = 0.2f;
  bool warm_start = true;  // start from the last step's impulses, matched by shapes and point id
  // Whether shape_material_ke and _kd correct overlaps, instead of pgs_erp.
  bool compliant_contacts = false;
  // Option of Penalty: slip speed (m/s) below which friction is smoothed.
  float friction_smoothing = 0.1f;
  // Islands of resting bodies on FREE joints fall asleep: their state keeps its bits
  // (core/sim/sleep.h). CPU only, with Pgs or None. Bodies on other joints never sleep. Empty: no
  // body sleeps.
  std::optional<SleepConfig> sleep = {};
};

// Supported features: all joint types except DISTANCE, in articulations with parents before
// children; drives by target mode; limits, effort and velocity limits; damping, armature and joint
// forces; wrenches on bodies (body_f, and joint_f of FREE joints: world axes, about the center of
// mass); gravity; angular damping; dry friction (joint_friction); contacts between articulations
// and with the world. Friction, restitution, stiffness and damping of a contact are the means over
// the two shapes. A kinematic body has a joint FREE or FIXED to the world, follows its joint_qd and
// has infinite mass. Other features throw ErrorKind::NotImplemented.
//
// articulation/step.h describes one step. Pgs contacts act between the update of the velocities and
// that of the positions; rigid_contact_force is then the mean force over the step. A step reads
// joint_q, joint_qd and body_f of state_in, and writes joint_q, joint_qd, body_q and body_qd of
// state_out. The motion of an articulation has the same bits at any position and for any number of
// threads. A step allocates no memory. A step inside of an active nova::Tape is not recorded, so
// its results may not be inputs of recorded operations. diff::record_planar_2r_featherstone_step
// and DiffFeatherstoneSolver record steps.
//
// A model on a device is stepped there by launches with the bits of the CPU. A capture records the
// launches. Penalty contacts throw ErrorKind::NotImplemented there. With contacts or dry friction
// one thread steps a world, or all worlds if an articulation belongs to all. The first step with
// contacts allocates memory. A later step with a larger contact capacity allocates again and drops
// the impulses for the warm start. The host does not wait for a step. If an articulation fails, its
// state becomes NaN. With contacts the state of its whole island becomes NaN. check_last_step gives
// the reason.
class NOVAPHY_DYNAMICS_API SolverFeatherstone : public SolverBase {
 public:
  // ErrorKind::Value: a bad option. ErrorKind::NotImplemented: an unsupported feature.
  explicit SolverFeatherstone(std::shared_ptr<const Model> model,
                              const FeatherstoneOptions& options = {});
  ~SolverFeatherstone() override;

  const FeatherstoneOptions& options() const { return options_; }

  // Errors besides those of SolverBase::step:
  //   ErrorKind::Value           contacts with contact model None
  //   ErrorKind::NotImplemented  a value without effect, for example joint_enabled, joint_act, or
  //                              rolling friction of shapes that may touch
  //   ErrorKind::Index           contacts of shapes that do not exist
  //   ErrorKind::Runtime         with the dof: the mass matrix is singular, or an acceleration is
  //                              not finite; the articulation's rows of state_out are unchanged
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  // Returns true for models on devices, false on the CPU.
  bool supports_graph_capture() const override { return !device().is_cpu(); }
  // Waits for the last step or replay of a model on a device. ErrorKind::Runtime: the step failed;
  // the message has the dof, as for a step on the CPU. ErrorKind::Index: a contact names a shape
  // that does not exist, or connects two worlds.
  void check_last_step() const;
  // Besides the base class's work, drops the impulses for the warm start, including those of
  // captured steps. Captures keep all other values that they read from the model. check_last_step,
  // pgs_sweeps and pgs_residual then refer to later steps and captures only.
  void notify_model_changed(ModelFlags flags) override;
  // Largest number of sweeps over the islands of the last step, and the largest change of velocity
  // (m/s) in a last sweep. Both are 0 without contact rows.
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
