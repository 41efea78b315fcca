// DiffSolverVBD: a step of VBD as one operation of a tape, with the derivative of its iteration.
// Compiled into novaphy::diff where both are built.
#pragma once

#include <memory>
#include <string>

#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/vbd/unrolled_vbd.h"

namespace novaphy::diff {

struct DiffVbdOptions {
  int32_t iterations = 10;                                   // sweeps over all colours, >= 0
  float friction_epsilon = 1e-2f;                            // m/s, > 0, see VbdOptions
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;  // not Adaptive
  float lhs_regularization = 1e-6f;
};

// What the gradients of a solver are.
struct VbdGradientInfo {
  std::string label;   // "exact": the derivative of the sweeps that ran
  VbdResidual primal;  // how far the step that the last backward ran was from its solution
};

// SolverVBD's step, in all bits, recorded on an active tape. Backward runs each step once more and
// goes back through its colours and iterations.
//
//   input                                        gradient
//   particle_q, particle_qd, particle_f          exact; held particles by their positions
//   particle_spring_stiffness, _damping, _rest_length, particle_tri_material (ke, ka, kd),
//   particle_edge_material, particle_edge_rest_angle, particle_tet_material    exact
//   activations of triangles and tetrahedra, of the control or the model       exact
//   contacts (those of the step are kept)        frozen: points, normals, which particles touch
//   all else of the model                        none: ErrorKind::NotImplemented, by name, where it
//                                                has requires_grad
// "Exact" is of the iterations that ran, not of the converged step: see gradient_info().
// There is no forward derivative (jvp), and none of it can be captured.
class NOVAPHY_VBD_API DiffSolverVBD : public DiffSolverBase {
 public:
  // Errors as SolverVBD.
  explicit DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options = {});

  const DiffVbdOptions& options() const { return options_; }
  // Of the last backward. ErrorKind::Runtime: there was none.
  VbdGradientInfo gradient_info() const;

  // particle_f is only read. Errors as SolverVBD::step; ErrorKind::Runtime in a capture.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;

 protected:
  bool begin_rollout(const RolloutInputs& inputs) override;
  void record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                   StepScratch scratch) override;

 private:
  struct Step;
  std::shared_ptr<const Contacts> kept(const Contacts* contacts);

  DiffVbdOptions options_;
  std::shared_ptr<UnrolledVbd> unrolled_;
  std::shared_ptr<const Contacts> last_contacts_;  // a copy of those of the last step
};

}  // namespace novaphy::diff
