// UnrolledVbd: a step of SolverVBD and its derivative, as functions of arrays.
#pragma once

#include <memory>

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
};

// The derivatives of a scalar by what a step reads, written in full. Null: not wanted. Materials
// and activations have the rows and columns of the arrays of Model of these names.
struct VbdStepGradients {
  Vec3f* particle_q = nullptr;
  Vec3f* particle_qd = nullptr;
  Vec3f* particle_f = nullptr;
  float* particle_spring_stiffness = nullptr;
  float* particle_spring_damping = nullptr;
  float* particle_spring_rest_length = nullptr;
  float* particle_tri_material = nullptr;  // columns 3 and 4 (drag, lift): 0
  float* particle_tri_activation = nullptr;
  float* particle_edge_material = nullptr;
  float* particle_edge_rest_angle = nullptr;
  float* particle_tet_material = nullptr;
  float* particle_tet_activation = nullptr;
};

// The derivative is exact for the sweeps that run: it goes back through every colour of every
// iteration, with the branches that these took. A particle moves by d = H^-1 f; with u = H^-1 xbar
// the derivative by all that f and H read is that of u.f - u.(H d), u and d held constant, which is
// summed over its elements. Points and normals of contacts are frozen.
//
// Held particles carry a gradient by their positions, which their neighbours feel. The result has
// the same bits for any number of threads and on any processor.
class NOVAPHY_VBD_API UnrolledVbd {
 public:
  // ErrorKind::NotImplemented: acceleration, tolerance, safeguard, the adaptive guess. Other errors
  // as SolverVBD.
  explicit UnrolledVbd(std::shared_ptr<const Model> model, const VbdOptions& options = {});
  ~UnrolledVbd();

  // SolverVBD::step, in all bits; held particles stay. Errors as there.
  void forward(const VbdStepInputs& inputs, Vec3f* q_out, Vec3f* qd_out);
  // From the derivatives of a scalar by the results (null: 0). Runs the step once more, and keeps
  // its iterates: 16 (iterations + 1) bytes for each particle.
  void backward(const VbdStepInputs& inputs, const Vec3f* q_out_bar, const Vec3f* qd_out_bar,
                const VbdStepGradients& gradients);
  // Of the step that the last backward ran. ErrorKind::Runtime: there was none.
  VbdResidual residual() const;

 private:
  struct Work;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
