// Dynamics functions for all articulations of a model at once.
//
// A is the number of articulations, D the largest number of dofs of one, and L the largest number
// of joints. Matrices are padded with zeros to D and L.
//
// Dofs, rates and tangents are those of articulation/tree.h. A FREE joint moves the center of mass
// and rotates the body about it, in the axes of the joint's frame in the parent. Forces of dofs are
// dual to rates. For a FREE joint to the world they are a force and a torque about the center of
// mass, in these axes.
//
// Derivatives by q are by tangents, one column per dof. Armature is part of the mass matrix.
// Wrenches on bodies, drives and limits are not included. Forward dynamics and its derivatives
// include mimic constraints; all other functions ignore them.
//
// The functions run on the model's device with the same bits, and wait for their results.
// ErrorKind::Runtime: called inside of a capture. Each function reads joint_q and joint_qd of
// `state`. All throw ErrorKind::NotImplemented as Articulations does, and ErrorKind::Value with the
// argument for a state of another model or a wrong size.
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

// Returns the forces of dofs (N, N m) for accelerations qdd {dofs}. A qdd of 0 gives the bias:
// gravity, Coriolis and centrifugal forces.
NOVAPHY_DYNAMICS_API std::vector<float> eval_inverse_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> qdd);
NOVAPHY_DYNAMICS_API std::vector<float> eval_bias(const Model& model, const SimState& state);
// Returns the accelerations of dofs for forces tau {dofs}. ErrorKind::Runtime with the dof: the
// mass matrix is singular.
NOVAPHY_DYNAMICS_API std::vector<float> eval_forward_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> tau);
// Returns the mass matrices {A, D, D}.
NOVAPHY_DYNAMICS_API ArticulationMatrices eval_mass_matrix(const Model& model,
                                                           const SimState& state,
                                                           bool include_armature = true);
// Returns the Jacobians {A, 6 L, D} from rates of dofs to body_qd of the joints' children, joint by
// joint.
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

// Returns the centers of mass {A} (m, world); 0 for an articulation without mass.
NOVAPHY_DYNAMICS_API std::vector<Vec3f> eval_center_of_mass(const Model& model,
                                                            const SimState& state);
// Returns kinetic and potential energy {A} (J), without armature. The potential is relative to the
// world's origin.
NOVAPHY_DYNAMICS_API std::vector<Vec2f> eval_energy(const Model& model, const SimState& state);
// Returns the forces of the actuators at a state, before their gears. Null `control`: the model's.
// ErrorKind::Value: a state or control of another model.
NOVAPHY_DYNAMICS_API std::vector<float> eval_actuator_forces(const Model& model,
                                                             const SimState& state,
                                                             const Control* control);

}  // namespace novaphy
