// Tensors over the arrays of a state, a control or a model, without a copy. All views of an array
// share one gradient. A view keeps the memory alive. requires_grad = true turns the array's
// gradient on; false leaves it as it is.
#pragma once

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/diff/export.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/nova/tensor.h"

// X(field) for each view of an array of a state.
#define NOVAPHY_STATE_VIEWS(X) \
  X(particle_q)                \
  X(particle_qd) X(particle_f) X(body_q) X(body_qd) X(body_f) X(joint_q) X(joint_qd) X(act)
#define NOVAPHY_MODEL_VIEWS(X) \
  X(particle_mass)             \
  X(particle_radius)           \
  X(body_mass)                 \
  X(body_inertia)              \
  X(body_com)                  \
  X(joint_target_ke)           \
  X(joint_target_kd)           \
  X(joint_damping)             \
  X(joint_friction)            \
  X(actuator_gear)             \
  X(actuator_wrench)           \
  X(actuator_gain)             \
  X(actuator_bias)             \
  X(actuator_time)             \
  X(actuator_ctrl_range)       \
  X(actuator_force_range)      \
  X(actuator_act_range)        \
  X(body_gravcomp)             \
  X(gravity)                   \
  X(body_fluid_box)            \
  X(fluid_density)             \
  X(fluid_viscosity)           \
  X(fluid_wind)                \
  X(shape_material_ke)         \
  X(shape_material_kd)         \
  X(shape_material_kf)         \
  X(shape_material_mu)         \
  X(shape_material_restitution)
// X(name, field) for views of arrays of elements. `name` is the field without its prefix.
#define NOVAPHY_ELEMENT_VIEWS(X)                     \
  X(tet_activation, particle_tet_activation)         \
  X(tet_material, particle_tet_material)             \
  X(tri_activation, particle_tri_activation)         \
  X(tri_material, particle_tri_material)             \
  X(spring_stiffness, particle_spring_stiffness)     \
  X(spring_damping, particle_spring_damping)         \
  X(spring_rest_length, particle_spring_rest_length) \
  X(edge_material, particle_edge_material)           \
  X(edge_rest_angle, particle_edge_rest_angle)
#define NOVAPHY_CONTROL_VIEWS(X)             \
  X(tet_activation, particle_tet_activation) \
  X(tri_activation, particle_tri_activation) \
  X(joint_f, joint_f)                        \
  X(joint_target_q, joint_target_q)          \
  X(joint_target_qd, joint_target_qd)        \
  X(ctrl, ctrl)

namespace novaphy::diff {

// For example, state_particle_q_tensor(state) returns {n, 3} (m). Shapes are those of the state's
// fields.
#define NOVAPHY_DECLARE_STATE_VIEW(field)                                     \
  NOVAPHY_DIFF_API nova::Tensor state_##field##_tensor(const SimState& state, \
                                                       bool requires_grad = false);
NOVAPHY_STATE_VIEWS(NOVAPHY_DECLARE_STATE_VIEW)
#undef NOVAPHY_DECLARE_STATE_VIEW

// For example, model_particle_mass_tensor(model) returns {n} (kg). Integrators read the inverses of
// masses and inertias, which are derived from these arrays (Model::update_derived). Gradients reach
// the arrays nevertheless.
#define NOVAPHY_DECLARE_MODEL_VIEW(field)                                  \
  NOVAPHY_DIFF_API nova::Tensor model_##field##_tensor(const Model& model, \
                                                       bool requires_grad = false);
NOVAPHY_MODEL_VIEWS(NOVAPHY_DECLARE_MODEL_VIEW)
#undef NOVAPHY_DECLARE_MODEL_VIEW

// For example, model_tet_material_tensor(model) returns {tet_count, 3} (Pa). Shapes are those of
// the fields.
#define NOVAPHY_DECLARE_ELEMENT_VIEW(name, field)                         \
  NOVAPHY_DIFF_API nova::Tensor model_##name##_tensor(const Model& model, \
                                                      bool requires_grad = false);
NOVAPHY_ELEMENT_VIEWS(NOVAPHY_DECLARE_ELEMENT_VIEW)
#undef NOVAPHY_DECLARE_ELEMENT_VIEW

// Returns control_tet_activation_tensor {tet_count}, control_tri_activation_tensor {tri_count},
// control_joint_f_tensor and control_joint_target_qd_tensor {joint_dof_count}, and
// control_joint_target_q_tensor {joint_coord_count}. A step reads these arrays from its control,
// or, without a control, from the model.
#define NOVAPHY_DECLARE_CONTROL_VIEW(name, field)                               \
  NOVAPHY_DIFF_API nova::Tensor control_##name##_tensor(const Control& control, \
                                                        bool requires_grad = false);
NOVAPHY_CONTROL_VIEWS(NOVAPHY_DECLARE_CONTROL_VIEW)
#undef NOVAPHY_DECLARE_CONTROL_VIEW

}  // namespace novaphy::diff
