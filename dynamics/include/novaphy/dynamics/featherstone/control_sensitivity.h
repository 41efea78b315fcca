// FeatherstoneAnalyticControlSensitivity: how an articulation that SolverFeatherstone moves, and a
// point of it, change with parameters of its control.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

// What the parameters move.
enum class ControlKind : uint8_t {
  Position,  // joint_target_q
  Torque,    // joint_f
};

struct ControlSensitivityOptions {
  int32_t articulation = 0;
  int32_t parameter_count = 1;
  int32_t point_body = 0;  // a body of the articulation
  Vec3f point_local = {};  // m, in its frame
  ControlKind kind = ControlKind::Position;
  bool exact = true;
  // Of a solver with contact "pgs": changes of rates keep to the null space of the normals that
  // push. Not with exact.
  bool contact_projection = false;
  FeatherstoneOptions solver = {};  // of the solver that steps
};

// Parameters of any kind (key poses, a spline, gains, a network) enter by the change dcontrol
// {dofs, parameters} of the control with them, given for every step; where the control depends on
// the state, dcontrol holds that part too, by dq and dqd. From 0 at reset the changes dq and dqd of
// the state are carried along through the mass matrix, the implicit response of drives and the
// branches of every step (articulation/control_sensitivity.h).
//
// Gradient: "frozen": mass matrix, bias (so the stiffness of gravity too), wrenches and the turning
// of the point's Jacobian are not differentiated. "exact": they are, by forward derivatives of the
// step; exact where no limit or clamp is just reached. On a chain of prismatic joints both are the
// same. With contact_projection: "frozen", dv' <- (1 - M^-1 N^T (N M^-1 N^T)^-1 N) dv' behind the
// drives and before the velocity clamp, N the rows of the normals that push in the step, taken as
// they are: which ones push, where, and friction are not differentiated, and soft contacts are as
// hard as others.
//
// FIXED, PRISMATIC and REVOLUTE joints, and for torques a FREE joint at the root (dcontrol of its
// dofs is a world wrench about the center of mass): other joints are ErrorKind::NotImplemented.
class NOVAPHY_DYNAMICS_API FeatherstoneAnalyticControlSensitivity {
 public:
  // ErrorKind::Value, ErrorKind::Index: an argument out of its range; ErrorKind::NotImplemented: a
  // joint or a device that is not covered, contact_projection with exact.
  FeatherstoneAnalyticControlSensitivity(std::shared_ptr<const Model> model,
                                         const ControlSensitivityOptions& options);
  ~FeatherstoneAnalyticControlSensitivity();
  FeatherstoneAnalyticControlSensitivity(const FeatherstoneAnalyticControlSensitivity&) = delete;
  FeatherstoneAnalyticControlSensitivity& operator=(const FeatherstoneAnalyticControlSensitivity&) =
      delete;

  const std::shared_ptr<const Model>& model() const;
  const ControlSensitivityOptions& options() const;
  int32_t dof_count() const;  // of the articulation
  const char* label() const { return options().exact ? "exact" : "frozen"; }

  // The start, which does not depend on the parameters.
  void reset(const SimState& state);
  // After the solver's step from state_in to state_out with this control and dt. dcontrol:
  // row-major {dofs, parameters}, of joint_target_q (rad, m) or joint_f (N m, N) per unit of the
  // parameter; dtarget_qd likewise of joint_target_qd, or empty. It runs the step's own code again,
  // so with the solver's bits. `contacts`, with contact_projection: those of the step, with the
  // forces that it wrote; of other articulations only what does not move may push back
  // (ErrorKind::NotImplemented). ErrorKind::Value: another size, a number that is not finite, a
  // change of a target that no drive follows, contacts without contact_projection;
  // ErrorKind::Index: contacts of shapes that are not there; ErrorKind::Runtime: without reset, a
  // state_in that is not where the last one ended, a state_out that the step does not give (another
  // solver, control, dt or contacts; where contacts push, rates to 1e-5 of what they are made of).
  // Nothing has changed then.
  void step(const SimState& state_in, const SimState& state_out, const Control* control, float dt,
            std::span<const float> dcontrol, std::span<const float> dtarget_qd = {},
            const Contacts* contacts = nullptr);

  // Row-major. Tangents of dofs: of a FREE joint the center of mass and the turn about it.
  std::vector<float> dq() const;                       // {dofs, parameters}
  std::vector<float> dqd() const;                      // {dofs, parameters}
  std::vector<float> point_jacobian() const;           // {3, parameters}, m per unit, world
  std::vector<float> point_velocity_jacobian() const;  // {3, parameters}, m/s per unit, world
  Vec3f point() const;                                 // m, world
  Vec3f point_velocity() const;                        // m/s, world

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace novaphy
