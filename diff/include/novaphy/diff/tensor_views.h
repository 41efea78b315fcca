// Tensors over the regular arrays of a state or a model: zero-copy, and the same gradient for every
// view of an array. A view keeps the memory alive. requires_grad = true turns the gradient on for
// the array; false leaves it as it is.
#pragma once

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

// X(field): the views that exist, one function per row.
#define NOVAPHY_STATE_VIEWS(X) \
  X(particle_q) X(particle_qd) X(particle_f) X(body_q) X(body_qd) X(body_f) X(joint_q) X(joint_qd)
#define NOVAPHY_MODEL_VIEWS(X)                                                                 \
  X(particle_mass)                                                                             \
  X(particle_radius) X(gravity) X(shape_material_ke) X(shape_material_kd) X(shape_material_kf) \
      X(shape_material_mu)

namespace novaphy::diff {

// state_particle_q_tensor(state): {n, 3}, m; and so on, with the shapes of the state's fields.
#define NOVAPHY_DECLARE_STATE_VIEW(field)                                     \
  NOVAPHY_DIFF_API nova::Tensor state_##field##_tensor(const SimState& state, \
                                                       bool requires_grad = false);
NOVAPHY_STATE_VIEWS(NOVAPHY_DECLARE_STATE_VIEW)
#undef NOVAPHY_DECLARE_STATE_VIEW

// model_particle_mass_tensor(model): {n}, kg; and so on. Gradients reach the masses, although the
// integrator reads particle_inv_mass: after changing masses call update_inverse_mass.
#define NOVAPHY_DECLARE_MODEL_VIEW(field)                                  \
  NOVAPHY_DIFF_API nova::Tensor model_##field##_tensor(const Model& model, \
                                                       bool requires_grad = false);
NOVAPHY_MODEL_VIEWS(NOVAPHY_DECLARE_MODEL_VIEW)
#undef NOVAPHY_DECLARE_MODEL_VIEW

// particle_inv_mass = 1/particle_mass, 0 where the mass is 0. Not recorded on a tape.
NOVAPHY_DIFF_API void update_inverse_mass(Model& model);

}  // namespace novaphy::diff
