// SolverFeatherstone: articulated bodies in the coordinates of their joints.
#pragma once

#include <memory>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// All numbers finite and >= 0.
struct FeatherstoneOptions {
  float angular_damping = 0.05f;  // 1/s, of angular dofs: velocities times 1 - dt angular_damping
  // Drives, limits and damping of the end of the step, stable for any gains, with limits that only
  // push. False: those of its start, and limits that also pull, as Newton 1.8.
  bool implicit_drives = true;
};

// Covers joints of the types PRISMATIC, REVOLUTE, BALL, FIXED, FREE and D6 in articulations, in any
// order with parents first: drives by target mode, limits, effort and velocity limits, damping,
// armature, joint forces, wrenches on bodies (body_f, and joint_f of FREE joints: world axes, about
// the centre of mass), gravity, angular damping. Other parts of a model throw
// ErrorKind::NotImplemented; there are no contacts yet.
//
// One step: articulation/step.h. It reads joint_q and joint_qd of state_in and body_f, and writes
// joint_q, joint_qd, body_q and body_qd of state_out. Articulations move the same, to the bit,
// wherever they stand and however many threads there are. No memory is allocated in a step. Inside an
// active nova::Tape a step runs and is not recorded: what it wrote may be no input there, unless
// diff::record_planar_2r_featherstone_step records it. DiffFeatherstoneSolver is the differentiable
// one.
class NOVAPHY_DYNAMICS_API SolverFeatherstone : public SolverBase {
 public:
  // ErrorKind::Value: a bad option; ErrorKind::NotImplemented: what is not covered.
  explicit SolverFeatherstone(std::shared_ptr<const Model> model,
                              const FeatherstoneOptions& options = {});
  ~SolverFeatherstone() override;

  const FeatherstoneOptions& options() const { return options_; }

  // Besides the errors of SolverBase::step: ErrorKind::NotImplemented for contacts, and for a value
  // without effect (joint_friction, joint_enabled, joint_act, ...); ErrorKind::Runtime, naming the
  // dof, where the mass matrix is singular or an acceleration is not finite: the articulation keeps
  // its rows of state_out.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  void notify_model_changed(ModelFlags flags) override;

 private:
  struct Cache;
  void make_cache();

  FeatherstoneOptions options_;
  std::unique_ptr<Cache> cache_;
};

}  // namespace novaphy
