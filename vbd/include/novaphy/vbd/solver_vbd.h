// SolverVBD: implicit Euler by Vertex Block Descent.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/vbd/export.h"

namespace novaphy {

// The initial guess of the iteration: the inertial position, the position at the start of the step,
// or the inertial position with only that part of gravity that acted in the previous step (Chen et
// al. 2024).
enum class VbdInitialGuess { Inertia, Previous, Adaptive };

// Contact of the triangles of a model with each other. An empty value stands for the default.
struct VbdSelfContact {
  std::optional<float> radius = {};  // m: contacts begin at this distance; twice particle_radius
  std::optional<float> gap = {};     // m: how far beyond the radius pairs are known; a third
};

struct VbdOptions {
  int32_t iterations = 10;         // number of sweeps over all colors, >= 0
  float friction_epsilon = 1e-2f;  // m/s, > 0: friction grows up to the Coulomb limit at this slip
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;
  // The spectral radius of Chebyshev acceleration, in (0, 1), for the particles without contacts.
  // Above 0.8 the iteration may stall or diverge.
  std::optional<float> acceleration = {};
  // Ends the iterations of a connected component when its VbdResidual::relative is at most this
  // number > 0. Each iteration then computes the forces once more. With `converged` all iterations
  // run first, and Newton's method then continues to this residual (default 1e-4).
  std::optional<float> tolerance = {};
  // Halves the step of a particle while the energy of its elements rises, up to four times. If the
  // energy still rises, the particle stays in place. The total energy therefore never rises. Not
  // supported together with acceleration.
  bool safeguard = false;
  // Adds a step of Galerkin's method after each iteration (coarse_kernels.h), which removes errors
  // that are smooth over many particles. Not supported together with acceleration or safeguard.
  bool coarse = false;
  // Continues after the iterations with Newton's method, until the step is at the minimum of its
  // energy (DifferentiableVbd: implicit). Supported on the CPU, outside of captures.
  bool converged = false;
  float lhs_regularization = 1e-6f;  // see vbd/block_law.h; finite, >= 0
  // Surfaces push each other apart and never cross (src/self_contact.h). Supported on the CPU,
  // outside of captures, and without the options above that end or correct the iterations.
  std::optional<VbdSelfContact> self_contact = {};
};

// The contacts of surfaces with each other at the end of a step, one row for each contact.
struct VbdSelfContacts {
  // A vertex and the corners of a triangle, or the ends of two edges.
  std::vector<std::array<int32_t, 4>> particles;
  std::vector<char> has_edges;  // 1: two edges
  std::vector<float> gaps;      // m: distance of the features
  std::vector<float> forces;    // N: normal force
};

// The distance of the last step from its solution. Each connected component of particles has a
// residual. The values are those of one component. Components above twice their `floor` come first,
// and among these the one with the largest `relative` is chosen.
struct VbdResidual {
  double force = 0.0;  // N: norm of the total force over the particles, with inertia
  // N: norm over the particles of two parts. The first part is m (y - xn - h vc)/h^2, with the mean
  // velocity vc of the component. The second part is the sum of the norms of the forces of the
  // particle's contacts and elements. A uniform motion does not change the scale.
  double scale = 0.0;
  double relative = 0.0;  // force / scale; 0 where the force is 0
  double floor = 0.0;     // the part of `relative` that one rounding of the positions can cause
  int32_t iterations = 0;
};

// The solver supports particles and elements over them: springs, triangles, bending edges,
// tetrahedra, external forces, gravity, and soft contacts with shapes of the world. It supports
// rigid bodies with their contacts and joints (src/bodies.h) on the CPU. These features raise
// ErrorKind::NotImplemented, by name:
// - contacts of particles with shapes of bodies; bodies on a device or in a capture;
// - D6, PLANAR and mimic joints, actuators, velocity limits, drives of BALL joints;
// - `tolerance` and `converged` in a model with bodies;
// - drag and lift of triangles;
// - particle_adhesion;
// - a particle_max_velocity below its default;
// - a soft_contact_kf or shape_material_kf other than the default, because friction_epsilon sets
// the friction below the cone;
// - restitution;
// - a particle_spring_control other than 0;
// - on a device: `tolerance`, `converged`, and a build without NOVAPHY_WITH_VBD_CUDA.
// Particles touch each other only with `self_contact`, as corners of triangles.
//
// One step minimizes, over the positions x of the particles that move,
//   sum m/(2h^2) |x - y|^2 + E(x; xn),  y = xn + h vn + h^2 (g + f/m)
// where E is the sum of the energies of the elements (vbd/elements/). The step sets v = (x - xn)/h.
// An iteration visits the colors of the model (ModelBuilder::color, set_coloring) in order. All
// particles of a color move together. Each particle solves the 3x3 system of its own elements, from
// the positions before the color. Sums run per particle in a fixed order. The result has the same
// bits for any number of threads, on any processor and on any device.
//
// A step can be captured. A graph keeps the recorded dt. A replay throws if a number of the model
// (soft_contact_ke, ...) has changed since the recording. A replay also throws if arrays behind the
// solver's tables were edited: materials of elements, rest shapes, masses, flags. A step on a
// device and a replay cannot throw for values that only the device sees. Kernels then note states
// that are not finite and contacts that overflowed. The next residual() throws, and on the CPU so
// does the next step().
//
// Particles of mass 0 or without ParticleFlags.ACTIVE are kinematic. A kinematic particle stays in
// place, or moves to its row of `targets`. Its new velocity is its displacement divided by dt. A
// step does not write to state_in. particle_f acts and keeps its values.
class NOVAPHY_VBD_API SolverVBD : public SolverBase {
 public:
  // ErrorKind::Value: a bad option, particles without a color, or a value that EditedValues
  // refuses. ErrorKind::Index: an element refers to a particle that does not exist.
  explicit SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options = {});
  ~SolverVBD() override;

