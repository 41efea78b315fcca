// DifferentiableVbd: a step of SolverVBD and its derivatives, as functions of arrays.
#pragma once

#include <memory>
#include <string>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/export.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy {

// Activations of elements, of a control or the model.
struct VbdActivations {
  DeviceArray<float> particle_tri_activation = {}, particle_tet_activation = {};
};

// What a step reads, besides the model, on its device. Arrays may be without rows, but for q, qd
// and f.
struct VbdStepInputs {
  DeviceArray<Vec3f> q, qd, f;
  VbdActivations activations = {};     // without rows: the model's
  const Contacts* contacts = nullptr;  // null: none
  DeviceArray<Vec3f> targets = {};     // of the kinematic particles; without rows: they stay
  float dt = 0.0f;                     // s
  // Of the adaptive guess: the velocity at the start of the step before (m/s), and 1, or 0 where
  // there was none; without rows: none.
  DeviceArray<Vec4f> last_velocity = {};
  // In a capture: replays read the materials and rest shapes of elements as they are then, where an
  // element whose coefficients are all 0 keeps them.
  bool trains_elements = false;
};

// One derivative for each number that a step reads, as float32 with the rows and columns of the
// arrays of Model of these names, and of the targets. Either those of a scalar by what a step
// reads, written in full (without rows: not wanted), or those of what it reads along a direction
// (without rows: 0). Kinematic particles have none by mass. Where friction has no part (the product
// of the coefficients is 0) there is none by shape_material_mu.
struct VbdStepDerivatives {
  Array particle_q = {};
  Array particle_qd = {};
  Array particle_f = {};
  Array targets = {};
  Array last_velocity = {};  // column 3: 0; implicit: 0, the solution does not know the guess
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
  // False: of the sweeps that run. True: of the solution of the step, which forward then finds.
  bool implicit = false;
  // Implicit: the relative residual at which the step and the linear system count as solved, > 0.
  // The step also does where rounding allows no smaller one (twice VbdResidual::floor).
  float tolerance = 1e-4f;
  int32_t newton_iterations = 30;  // to solve the step, each of at most krylov_sweeps; >= 0
  int32_t krylov_sweeps = 200;     // to solve a linear system, >= 1
  bool allow_unconverged = false;  // false: ErrorKind::Runtime where one was not solved
};

// What the derivatives of the last step are.
struct VbdGradientInfo {
  std::string label;           // "exact": of the sweeps that ran; "implicit": of the solution
  VbdResidual primal;          // how far the step was from its solution
  double linear_residual = 0;  // implicit: of the linear system, relative; else 0
  int32_t linear_sweeps = 0;   // that it took
  bool converged = true;       // implicit: both are within the tolerance
};

// Unrolled, the derivative is exact for the sweeps that run: it goes back through every color of
// every iteration, with the branches that these took. A particle moves by d = H^-1 f; with
// u = H^-1 xbar the derivative by all that f and H read is that of u.f - u.(H d), u and d held
// constant, which is summed over its elements.
//
// Implicit, it is that of the solution, where f = 0: with J = -df/dx, J^T lambda = xbar, the
// derivative by all that f reads is that of lambda.f. The same sweeps in reverse, with d = 0, are a
// block Gauss-Seidel iteration for lambda; it is the preconditioner of a generalized conjugate
// residual method. Before, Newton's method with the tangent of the same sweeps solves the step,
// which `forward` returns then. J holds the whole derivative, also what H leaves out.
//
// Points, normals and velocities of contacts are frozen. Kinematic particles carry a gradient by
// their positions or targets. The result has the same bits for any number of threads and any
// processor.
class NOVAPHY_VBD_API DifferentiableVbd {
 public:
  // ErrorKind::NotImplemented: acceleration, tolerance, safeguard; coarse without implicit.
  // ErrorKind::Value: bad options; implicit without an iteration. Other errors as SolverVBD.
  explicit DifferentiableVbd(std::shared_ptr<const Model> model, const VbdOptions& options = {},
                             const VbdGradientOptions& gradient_options = {});
  ~DifferentiableVbd();

  int32_t kinematic_count() const;
  // On the CPU all of these run at once, and nobody records. On a device they are launches: forward
  // and, unrolled, backward may be recorded; `in_use` is the use of the memory, which a recording
  // takes. Else the host waits. Errors as SolverVBD::step.
  //
  // SolverVBD::step, in all bits; implicit: the solution of the step.
  void forward(const VbdStepInputs& inputs, const DeviceArray<Vec3f>& q_out,
               const DeviceArray<Vec3f>& qd_out, const std::shared_ptr<ExclusiveUse>& in_use = {});
  // From the derivatives of a scalar by the results (without rows: 0). Runs the step once more, and
  // unrolled keeps its iterates: 16 (iterations + 1) bytes for each particle.
  void backward(const VbdStepInputs& inputs, const Array& q_out_adjoint,
                const Array& qd_out_adjoint, const VbdStepDerivatives& gradients,
                const std::shared_ptr<ExclusiveUse>& in_use = {});
  // The derivatives of the results along a direction.
  void tangent(const VbdStepInputs& inputs, const VbdStepDerivatives& direction,
               DeviceArray<Vec3f> q_out_tangent, DeviceArray<Vec3f> qd_out_tangent);
  // Of the last backward or tangent. ErrorKind::Runtime: there was none.
  VbdGradientInfo info() const;

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
