// SolverVBD: implicit Euler by Vertex Block Descent.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/vbd/export.h"

namespace novaphy {

// The initial guess of the iterations. Inertia: the inertial position. Previous: the position at
// the start of the step. Adaptive: the inertial position with only that part of gravity that acted
// in the previous step (Chen et al. 2024).
enum class VbdInitialGuess { Inertia, Previous, Adaptive };

// Contact of the triangles of a model with each other. An empty value means the default.
struct VbdSelfContact {
  std::optional<float> radius = {};  // m: contact distance; default: 2 * particle_radius
  std::optional<float> gap = {};     // m: margin of the search for pairs; default: radius / 3
};

struct VbdOptions {
  int32_t iterations = 10;         // number of sweeps over all colors, >= 0
  float friction_epsilon = 1e-2f;  // m/s, > 0: slip speed at which friction reaches its limit
  VbdInitialGuess initial_guess = VbdInitialGuess::Inertia;
  // The spectral radius of Chebyshev acceleration, in (0, 1). Particles with contacts are not
  // accelerated. Above 0.8 the iteration may stall or diverge.
  std::optional<float> acceleration = {};
  // The relative residual (VbdResidual::relative, > 0) at which the iterations of a connected
  // component end. Each iteration then computes the forces once more. With `converged` all
  // iterations run first, and Newton's method then continues to this residual (default 1e-4).
  std::optional<float> tolerance = {};
  // Halves the step of a particle up to four times while the energy of its elements would rise. If
  // the energy still rises, the particle stays in place. The total energy therefore never rises.
  // Not supported together with acceleration.
  bool safeguard = false;
  // Adds one step of Galerkin's method after each iteration (coarse_kernels.h). The step removes
  // errors that are smooth over many particles. No effect with acceleration, safeguard or
  // self_contact, or in a model with dynamic bodies; options() then returns false.
  bool coarse = false;
  // Continues after the iterations with Newton's method, until the step is at a minimum of its
  // energy (see DifferentiableVbd, implicit gradients). Supported on the CPU, outside of captures.
  bool converged = false;
  float lhs_regularization = 1e-6f;  // see vbd/block_law.h; finite, >= 0
  // Makes surfaces push each other apart and never cross (src/self_contact.h). Supported on the
  // CPU, outside of captures. Not supported with tolerance, converged, acceleration or safeguard.
  std::optional<VbdSelfContact> self_contact = {};
};

// The contacts between surfaces at the end of a step, with one row for each contact.
struct VbdSelfContacts {
  // A vertex and the corners of a triangle, or the ends of two edges (particle indices).
  std::vector<std::array<int32_t, 4>> particles;
  std::vector<char> has_edges;  // 1: two edges, 0: a vertex and a triangle
  std::vector<float> gaps;      // m: distance between the two features
  std::vector<float> forces;    // N: normal force
};

// How far the last step is from its solution. Each connected component of particles has a residual.
// The values are those of the worst component. Components whose `relative` is above twice their
// `floor` come first, and among these the largest `relative` decides.
struct VbdResidual {
  double force = 0.0;  // N: norm over the particles of the total force, with inertia
  // N: the scale of the forces, a norm over the particles of a + b. a is |m (y - xn - h vc)|/h^2,
  // with the inertial position y, the position xn before the step, and the mean velocity vc of the
  // component. b is the sum of the norms of the forces from the particle's contacts and elements. A
  // uniform motion does not change the scale.
  double scale = 0.0;
  double relative = 0.0;  // force / scale; 0 where the force is 0
  double floor = 0.0;     // the value of `relative` that one rounding of the positions can cause
  int32_t iterations = 0;
};

// The solver supports particles with springs, triangles, bending edges, tetrahedra, external
// forces, gravity, and soft contacts with shapes of the world. On the CPU it also supports rigid
// bodies with their contacts and joints (src/bodies.h), and contacts of particles with bodies,
// which act on both. The following features are not supported. The constructor or the step raises
// ErrorKind::NotImplemented and names the feature:
// - bodies on a device or in a capture;
// - D6, PLANAR and mimic joints, actuators, velocity limits, drives of BALL joints;
// - `tolerance` and `converged` in a model with bodies;
// - drag and lift of triangles;
// - particle_adhesion;
// - a particle_max_velocity below its default;
// - a soft_contact_kf or shape_material_kf other than the default, because friction_epsilon sets
// the friction below the cone;
// - restitution;
// - a particle_spring_control other than 0;
// - on a device: `tolerance`, `converged`, and any step of a build without NOVAPHY_WITH_VBD_CUDA.
// Particles touch each other only as corners of triangles, with `self_contact`.
//
// One step minimizes an energy over the positions x of the particles that move:
//   sum m/(2h^2) |x - y|^2 + E(x; xn),  y = xn + h vn + h^2 (g + f/m)
// E is the sum of the energies of the elements (vbd/elements/). xn and vn are the state at the
// start, h is dt, and y is the inertial position. The new velocity is v = (x - xn)/h.
//
// An iteration visits the colors of the model (ModelBuilder::color, set_coloring) in order. All
// particles of a color move at once. Each particle solves the 3x3 system of its elements, from the
// positions before the color moves. The sums of a particle have a fixed order. The result has the
// same bits for any number of threads, on any processor and on any device.
//
// A step can be captured. A graph keeps the recorded dt. A replay throws if a scalar of the model
// (soft_contact_ke, ...) has changed since the recording. A replay also throws if materials, rest
// shapes, masses or flags were edited, because the solver keeps tables of them. A step on a device
// and a replay cannot throw for values that only the device sees. Kernels then note states that are
// not finite, and contact buffers that overflowed. The next residual() throws, and on the CPU also
// the next step().
//
// Particles of mass 0 or without ParticleFlags.ACTIVE are kinematic. A kinematic particle stays in
// place, or moves to its row of `targets`. Its new velocity is its displacement divided by dt. A
// step does not write to state_in, and particle_f keeps its values.
class NOVAPHY_VBD_API SolverVBD : public SolverBase {
 public:
  // ErrorKind::Value: an invalid option, particles without a color, or a value that EditedValues
  // refuses. ErrorKind::Index: an element refers to a particle that does not exist.
  explicit SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options = {});
  ~SolverVBD() override;

