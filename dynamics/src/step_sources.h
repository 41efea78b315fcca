// The source and the name of each array of a step (articulation/step_arrays.h).
#pragma once

#include <array>

#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/trajectory.h"
#include "novaphy/dynamics/articulation/step_places.h"

namespace novaphy {

// An array's source is the state, the control if there is one, or else the model.
struct StepSource {
  using Scalar = float;
  template <articulation::RowOf, class Value>
  struct Array {
    const char* name = nullptr;
    DeviceArray<Value> Model::*in_model = nullptr;
    DeviceArray<Value> Control::*in_control = nullptr;
    DeviceArray<Value> SimState::*in_state = nullptr;

    constexpr bool is_constant() const { return in_state == nullptr && in_control == nullptr; }
    const DeviceArray<Value>* find(const Model& m, const SimState* state,
                                   const Control* control) const {
      if (in_state != nullptr) return state != nullptr ? &(state->*in_state) : nullptr;
      return control != nullptr && in_control != nullptr ? &(control->*in_control) : &(m.*in_model);
    }
  };
};
inline constexpr articulation::StepArrays<StepSource> kStepSources = {
    {.q = {"state_in.joint_q", nullptr, nullptr, &SimState::joint_q},
     .qd = {"state_in.joint_qd", nullptr, nullptr, &SimState::joint_qd},
     .joint_f = {"joint_f", &Model::joint_f, &Control::joint_f},
     .body_f = {"state_in.body_f", nullptr, nullptr, &SimState::body_f},
     .target_q = {"joint_target_q", &Model::joint_target_q, &Control::joint_target_q},
     .target_qd = {"joint_target_qd", &Model::joint_target_qd, &Control::joint_target_qd},
     .target_ke = {"model.joint_target_ke", &Model::joint_target_ke},
     .target_kd = {"model.joint_target_kd", &Model::joint_target_kd},
     .damping = {"model.joint_damping", &Model::joint_damping},
     .armature = {"model.joint_armature", &Model::joint_armature},
     .limit_lower = {"model.joint_limit_lower", &Model::joint_limit_lower},
     .limit_upper = {"model.joint_limit_upper", &Model::joint_limit_upper},
     .limit_ke = {"model.joint_limit_ke", &Model::joint_limit_ke},
     .limit_kd = {"model.joint_limit_kd", &Model::joint_limit_kd},
     .effort_limit = {"model.joint_effort_limit", &Model::joint_effort_limit},
     .velocity_limit = {"model.joint_velocity_limit", &Model::joint_velocity_limit},
     .mass = {"model.body_mass", &Model::body_mass},
     .com = {"model.body_com", &Model::body_com},
     .inertia = {"model.body_inertia", &Model::body_inertia},
     .gravity = {"model.gravity", &Model::gravity}},
    {.X_p = {"model.joint_X_p", &Model::joint_X_p},
     .X_c = {"model.joint_X_c", &Model::joint_X_c},
     .axis = {"model.joint_axis", &Model::joint_axis}}};

// A named array of a step, at its index in the list.
struct NamedStepArray {
  const char* name;
  const Array* array;  // null: the array belongs to a state, and no state is given
  bool is_constant;
};
using NamedStepArrays = std::array<NamedStepArray, kStepArrays>;
NamedStepArrays step_arrays(const Model& model, const SimState* state, const Control* control);

}  // namespace novaphy
