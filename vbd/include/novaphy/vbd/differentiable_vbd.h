// DifferentiableVbd: a step of SolverVBD and its derivatives, as functions of arrays.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/export.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy {

// The activations of elements (1), from a control or from the model.
struct VbdActivations {
  DeviceArray<float> particle_tri_activation = {}, particle_tet_activation = {};
};

// The inputs of a step besides the model, on the model's device. Only q, qd and f must have rows.
struct VbdStepInputs {
  DeviceArray<Vec3f> q, qd, f;
  VbdActivations activations = {};     // without rows: the activations of the model
  const Contacts* contacts = nullptr;  // null: no contacts
  // positions of the kinematic particles (m); without rows: the particles stay in place
  DeviceArray<Vec3f> targets = {};
  float dt = 0.0f;  // s
  // For the adaptive guess: each row has the velocity at the start of the previous step (m/s), and
  // the number 1. If the fourth number is 0, the particle had no previous step. An array without
  // rows means that no particle had a previous step.
  DeviceArray<Vec4f> last_velocity = {};
  // True in a capture whose replays read the current materials and rest shapes of elements. An
  // element whose coefficients are all 0 must keep its values.
  bool trains_elements = false;
};

// One derivative (float32) for each value that a step reads. The arrays have the shapes of the
// arrays of Model and of VbdStepInputs with the same names. The struct has two uses:
// - Adjoints: the derivatives of a scalar with respect to each input. A function overwrites the
// arrays. An array without rows is not computed.
// - A direction: the tangent of each input. An array without rows means 0.
// The derivative with respect to the mass of a kinematic particle is 0. The derivative with respect
// to shape_material_mu is 0 where the product of the two friction coefficients is 0.
struct VbdStepDerivatives {
  Array particle_q = {};
  Array particle_qd = {};
  Array particle_f = {};
  Array targets = {};
  Array last_velocity = {};  // {n, 4}, column 3: 0; implicit: all 0
  Array gravity = {};
  Array particle_mass = {};
  Array particle_radius = {};
  Array particle_spring_stiffness = {};
  Array particle_spring_damping = {};
  Array particle_spring_rest_length = {};
  Array particle_tri_pose = {};
  Array particle_tri_area = {};
  Array particle_tri_material = {};  // columns 3 and 4 (drag, lift): 0
  Array particle_tri_activation = {};
  Array particle_edge_material = {};
  Array particle_edge_rest_angle = {};
  Array particle_edge_rest_length = {};
  Array particle_tet_pose = {};
  Array particle_tet_material = {};
  Array particle_tet_activation = {};
  Array shape_margin = {};
  Array shape_material_ke = {};
  Array shape_material_kd = {};
  Array shape_material_mu = {};
};

// A contact of a particle with a shape that pushes at the end of a step.
struct VbdContactForce {
  int32_t slot = 0;  // row of Contacts::soft_contact_*
  int32_t particle = 0, shape = 0;
  Vec3f point{}, normal{};         // of the surface
  Vec3f force{}, force_tangent{};  // on the particle (N); the tangent only from `tangent`
};

struct VbdGradientOptions {
  // False: the gradient of the iterations that run. True: the gradient of the step's solution.
  // forward() then iterates to this solution.
  bool implicit = false;
  // Implicit: the relative residual (> 0) at which the step and the linear system count as solved.
  // Rounding can prevent a smaller residual. The step therefore also counts as solved at twice
  // VbdResidual::floor. The linear system also counts as solved at four times the residual that one
  // rounding of its solution can cause.
  float tolerance = 1e-4f;
  // maximum count of Newton iterations for the step, each with at most krylov_sweeps sweeps; >= 0
  int32_t newton_iterations = 30;
  int32_t krylov_sweeps = 200;     // maximum count of sweeps for a linear system, >= 1
  bool allow_unconverged = false;  // false: ErrorKind::Runtime if a system was not solved
};

