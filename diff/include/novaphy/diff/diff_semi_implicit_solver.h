// DiffSemiImplicitSolver: the semi-implicit step as generated kernels, recorded on a tape.
#pragma once

#include <memory>

#include "novaphy/diff/export.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/solver_base.h"
#include "novaphy/nova/incidence.h"

namespace novaphy::diff {

struct DiffSolverConfig {
  bool enable_particles = true;
  bool enable_particle_contacts = true;
  bool enable_tetrahedra = false;  // not built yet: ErrorKind::NotImplemented
  bool enable_triangles = false;   // not built yet: ErrorKind::NotImplemented
  bool enable_rigid = true;        // acts on bodies, which no model has yet
  bool enable_rigid_contacts = true;
  float angular_damping = 0.05f;
  float friction_smoothing = 1.0f;
  bool strict = true;  // refuse what is not covered instead of leaving it out
};

// One step runs two generated kernels: contact forces (added to state_in.particle_f in slot order),
// then integration. The result has the bits of SolverSemiImplicit. Inside an active nova::Tape both
// are recorded on the states' own arrays; outside they just run.
//
// Gradients: positions, velocities, applied forces, masses, radii, gravity and contact materials
// are exact; contact points and normals are frozen (collision is not differentiated here). See
// diff_soft_contacts.h and diff_particles.h.
//
// The forces that a step leaves in state_in.particle_f are for reading. Using them as input of
// another recorded step raises: clear_forces() first.
class NOVAPHY_DIFF_API DiffSemiImplicitSolver : public SolverBase {
 public:
  explicit DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                  const DiffSolverConfig& config = {});

  const DiffSolverConfig& config() const { return config_; }

  // Errors as SolverBase::step; ErrorKind::Runtime inside a ScopedCapture, and under `strict` for
  // contacts that overflowed their slots.
  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override;
  bool supports_graph_capture() const override {
    return false;
  }  // of step; rollout may be captured

  // All steps of a trajectory from state 0, contacts and integration in one kernel per step,
  // recorded on an active tape. The states have the bits of a loop of `step` in which every step
  // starts from the force in trajectory.particle_f; that force is only read. May be captured.
  void rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts, float dt);

 private:
  // The slots of every particle, or null when no contact acts.
  const nova::Incidence* contacts_of_particles(const Contacts* contacts);

  DiffSolverConfig config_;
  nova::Incidence contacts_of_;  // of the last contacts
};

}  // namespace novaphy::diff
