// FeatherstoneAnalyticControlSensitivity: the sensitivity of an articulation in SolverFeatherstone,
// and of one of its points, to parameters of its control.
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

// The controlled quantity.
enum class ControlKind : uint8_t {
  Position,  // joint_target_q
  Torque,    // joint_f
};

struct ControlSensitivityOptions {
  int32_t articulation = 0;
  int32_t parameter_count = 1;
  int32_t point_body = 0;  // body of the point, in the articulation
  Vec3f point_local = {};  // m, point in the body's frame
  ControlKind kind = ControlKind::Position;
  bool exact = true;
  // For a solver with contact "pgs": projects changes of rates to the null space of the pushing
  // normals. Not allowed with `exact`.
  bool contact_projection = false;
  FeatherstoneOptions solver = {};  // options of the stepping solver
};

// Parameters of any kind (key poses, a spline, gains, a network) enter by the derivative dcontrol
// {dofs, parameters} of the control, given for every step. If the control depends on the state,
// dcontrol must include this part, by dq and dqd. The changes dq and dqd of the state start at 0 in
// reset. Every step propagates them through the mass matrix, the implicit response of drives and
// the branches (articulation/control_sensitivity.h).
//
// Gradient. "frozen": the mass matrix, the bias (including the stiffness of gravity), wrenches and
// the rotation of the point's Jacobian are not differentiated. "exact": they are, by tangents of
// the step; exact where no limit or clamp is just reached. On a chain of prismatic joints both
// agree. With contact_projection: "frozen" with dv' <- (1 - M^-1 N^T (N M^-1 N^T)^-1 N) dv' after
// the drives and before the velocity clamp. N are the rows of the pushing normals, held constant.
// The set of pushing contacts, their points and friction are not differentiated, and soft contacts
// count as hard.
//
// Supported joints: FIXED, PRISMATIC and REVOLUTE, and for torques a FREE root joint (whose
// dcontrol is a world wrench about the center of mass). Other joints throw
// ErrorKind::NotImplemented.
class NOVAPHY_DYNAMICS_API FeatherstoneAnalyticControlSensitivity {
 public:
  // ErrorKind::Value, ErrorKind::Index: an argument is out of range. ErrorKind::NotImplemented: an
  // unsupported joint or device, or contact_projection with `exact`.
  FeatherstoneAnalyticControlSensitivity(std::shared_ptr<const Model> model,
                                         const ControlSensitivityOptions& options);
  ~FeatherstoneAnalyticControlSensitivity();
  FeatherstoneAnalyticControlSensitivity(const FeatherstoneAnalyticControlSensitivity&) = delete;
  FeatherstoneAnalyticControlSensitivity& operator=(const FeatherstoneAnalyticControlSensitivity&) =
      delete;

  const std::shared_ptr<const Model>& model() const;
  const ControlSensitivityOptions& options() const;
  int32_t dof_count() const;  // dofs of the articulation
  const char* label() const { return options().exact ? "exact" : "frozen"; }

  // Sets the initial state, which does not depend on the parameters.
  void reset(const SimState& state);
  // Propagates the changes over a step of the solver from state_in to state_out with this control
  // and dt. dcontrol: row-major {dofs, parameters}, change of joint_target_q (rad, m) or joint_f (N
  // m, N) per unit of the parameter. dtarget_qd: the same for joint_target_qd, or empty.
  // `contacts`, with contact_projection: those of the step, with the forces that it wrote. The
  // step's own code runs again, with the solver's bits. After an error nothing has changed.
  //   ErrorKind::Value           another size, a number that is not finite, a change of a target
  //                              without a drive, contacts without contact_projection
  //   ErrorKind::Index           contacts of shapes that do not exist
  //   ErrorKind::NotImplemented  a contact with another articulation that moves
  //   ErrorKind::Runtime         no reset, a state_in that is not the last state_out, a state_out
  //                              that the step does not reproduce (another solver, control, dt or
  //                              contacts; with pushing contacts, rates are compared to 1e-5 of
  //                              their terms)
  void step(const SimState& state_in, const SimState& state_out, const Control* control, float dt,
            std::span<const float> dcontrol, std::span<const float> dtarget_qd = {},
            const Contacts* contacts = nullptr);

  // Results, row-major. Tangents of dofs; for a FREE joint, those of the center of mass and of the
  // rotation about it.
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
