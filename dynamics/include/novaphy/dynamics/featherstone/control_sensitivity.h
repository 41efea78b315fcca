// FeatherstoneAnalyticControlSensitivity: derivatives of the state of an articulation in
// SolverFeatherstone, and of a point on it, by parameters of its control.
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

// The array of the control that depends on the parameters.
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
  // Removes changes of rates along the normals of active contacts. For a solver with contact "pgs".
  // Not allowed with `exact`.
  bool contact_projection = false;
  FeatherstoneOptions solver = {};  // options of the stepping solver
};

// Propagates the derivatives dq and dqd of the state by the parameters through the steps of a
// rollout. The parameters may be of any kind (key poses, a spline, gains, a network). For every
// step the caller gives the derivative dcontrol {dofs, parameters} of the control. If the control
// depends on the state, dcontrol must include that dependence, through dq and dqd. reset sets dq
// and dqd to 0. Each step uses the mass matrix, the implicit response of drives and the active
// branches (articulation/control_sensitivity.h).
//
// Gradient. "frozen": the mass matrix, the bias (including the stiffness of gravity), wrenches and
// the rotation of the point's Jacobian are not differentiated. "exact": all of these are
// differentiated by tangents of the step. The result is exact where no limit or clamp is just
// reached. On a chain of prismatic joints both labels give the same result.
//
// contact_projection is "frozen" with one more step between the drives and the velocity clamp: the
// change dv' of the new rates becomes (1 - M^-1 N^T (N M^-1 N^T)^-1 N) dv'. N has the rows of the
// active normals, which are constant. The set of active contacts, their points and friction are not
// differentiated, and compliant contacts count as rigid.
//
// Supported joints: FIXED, PRISMATIC and REVOLUTE. Torques also support a FREE root joint; its part
// of dcontrol is a wrench about the center of mass in world axes. Other joints throw
// ErrorKind::NotImplemented.
class NOVAPHY_DYNAMICS_API FeatherstoneAnalyticControlSensitivity {
 public:
  // ErrorKind::Value, ErrorKind::Index: an argument is out of range. ErrorKind::NotImplemented: an
  // unsupported joint or device, or contact_projection together with `exact`.
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

  // Sets the initial state, which does not depend on the parameters. Sets dq and dqd to 0.
  void reset(const SimState& state);
  // Propagates dq and dqd over a step of the solver from state_in to state_out with this control
  // and dt. dcontrol: row-major {dofs, parameters}, change of joint_target_q (rad, m) or joint_f (N
  // m, N) per unit of the parameter. dtarget_qd: the same for joint_target_qd, or empty.
  // `contacts`, only with contact_projection: the step's contacts with the forces that the step
  // wrote. The function repeats the solver's step with the same bits. After an error nothing has
  // changed.
  //   ErrorKind::Value           a wrong size, a number that is not finite, a change of a target
  //                              without a drive, contacts without contact_projection
  //   ErrorKind::Index           contacts of shapes that do not exist
  //   ErrorKind::NotImplemented  a contact with another articulation that moves
  //   ErrorKind::Runtime         no reset, a state_in that is not the last state_out, a state_out
  //                              that the step does not reproduce (another solver, control, dt or
  //                              contacts; with active contacts, rates must agree to 1e-5 of their
  //                              terms)
  void step(const SimState& state_in, const SimState& state_out, const Control* control, float dt,
            std::span<const float> dcontrol, std::span<const float> dtarget_qd = {},
            const Contacts* contacts = nullptr);

  // Results, row-major. The changes of dofs are tangents; a FREE joint has the displacement of the
  // center of mass and the rotation about it.
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