// How exact the last derivatives are.
struct VbdGradientInfo {
  std::string label;           // "exact": of the iterations that ran; "implicit": of the solution
  VbdResidual primal;          // residual of the step
  double linear_residual = 0;  // implicit: relative residual of the linear system; else 0
  int32_t linear_sweeps = 0;   // implicit: sweeps for the linear system
  bool converged = true;       // implicit: both residuals are within the tolerance
  // Unrolled: the number of coarse steps that the line search halved. The step is discontinuous
  // where this number changes. The gradient does not include the jump.
  int32_t halvings = 0;
};

// Unrolled gradients are exact for the iterations that run. The backward pass visits every color of
// every iteration in reverse, with the branches that the iteration took. A particle moves by d =
// H^-1 f (block_law.h). Let xbar be the adjoint of its new position, and u = H^-1 xbar. The
// derivative with respect to each input of f and H is the derivative of u.f - u.(H d) with constant
// u and d. This expression is a sum over the elements of the particle. Coarse steps have the same
// form (coarse_adjoint_kernels.h), with constant lengths.
//
// Implicit gradients are the derivatives of the solution, where f = 0. With J = -df/dx and J^T
// lambda = xbar, the derivative with respect to each input of f is the derivative of lambda.f. J is
// the complete derivative of f, while the H of a sweep leaves parts of J out.
//
// forward() first solves the step by Newton's method, with the tangents of sweeps, and returns this
// solution. backward() solves for lambda by a generalized conjugate residual method. Its
// preconditioner is a sweep in reverse with d = 0: a block Gauss-Seidel iteration for lambda.
//
// With implicit gradients, contact damping is bounded so that the force stays continuous where a
// contact begins (`inside` of particle_contact_law.h).
//
// Points, normals and velocities of contacts are frozen. Kinematic particles have gradients with
// respect to their positions or targets. The result has the same bits for any number of threads and
// on any processor.
class NOVAPHY_VBD_API DifferentiableVbd {
 public:
  // ErrorKind::NotImplemented: acceleration, tolerance or safeguard is set. ErrorKind::Value: a bad
  // option, or implicit without an iteration. Other errors: as for SolverVBD.
  explicit DifferentiableVbd(std::shared_ptr<const Model> model, const VbdOptions& options = {},
                             const VbdGradientOptions& gradient_options = {});
  ~DifferentiableVbd();

  int32_t kinematic_count() const;
  // On the CPU, forward, backward and tangent run at once, and no recorder sees them. On a device
  // they submit launches. A capture may record forward, and backward with unrolled gradients. With
  // implicit gradients the host waits for the device. `in_use` marks the memory of the solver as
  // used, and a recording keeps this mark. Errors: as for SolverVBD::step.
  //
  // Runs a step with the same bits as SolverVBD::step. Implicit: computes the solution of the step.
  void forward(const VbdStepInputs& inputs, const DeviceArray<Vec3f>& q_out,
               const DeviceArray<Vec3f>& qd_out, const std::shared_ptr<ExclusiveUse>& in_use = {});
  // Computes the adjoints of the inputs from the adjoints of the results. An adjoint without rows
  // is 0. The function runs the step once more. For unrolled gradients it stores the positions of
  // each iteration: 16 (iterations + 1) bytes for each particle, with `coarse` three times as much.
  void backward(const VbdStepInputs& inputs, const Array& q_out_adjoint,
                const Array& qd_out_adjoint, const VbdStepDerivatives& gradients,
                const std::shared_ptr<ExclusiveUse>& in_use = {});
  // Computes the tangents of the results along a direction of the inputs. `held`: for each row of
  // soft_contact_*, 1: the contact's force has the tangent 0. Empty: no such contact.
  void tangent(const VbdStepInputs& inputs, const VbdStepDerivatives& direction,
               DeviceArray<Vec3f> q_out_tangent, DeviceArray<Vec3f> qd_out_tangent,
               std::span<const int32_t> held = {});
  // Returns the forces of contacts in the last backward or tangent, which had these inputs. After
  // tangent, a held contact has the tangent that its force would have. The order is that of the
  // particles. Waits for a device.
  std::vector<VbdContactForce> contact_forces(const VbdStepInputs& inputs) const;
  // Describes the last backward or tangent. ErrorKind::Runtime: neither function ran yet.
  VbdGradientInfo info() const;

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
