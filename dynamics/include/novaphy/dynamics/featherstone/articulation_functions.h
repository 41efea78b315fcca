// Functions of the dynamics of articulations, of all of a model at once.
//
// A is the number of articulations, D the largest number of dofs of one, and L the largest number
// of joints. Matrices are padded with zeros to D and L.
//
// Dofs, rates and tangents are those of articulation/tree.h. A FREE joint moves the center of mass
// and turns the body about it, in the axes of the joint's frame in the parent. Forces of dofs do
// work on rates: of a FREE joint at the world, in such axes, a force and a torque about the center
// of mass.
//
// Derivatives by q are by tangents, one column per dof. Armature is part of the mass matrix.
// Wrenches on bodies, drives and limits take no part. With mimic joints, forward dynamics and its
// derivatives are those of the joined tree, all else of the free one.
//
// The functions run where the model is, with the same bits, and wait for their results:
// ErrorKind::Runtime inside a capture. Each reads joint_q and joint_qd of `state`. All throw
// ErrorKind::NotImplemented as Articulations does, and ErrorKind::Value, naming the argument, for a
// state of another model or a wrong size.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Row-major {count, rows, columns}.
struct ArticulationMatrices {
  int64_t count = 0, rows = 0, columns = 0;
  std::vector<float> values = {};
};

// qdd {dofs} to the forces of dofs that make them (N, N m). A qdd of 0 gives the bias: gravity,
// Coriolis and centrifugal forces.
NOVAPHY_DYNAMICS_API std::vector<float> eval_inverse_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> qdd);
NOVAPHY_DYNAMICS_API std::vector<float> eval_bias(const Model& model, const SimState& state);
// tau {dofs} to the accelerations of dofs. ErrorKind::Runtime, naming the dof: a singular mass
// matrix.
NOVAPHY_DYNAMICS_API std::vector<float> eval_forward_dynamics(const Model& model,
                                                              const SimState& state,
                                                              std::span<const float> tau);
// {A, D, D}
NOVAPHY_DYNAMICS_API ArticulationMatrices eval_mass_matrix(const Model& model,
                                                           const SimState& state,
                                                           bool include_armature = true);
// {A, 6 L, D}: rates of dofs to body_qd of the joints' children, joint by joint.
NOVAPHY_DYNAMICS_API ArticulationMatrices eval_jacobian(const Model& model, const SimState& state);

// {A, D, D} each.
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

// {A}: world, m. Of an articulation without mass 0.
NOVAPHY_DYNAMICS_API std::vector<Vec3f> eval_center_of_mass(const Model& model,
                                                            const SimState& state);
// {A}: kinetic and potential, J; without armature, the potential against the world's origin.
NOVAPHY_DYNAMICS_API std::vector<Vec2f> eval_energy(const Model& model, const SimState& state);
// The forces of the actuators at a state, before their gears. `control` null: the model's.
// ErrorKind::Value: a state or control of another model.
NOVAPHY_DYNAMICS_API std::vector<float> eval_actuator_forces(const Model& model,
                                                             const SimState& state,
                                                             const Control* control);

}  // namespace novaphy
