// SolverVBD: implicit Euler by Vertex Block Descent.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/vbd/export.h"

namespace novaphy {

// Where the iteration starts: the inertial target, the position at the start of the step, or the
// target with as much of gravity as acted in the step before (Chen et al. 2024).
enum class VbdInitialGuess { Inertia, Previous, Adaptive };

struct VbdOptions {
  int32_t iterations = 10;         // sweeps over all colors, >= 0
  float friction_epsilon = 1e-2f;  // m/s, > 0: friction grows up to the Coulomb limit at this slip
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;
  // Chebyshev acceleration by this spectral radius, in (0, 1), of the particles that touch nothing.
  // Above 0.8 it may stall or diverge.
  std::optional<float> acceleration = {};
  // Ends the iteration when VbdResidual::relative is at most this, > 0. Each iteration then costs
  // the forces once more.
  std::optional<float> tolerance = {};
  // Halves the step of a particle while the energy of its elements rises, up to four times, then
  // leaves it where it is: the energy of all never rises. Not together with acceleration.
  bool safeguard = false;
  // After each iteration a step of Galerkin's method (coarse_kernels.h), which takes away errors
  // that are smooth over many particles. Not together with acceleration and safeguard.
  bool coarse = false;
  float lhs_regularization = 1e-6f;  // see vbd/block_law.h; finite, >= 0
};

// How far the last step was from its solution.
struct VbdResidual {
  double force = 0.0;     // N: norm of the force over all particles that move, inertia included
  double scale = 0.0;     // N: norm of m (y - xn)/h^2, what the step has to balance
  double relative = 0.0;  // force / scale; 0 where the force is 0
  double floor = 0.0;     // of relative: what one rounding of the positions changes
  int32_t iterations = 0;
};

// Covers particles and elements over them: springs, triangles, bending edges, tetrahedra, external
// forces, gravity, and soft contacts with world-owned shapes. ErrorKind::NotImplemented names what
// is not covered: bodies, joints, drag and lift of triangles, particle_adhesion, a
// particle_max_velocity below its default, a soft_contact_kf or shape_material_kf that is not the
// default (friction below the cone is that of friction_epsilon), restitution, and a
// particle_spring_control that is not 0; on a device also `tolerance`, and
// a build without NOVAPHY_WITH_VBD_CUDA. There is no contact between particles or of particles with
// triangles.
//
// One step minimizes, over the positions x of the particles that move,
//   sum m/(2h^2) |x - y|^2 + E(x; xn),  y = xn + h vn + h^2 (g + f/m)
// where E are the energies of the elements (vbd/elements/), and sets v = (x - xn)/h. An iteration
// goes through the colors of the model (ModelBuilder::color, set_coloring) in order; all particles
// of a color move together by the 3x3 system of their own elements, from the positions before the
// color. Sums run per particle in a fixed order. The result has the same bits for any number of
// threads, on any processor and on any device.
//
// A step can be captured; a graph keeps the dt with which it was recorded, and throws once a number
// of the model (soft_contact_ke, ...) is another than then, or arrays that its tables were made of
// were edited (materials of elements, rest shapes, masses, flags). A step on a device and a replay
// cannot throw: numbers of states that are not finite and contacts that overflowed leave a note,
// and the next residual() throws; on the CPU so does the next step(). Nothing waits for it before.
//
// Particles of mass 0 or without ParticleFlags.ACTIVE are kinematic: they stay, or go where
// `targets` say; their velocity is what they moved by in the step, and 0 otherwise. Nothing is
// written to state_in. particle_f acts and stays as it is.
class NOVAPHY_VBD_API SolverVBD : public SolverBase {
 public:
  // ErrorKind::Value: a bad option; particles without a color; what EditedValues refuses.
  // ErrorKind::Index: an element of a particle that is not there.
  explicit SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options = {});
  ~SolverVBD() override;

  const VbdOptions& options() const { return options_; }
  // Kinematic particles, see above: the rows of `targets`, in the order of their indices.
  int32_t kinematic_count() const;
  // True without `tolerance`.
  bool supports_graph_capture() const override;

  // Besides the errors of SolverBase::step and of the constructor: ErrorKind::Value when the
  // indices of elements or the colors were edited after the solver was made, and for states,
  // activations and arrays of the model that are not finite; ErrorKind::Runtime for contacts that
  // overflowed, for positions that do not stay finite (state_out is not written then), and under a
  // Tape for an input that carries a gradient; ErrorKind::NotImplemented for a contact with a shape
  // of a body.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    step(state_in, state_out, control, contacts, dt, nullptr);
  }
  // `targets`: {kinematic_count} positions (m, world frame) where the kinematic particles are at
  // the end of the step; null: where they are.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets);
  // Of the last step; waits for the device. ErrorKind::Runtime: there was none since the solver was
  // made or reset; a step on a device or a replay since the last call read or made numbers that are
  // not finite, or contacts that had overflowed (it says the first of a particle, once).
  VbdResidual residual() const;
  // Forgets the last step, which the adaptive guess and residual() look at.
  void reset();
  void notify_model_changed(ModelFlags flags) override;

 protected:
  int32_t target_count() const override { return kinematic_count(); }
  Array carried() const override;  // of the adaptive guess
  void step_to_targets(SimState& state_in, SimState& state_out, const Control* control,
                       const Contacts* contacts, float dt,
                       const DeviceArray<Vec3f>& targets) override {
    step(state_in, state_out, control, contacts, dt, &targets);
  }

 private:
  struct Work;

  VbdOptions options_;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
