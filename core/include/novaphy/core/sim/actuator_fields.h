// The arrays of a model that describe its actuators. model.h explains the arguments of X.
#pragma once

// novaphy/dynamics/articulation/actuation.h has the law of actuators. A range is (lower, upper);
// (-1e10, 1e10) means no limit.
#define NOVAPHY_MODEL_ACTUATOR_FIELDS(X)                                                          \
  X(actuator_dof, int32_t, 1, actuator_count, "", "",                                             \
    "degree of freedom of the actuator; -1: it pushes bodies")                                    \
  X(actuator_body, Vec2i, 1, actuator_count, "", "",                                              \
    "of an actuator without one: what it pushes, and against what; -1: the world")                \
  X(actuator_axes, int32_t, 1, actuator_count, "", "", "likewise: bits of ActuatorAxes")          \
  X(actuator_frame, Transformf, 1, actuator_count, "m, 1", "body",                                \
    "likewise: the frame that is pushed")                                                         \
  X(actuator_reference, Transformf, 1, actuator_count, "m, 1", "body, or world",                  \
    "likewise: the frame that is pushed back")                                                    \
  X(actuator_wrench, SpatialVectorf, 1, actuator_count, "1, m", "",                               \
    "likewise: force and moment of a force of 1")                                                 \
  X(actuator_state, int32_t, 1, actuator_count, "", "", "its row of act; -1: it has no dynamics") \
  X(actuator_dynamics, int32_t, 1, actuator_count, "", "", "ActuatorDynamics")                    \
  X(actuator_gear, float, 1, actuator_count, "1", "",                                             \
    "its length and rate are those of the joint times the gear, and so is the joint's force")     \
  X(actuator_gain, Vec3f, 1, actuator_count, "N or N*m", "",                                      \
    "force per control: a number, per length, per rate")                                          \
  X(actuator_bias, Vec3f, 1, actuator_count, "N or N*m", "",                                      \
    "force without a control: a number, per length, per rate")                                    \
  X(actuator_time, float, 1, actuator_count, "s", "", "time constant of a filter")                \
  X(actuator_ctrl_range, Vec2f, 1, actuator_count, "1", "", "least and largest control")          \
  X(actuator_force_range, Vec2f, 1, actuator_count, "N or N*m", "", "least and largest force")    \
  X(actuator_act_range, Vec2f, 1, actuator_count, "1", "", "least and largest activation")        \
  X(ctrl, float, 1, actuator_count, "1", "", "initial ctrl of a control")                         \
  X(act, float, 1, actuator_state_count, "1", "", "initial activations")
