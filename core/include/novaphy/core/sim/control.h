// Control: the inputs of a step, such as drive targets and joint forces. Model::control() makes a
// control with the values of the model.
#pragma once

#include <cstdint>

#include "novaphy/core/sim/counts.h"
#include "novaphy/core/sim/fields.h"

namespace novaphy {

class Model;

// X(name, element type, width, count, unit, frame, doc)
// clang-format off
#define NOVAPHY_CONTROL_FIELDS(X)                                                                 \
  X(joint_f, float, 1, joint_dof_count, "N or N*m", "joint",                                      \
    "joint forces; the rows of a free joint are a world wrench about the center of mass, "        \
    "force first")                                                                                \
  X(joint_target_q, float, 1, joint_coord_count, "m or rad", "joint",                             \
    "position targets of the drives")                                                             \
  X(joint_target_qd, float, 1, joint_dof_count, "m/s or rad/s", "joint",                          \
    "velocity targets of the drives")                                                             \
  X(joint_act, float, 1, joint_dof_count, "1", "joint", "actuator inputs")                        \
  X(particle_tri_activation, float, 1, tri_count, "1", "", "triangle activations")                \
  X(particle_tet_activation, float, 1, tet_count, "1", "", "tetrahedron activations")             \
  X(ctrl, float, 1, actuator_count, "1", "", "controls of the actuators")
// clang-format on

NOVAPHY_DECLARE_FIELDS(ControlFields, NOVAPHY_CONTROL_FIELDS, ModelCounts)

// Move-only, like SimState. Arrays of a feature that the model lacks have 0 rows.
class NOVAPHY_CORE_API Control : public ControlFields {
 public:
  using Fields = ControlFields;

  explicit Control(const Model& model);  // filled with zeros
  // Makes a control from the counts of a model alone; `model_id` is the id() of the model.
  Control(const ModelCounts& counts, Device device, uint64_t model_id);
  Control(Control&&) = default;
  Control& operator=(Control&&) = default;

  NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_GETTER)
  const ModelCounts& counts() const { return counts_; }
  Device device() const { return device_; }
  uint64_t model_id() const { return model_id_; }
  bool requires_grad = false;

  void clear();                        // sets all arrays to zero
  void assign(const Control& source);  // ErrorKind::Value if the rows of an array or the device
                                       // differ
  Control clone() const;

 private:
  Control(const Control& source, ControlFields fields);

  ModelCounts counts_;
  Device device_;
  uint64_t model_id_ = 0;
};

}  // namespace novaphy