  const VbdOptions& options() const { return options_; }
  // Number of kinematic particles: the rows of `targets`, in the order of the particles' indices.
  int32_t kinematic_count() const;
  // True without `tolerance`, `converged`, self-contact and bodies.
  bool supports_graph_capture() const override;

  // Errors besides those of SolverBase::step and of the constructor:
  // ErrorKind::Value: the indices of elements or the colors were edited after the solver was made,
  // or states, activations or arrays of the model are not finite.
  // ErrorKind::Index: a contact refers to a shape that does not exist.
  // ErrorKind::Runtime: contacts overflowed, positions or poses do not stay finite (state_out is
  // then not written), an input carries a gradient under a Tape, or `converged` found no solution
  // (state_out then holds the last iterate).
  // ErrorKind::NotImplemented: a contact with a shape of a body, or `converged` in a capture.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    step(state_in, state_out, control, contacts, dt, nullptr);
  }
  // `targets`: {kinematic_count} positions of the kinematic particles at the end of the step (m,
  // world frame). Null: these particles stay in place.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets);
  // Returns the residual of the last step, and waits for the device. ErrorKind::Runtime: no step
  // ran since the solver was made or reset. ErrorKind::Runtime: since the last call a step on a
  // device or a replay met numbers that are not finite, or contacts that overflowed. The message
  // names the first such particle, and each fault is reported once.
  VbdResidual residual() const;
  // Returns the self-contacts of the last step. ErrorKind::Value: a solver without self_contact.
  VbdSelfContacts self_contacts() const;
  // Forgets the last step, which the adaptive guess and residual() read.
  void reset();
  void notify_model_changed(ModelFlags flags) override;
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;

 protected:
  int32_t target_count() const override { return kinematic_count(); }
  // The previous velocities for the adaptive guess, and the multipliers of bodies.
  Array carried() const override;
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
