// DifferentiableVbd: a step of SolverVBD and its derivatives, as functions of arrays.
#pragma once

#include <memory>
#include <string>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/export.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy {

// Activations of elements, from a control or from the model.
struct VbdActivations {
  DeviceArray<float> particle_tri_activation = {}, particle_tet_activation = {};
};

// The inputs of a step besides the model, on the model's device. Only q, qd and f need rows.
struct VbdStepInputs {
  DeviceArray<Vec3f> q, qd, f;
  VbdActivations activations = {};     // without rows: those of the model
  const Contacts* contacts = nullptr;  // null: no contacts
  // positions of the kinematic particles (m); without rows: they stay
  DeviceArray<Vec3f> targets = {};
  float dt = 0.0f;  // s
  // For the adaptive guess: the velocity at the start of the previous step (m/s) and the number 1.
  // The number 0 means that there was no previous step. Without rows: there was none for any
  // particle.
  DeviceArray<Vec4f> last_velocity = {};
  // In a capture: replays read the present materials and rest shapes of elements. An element whose
  // coefficients are all 0 has to keep its values.
  bool trains_elements = false;
};

// One derivative for each number that a step reads, as float32. Rows and columns are those of the
// arrays of Model with these names, and of the targets. The arrays hold one of two things:
// - Adjoints: the derivatives of a scalar with respect to each input, written in full. An array
// without rows is not computed.
// - A direction: the tangent of each input. An array without rows means 0.
// The derivative with respect to the mass of a kinematic particle is 0. The derivative with respect
// to shape_material_mu is 0 where the product of the two friction coefficients is 0.
struct VbdStepDerivatives {
  Array particle_q = {};
  Array particle_qd = {};
  Array particle_f = {};
  Array targets = {};
  Array last_velocity = {};  // column 3: 0; 0 with implicit gradients, which ignore the guess
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

struct VbdGradientOptions {
  // False: the gradient of the sweeps that run. True: the gradient of the step's solution. forward
  // then iterates to this solution.
  bool implicit = false;
  // Implicit: the relative residual at which the step and the linear system count as solved, > 0.
  // Rounding can prevent a smaller residual. The step therefore also counts as solved at twice
  // VbdResidual::floor, and the linear system at four times the part that one rounding can cause.
  float tolerance = 1e-4f;
  // iterations to solve the step, each of at most krylov_sweeps; >= 0
  int32_t newton_iterations = 30;
  int32_t krylov_sweeps = 200;     // sweeps to solve a linear system, >= 1
  bool allow_unconverged = false;  // false: ErrorKind::Runtime where a system was not solved
};

// How exact the derivatives of the last step are.
struct VbdGradientInfo {
  std::string label;           // "exact": of the sweeps that ran; "implicit": of the solution
  VbdResidual primal;          // residual of the step
  double linear_residual = 0;  // implicit: relative residual of the linear system; else 0
  int32_t linear_sweeps = 0;   // implicit: sweeps for the linear system
  bool converged = true;       // implicit: both residuals are within the tolerance
  // Unrolled: number of coarse steps that were halved. There the result jumps, which a gradient
  // does not see.
  int32_t halvings = 0;
};

// Unrolled gradients are exact for the sweeps that run. The backward pass visits every color of
// every iteration in reverse, with the branches that the iteration took. A particle moves by d =
// H^-1 f. Let u = H^-1 xbar. The derivative with respect to each input of f and H is that of u.f -
// u.(H d), with u and d held constant: a sum over the elements of the particle. Coarse steps have
// the same form (coarse_adjoint_kernels.h). Their lengths are constant.
//
// Implicit gradients are those of the solution, where f = 0. With J = -df/dx and J^T lambda = xbar,
// the derivative with respect to each input of f is that of lambda.f. The same sweeps in reverse,
// with d = 0, are a block Gauss-Seidel iteration for lambda. This iteration preconditions a
// generalized conjugate residual method. Newton's method solves the step first, with the tangents
// of the same sweeps, and `forward` returns this solution. J is the whole derivative of f. H leaves
// parts of J out.
//
// Implicit steps damp only the motion of a contact inside its overlap, because the force of other
// contacts would jump (`inside` of particle_contact_law.h).
//
// Points, normals and velocities of contacts are frozen. Kinematic particles carry a gradient with
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
  // On the CPU the next three functions run at once, and no recorder sees them. On a device they
  // submit launches. A capture may record forward, and unrolled backward. `in_use` marks the
  // solver's memory as used, and a recording holds the mark. With implicit gradients the host waits
  // for the device. Errors: as for SolverVBD::step.
  //
  // A step with the bits of SolverVBD::step. Implicit: the solution of the step.
  void forward(const VbdStepInputs& inputs, const DeviceArray<Vec3f>& q_out,
               const DeviceArray<Vec3f>& qd_out, const std::shared_ptr<ExclusiveUse>& in_use = {});
  // Maps the adjoints of the results to those of the inputs. An adjoint without rows is 0. Runs the
  // step once more. Unrolled gradients keep its iterates: 16 (iterations + 1) bytes for each
  // particle, and with coarse three times as much.
  void backward(const VbdStepInputs& inputs, const Array& q_out_adjoint,
                const Array& qd_out_adjoint, const VbdStepDerivatives& gradients,
                const std::shared_ptr<ExclusiveUse>& in_use = {});
  // Writes the tangents of the results along a direction.
  void tangent(const VbdStepInputs& inputs, const VbdStepDerivatives& direction,
               DeviceArray<Vec3f> q_out_tangent, DeviceArray<Vec3f> qd_out_tangent);
  // Describes the last backward or tangent. ErrorKind::Runtime: none of them ran yet.
  VbdGradientInfo info() const;

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
