// SimState: the part of a scene that changes over time. Model::state() makes a state. A state may
// also be a view of given arrays, as in a trajectory.
#pragma once

#include <cstdint>

#include "novaphy/core/sim/counts.h"
#include "novaphy/core/sim/fields.h"

namespace novaphy {

class Model;

// X(name, element type, width, count, unit, frame, doc, role)
// clang-format off
#define NOVAPHY_STATE_FIELDS(X)                                                                   \
  X(particle_q, Vec3f, 1, particle_count, "m", "world", "particle positions",                     \
    Carried)                                                                                      \
  X(particle_qd, Vec3f, 1, particle_count, "m/s", "world", "particle velocities",                 \
    Carried)                                                                                      \
  X(particle_f, Vec3f, 1, particle_count, "N", "world",                                           \
    "particle forces: before a step the external forces; after a step also the forces that the "  \
    "solver added", Applied)                                                                      \
  X(body_q, Transformf, 1, body_count, "m, 1", "world",                                           \
    "poses of the body origins: position, quaternion xyzw", Carried)                              \
  X(body_qd, SpatialVectorf, 1, body_count, "m/s, rad/s", "world",                                \
    "velocity of the center of mass, then angular velocity", Carried)                             \
  X(body_f, SpatialVectorf, 1, body_count, "N, N*m", "world",                                     \
    "force, then moment about the center of mass", Applied)                                       \
  X(body_sleep, Vec2i, 1, body_count, "", "",                                                     \
    "time (us) for which the body has been slow, negative while it sleeps; then the first body "  \
    "of its island, if it sleeps", Carried)                                                       \
  X(joint_q, float, 1, joint_coord_count, "m or rad", "joint", "joint coordinates",               \
    Carried)                                                                                      \
  X(joint_qd, float, 1, joint_dof_count, "m/s or rad/s", "joint", "joint velocities", Carried)    \
  X(act, float, 1, actuator_state_count, "1", "", "activations of the actuators with dynamics",   \
    Carried)
// clang-format on

NOVAPHY_DECLARE_FIELDS(StateFields, NOVAPHY_STATE_FIELDS, ModelCounts)

// Arrays of a feature that the model lacks have 0 rows. The arrays are public handles: values may
// be written, but sizes must stay (solvers check). Move-only, because two copies of the handles
// would share memory; clone() copies the values.
class NOVAPHY_CORE_API SimState : public StateFields {
 public:
  using Fields = StateFields;

  // Makes a state filled with zeros on the model's device. Model::state() also copies the initial
  // values.
  explicit SimState(const Model& model);
  // Makes a state from the counts of a model alone; `model_id` is the id() of the model.
  SimState(const ModelCounts& counts, Device device, uint64_t model_id);
  // Makes a state of existing arrays, for example ranges of one long allocation. ErrorKind::Value
  // names an array whose rows or device differ from the model's.
  SimState(const Model& model, StateFields fields);
  SimState(SimState&&) = default;
  SimState& operator=(SimState&&) = default;

  NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_GETTER)
  const ModelCounts& counts() const { return counts_; }
  Device device() const { return device_; }
  uint64_t model_id() const { return model_id_; }  // Model::id() of its model
  bool requires_grad = false;

  // Sets the applied arrays, particle_f and body_f, to zero.
  void clear_forces();
  // Copies all values. ErrorKind::Value: the rows of an array or the device differ.
  void assign(const SimState& source);
  SimState clone() const;

 private:
  SimState(const SimState& source, StateFields fields);

  ModelCounts counts_;
  Device device_;
  uint64_t model_id_ = 0;
};

}  // namespace novaphy
