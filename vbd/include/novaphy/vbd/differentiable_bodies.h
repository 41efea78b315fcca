// DifferentiableBodies: the solution of a step of rigid bodies by SolverVBD, and its derivatives.
#pragma once

#include <memory>

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/export.h"

namespace novaphy {

// The poses, velocities and multipliers at the end of a step. Defined in src/bodies_solution.h.
struct VbdBodySolution;

// Arrays of float32. For the results of a step: the adjoints of body_q {n, 7} and body_qd {n, 6},
// without rows: 0. For the inputs of a step: the derivatives, in the shapes of the arrays of
// SimState, Control and Model with the same names. An array without rows is not computed.
//
// The derivative with respect to a quaternion is that of rotations: it is perpendicular to the
// quaternion. The derivative with respect to an inertia is that of symmetric matrices.
struct VbdBodyDerivatives {
  Array body_q = {}, body_qd = {}, body_f = {};
  Array gravity = {}, body_mass = {}, body_inertia = {};
  Array joint_f = {}, joint_target_q = {}, joint_target_qd = {};
  Array joint_target_ke = {}, joint_target_kd = {};
  Array joint_damping = {}, joint_armature = {}, joint_friction = {};
  Array shape_material_ke = {}, shape_material_kd = {}, shape_material_mu = {};
};

// A step solves the balance of forces of each body, and an equation for each row of a joint that
// acts (joint_law.h):
//   f(x, lam) = 0,   C(x) - lam/K = 0
// Let A be the derivative of both left sides with respect to x and lam. The adjoint (mu, nu) solves
// A^T (mu, nu) = (xbar, 0), with the adjoint xbar of x. The derivative with respect to an input p
// is -mu df/dp - nu d(C - lam/K)/dp. All derivatives are those of the laws by dual numbers. The
// solution does not depend on the multipliers of the previous step.
//
// A contact that pushes has a row of the depth, and two rows of slip if it sticks. If it slips, its
// friction is mu times the normal force against the slip. The normals are constant, and the points
// are fixed to their bodies. If the contacts were found from the state, the point on an endless
// plane follows the other point, so that contacts with such planes are exact. The depth that the
// first step ignores is constant.
//
// The system is solved by block elimination, and by the method of multipliers for hard rows. The
// arithmetic is in double precision. The bits do not depend on the number of threads.
class NOVAPHY_VBD_API DifferentiableBodies {
 public:
  // ErrorKind::NotImplemented: a model with particles, a device, unrolled gradients, or an option
  // that SolverVBD refuses for bodies. Other errors: as for DifferentiableVbd.
  explicit DifferentiableBodies(std::shared_ptr<const Model> model, const VbdOptions& options,
                                const VbdGradientOptions& gradient_options);
  ~DifferentiableBodies();

  // Runs a step, and iterates to its solution: the iterations of SolverVBD, then at most
  // newton_iterations more. A row that leaves a bound, and a contact that stops to slip, get a lower
  // penalty than in SolverVBD. ErrorKind::Runtime: the step was not solved, unless
  // allow_unconverged. `contacts_follow`: whether the contacts were found from the state.
  std::shared_ptr<const VbdBodySolution> forward(const SimState& in, const SimState& out,
                                                 const Control* control, const Contacts* contacts,
                                                 float dt, bool contacts_follow = false);
  // Computes the derivatives of a scalar with respect to the inputs of a step, which gave
  // `solution`, from the adjoints of its results.
  void backward(const VbdBodySolution& solution, const SimState& in, const Control* control,
                float dt, const VbdBodyDerivatives& adjoints, const VbdBodyDerivatives& gradients);
  // Computes the tangents of the results, {n, 7} and {n, 6}, along a direction of the inputs.
  void tangent(const VbdBodySolution& solution, const SimState& in, const Control* control,
               float dt, const VbdBodyDerivatives& direction, Array q_out, Array qd_out);
  // Returns whether a contact pushes whose points, normal or ignored depth depend on the state. The
  // derivatives keep them constant.
  bool has_frozen_contacts(const VbdBodySolution& solution) const;
  // Describes the last backward or tangent. ErrorKind::Runtime: none ran yet.
  VbdGradientInfo info() const;
  // Forgets the multipliers and turns of joints of the previous step.
  void reset();

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
