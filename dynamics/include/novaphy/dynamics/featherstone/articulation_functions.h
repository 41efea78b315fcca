// Dynamics functions (inverse and forward dynamics, mass matrix, Jacobian, energy) for all
// articulations of a model at once.
//
// A is the number of articulations, D the largest number of dofs of an articulation, and L the
// largest number of joints. Smaller articulations are padded with zeros to D and L.
//
// Dofs, rates and tangents are those of articulation/tree.h. The dofs of a FREE joint are the
// velocity of the center of mass and the angular velocity, in the axes of the joint's frame in the
// parent. The force of a dof times its rate is a power. For a FREE joint to the world the forces
// are a force and a torque about the center of mass, in the same axes.
//
// Derivatives by q are by tangents: one column per dof. The mass matrix includes armature. The
// functions do not include wrenches on bodies, drives and limits. Forward dynamics and its
// derivatives include mimic constraints; the other functions ignore them.
//
// The functions run on the model's device with the same bits as on the CPU, wait for their results,
// and read joint_q and joint_qd of `state`. ErrorKind::Runtime: a call inside of a capture.
// ErrorKind::NotImplemented: a model that Articulations does not support. ErrorKind::Value, with
// the argument: a state of another model or a wrong size.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Row-major matrices {count, rows, columns}.
struct ArticulationMatrices {
  int64_t count = 0, rows = 0, columns = 0;
  std::vector<float> values = {};
};

// Returns the forces {dofs} (N, N m) that give the accelerations qdd {dofs}. With qdd = 0 the
// result is the bias: Coriolis and centrifugal forces minus gravity forces.
NOVAPHY_DYNAMICS_API std::vector<float> eval_inverse_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> qdd);
NOVAPHY_DYNAMICS_API std::vector<float> eval_bias(const Model& model, const SimState& state);
// Returns the accelerations {dofs} for forces tau {dofs}. ErrorKind::Runtime, with the dof: the
// mass matrix is singular.
NOVAPHY_DYNAMICS_API std::vector<float> eval_forward_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> tau);
// Returns the mass matrices {A, D, D}.
NOVAPHY_DYNAMICS_API ArticulationMatrices eval_mass_matrix(const Model& model,
                                                           const SimState& state,
                                                           bool include_armature = true);
// Returns the Jacobians {A, 6 L, D}. Six rows per joint give body_qd of the joint's child from the
// rates of the dofs.
NOVAPHY_DYNAMICS_API ArticulationMatrices eval_jacobian(const Model& model, const SimState& state);

// Matrices {A, D, D} each.
struct InverseDynamicsDerivatives {
  ArticulationMatrices dtau_dq = {}, dtau_dqd = {}, mass_matrix = {};
};
NOVAPHY_DYNAMICS_API InverseDynamicsDerivatives eval_inverse_dynamics_derivatives(
    const Model& model, const SimState& state, std::span<const float> qdd);
struct ForwardDynamicsDerivatives {
  ArticulationMatrices dqdd_dq = {}, dqdd_dqd = {}, inverse_mass_matrix = {};
};
NOVAPHY_DYNAMICS_API ForwardDynamicsDerivatives eval_forward_dynamics_derivatives(
    const Model& model, const SimState& state, std::span<const float> tau);

// Returns the centers of mass {A} (m, world). An articulation without mass gets 0.
NOVAPHY_DYNAMICS_API std::vector<Vec3f> eval_center_of_mass(const Model& model,
                                                            const SimState& state);
// Returns kinetic and potential energy {A} (J), without armature. The potential energy is 0 with
// the center of mass at the world's origin.
NOVAPHY_DYNAMICS_API std::vector<Vec2f> eval_energy(const Model& model, const SimState& state);
// Returns the force of each actuator at a state, before the gear. Null `control`: the model's
// default control. ErrorKind::Value: a state or control of another model.
NOVAPHY_DYNAMICS_API std::vector<float> eval_actuator_forces(const Model& model,
                                                             const SimState& state,
                                                             const Control* control);

}  // namespace novaphy