  const VbdOptions& options() const { return options_; }
  // Returns the number of kinematic particles, which is the number of rows of `targets`. The rows
  // are in the order of the particles' indices.
  int32_t kinematic_count() const;
  // Returns true unless `tolerance`, `converged`, self-contact or bodies are used.
  bool supports_graph_capture() const override;

  // Runs one step of dt (s). Errors besides those of SolverBase::step and of the constructor:
  // ErrorKind::Value: the indices of elements or the colors were edited after the solver was made,
  // or states, activations or arrays of the model are not finite.
  // ErrorKind::Index: a contact refers to a shape that does not exist.
  // ErrorKind::Runtime: contacts overflowed, or positions or poses do not stay finite. state_out is
  // then not written. ErrorKind::Runtime: an input carries a gradient under a Tape.
  // ErrorKind::Runtime: `converged` found no solution. state_out then holds the last iterate.
  // ErrorKind::NotImplemented: `converged` in a capture.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    step(state_in, state_out, control, contacts, dt, nullptr);
  }
  // `targets`: {kinematic_count} positions of the kinematic particles at the end of the step (m,
  // world frame). Null: kinematic particles stay in place.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets);
  // Returns the residual of the last step, and waits for the device. ErrorKind::Runtime: no step
  // ran since the solver was made or reset. ErrorKind::Runtime: since the last call, a step on a
  // device or a replay had values that are not finite, or contacts that overflowed. The message
  // names the first such particle. Each fault is reported once.
  VbdResidual residual() const;
  // Returns the self-contacts of the last step. ErrorKind::Value: the solver has no self_contact.
  VbdSelfContacts self_contacts() const;
  // Returns for each joint the force (N) and the moment (N m) on the child at the end of the last
  // step, in the world frame. The force acts at the child's anchor. Joints without rows have zeros:
  // FREE and disabled joints, and joints of two kinematic bodies. ErrorKind::Runtime: no step ran
  // since the solver was made or reset.
  std::vector<SpatialVectorf> joint_forces() const;
  // Forgets the last step. The adaptive guess and residual() read that step.
  void reset();
  void notify_model_changed(ModelFlags flags) override;
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt,
               const RolloutOptions& options = {}) override;

 protected:
  int32_t target_count() const override { return kinematic_count(); }
  // Returns the previous velocities for the adaptive guess, and the multipliers of contacts and
  // joints of bodies.
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
