// DifferentiableVbd: a step of SolverVBD and its derivatives, as functions of arrays.
#pragma once

#include <memory>
#include <string>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/export.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy {

// What a step reads, besides the model. n rows each, on the CPU.
struct VbdStepInputs {
  const Vec3f* particle_q = nullptr;
  const Vec3f* particle_qd = nullptr;
  const Vec3f* particle_f = nullptr;
  const DeviceArray<float>* tri_activation = nullptr;  // null: the model's
  const DeviceArray<float>* tet_activation = nullptr;  // null: the model's
  const Contacts* contacts = nullptr;                  // null: none
  float dt = 0.0f;                                     // s
  const Vec3f* targets = nullptr;  // of the kinematic particles; null: they stay
  // Of the adaptive guess: the velocity at the start of the step before (m/s), and 1, or 0 where
  // there was none; null: none.
  const Vec4f* last_velocity = nullptr;
};

// The same on the device of the model. Contacts: null: none; targets without rows: kinematic
// particles stay; last_velocity without rows: there was no step before.
struct VbdLaunchInputs {
  DeviceArray<Vec3f> q, qd, f;
  DeviceArray<float> tri_activation, tet_activation;
  const Contacts* contacts = nullptr;
  DeviceArray<Vec3f> targets;
  float dt = 0.0f;  // s
  DeviceArray<Vec4f> last_velocity = {};
  // In a capture: replays read the materials and rest shapes of elements as they are then, where an
  // element whose coefficients are all 0 keeps them.
  bool trains_elements = false;

  bool have_contacts() const { return contacts != nullptr && contacts->soft_contact_max() > 0; }
};

// One derivative for each number that a step reads: with the rows and columns of the arrays of
// Model of these names, and of the targets. As VbdStepGradients those of a scalar by what a step
// reads, written in full (null: not wanted); as VbdStepTangents those of what it reads along a
// direction (null: 0); as VbdStepArrays those of a scalar on a device, as arrays without rows where
// they are not wanted. Kinematic particles have none by mass. Where friction has no part (the
// product of the coefficients is 0) there is none by shape_material_mu.
template <class Numbers, class Vectors>
struct VbdStepDerivatives {
  Vectors particle_q = {};
  Vectors particle_qd = {};
  Vectors particle_f = {};
  Vectors targets = {};
  Numbers last_velocity = {};  // column 3: 0; implicit: 0, the solution does not know the guess
  Vectors gravity = {};
  Numbers particle_mass = {};
  Numbers particle_radius = {};
  Numbers particle_spring_stiffness = {};
  Numbers particle_spring_damping = {};
  Numbers particle_spring_rest_length = {};
  Numbers particle_tri_pose = {};
  Numbers particle_tri_area = {};
  Numbers particle_tri_material = {};  // columns 3 and 4 (drag, lift): 0
  Numbers particle_tri_activation = {};
  Numbers particle_edge_material = {};
  Numbers particle_edge_rest_angle = {};
  Numbers particle_edge_rest_length = {};
  Numbers particle_tet_pose = {};
  Numbers particle_tet_material = {};
  Numbers particle_tet_activation = {};
  Numbers shape_margin = {};
  Numbers shape_material_ke = {};
  Numbers shape_material_kd = {};
  Numbers shape_material_mu = {};
};
using VbdStepGradients = VbdStepDerivatives<float*, Vec3f*>;
using VbdStepTangents = VbdStepDerivatives<const float*, const Vec3f*>;
using VbdStepArrays = VbdStepDerivatives<Array, Array>;

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

// Unrolled, the derivative is exact for the sweeps that run: it goes back through every colour of
// every iteration, with the branches that these took. A particle moves by d = H^-1 f; with
// u = H^-1 xbar the derivative by all that f and H read is that of u.f - u.(H d), u and d held
// constant, which is summed over its elements.
//
// Implicit, it is that of the solution, where f = 0: with J = -df/dx, J^T lambda = xbar, the
// derivative by all that f reads is that of lambda.f. The same sweeps in reverse, with d = 0, are a
// block Gauss-Seidel iteration for lambda; it is the preconditioner of a generalised conjugate
// residual method. Before, Newton's method with the tangent of the same sweeps solves the step,
// which `forward` returns then. J holds the whole derivative, also what H leaves out.
//
// Points, normals and velocities of contacts are frozen. Kinematic particles carry a gradient by
// their positions or targets. The result has the same bits for any number of threads and any
// processor.
class NOVAPHY_VBD_API DifferentiableVbd {
 public:
  // ErrorKind::NotImplemented: acceleration, tolerance, safeguard.
  // ErrorKind::Value: bad options; implicit without an iteration. Other errors as SolverVBD.
  explicit DifferentiableVbd(std::shared_ptr<const Model> model, const VbdOptions& options = {},
                             const VbdGradientOptions& gradient_options = {});
  ~DifferentiableVbd();

  int32_t kinematic_count() const;
  // SolverVBD::step, in all bits; implicit: the solution of the step. Errors as there.
  void forward(const VbdStepInputs& inputs, Vec3f* q_out, Vec3f* qd_out);
  // From the derivatives of a scalar by the results (null: 0). Runs the step once more, and
  // unrolled keeps its iterates: 16 (iterations + 1) bytes for each particle.
  void backward(const VbdStepInputs& inputs, const Vec3f* q_out_bar, const Vec3f* qd_out_bar,
                const VbdStepGradients& gradients);
  // The derivatives of the results along a direction.
  void tangent(const VbdStepInputs& inputs, const VbdStepTangents& direction, Vec3f* q_out_slope,
               Vec3f* qd_out_slope);
  // On any device: launches, which may be recorded; with implicit gradients, and for tangents, the
  // host waits for them, so they may not. Errors as SolverVBD::step there; `in_use`: the use of the
  // memory, which a recording takes. Bars without rows: 0.
  void forward(const VbdLaunchInputs& inputs, const DeviceArray<Vec3f>& q_out,
               const DeviceArray<Vec3f>& qd_out, const std::shared_ptr<ExclusiveUse>& in_use);
  void backward(const VbdLaunchInputs& inputs, const Array& q_out_bar, const Array& qd_out_bar,
                const VbdStepArrays& gradients, const std::shared_ptr<ExclusiveUse>& in_use);
  // Directions without rows: 0.
  void tangent(const VbdLaunchInputs& inputs, const VbdStepArrays& direction,
               DeviceArray<Vec3f> q_out_slope, DeviceArray<Vec3f> qd_out_slope);
  // Of the last backward or tangent. ErrorKind::Runtime: there was none.
  VbdGradientInfo info() const;

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
