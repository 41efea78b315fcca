// The arrays of a model that describe its actuators. model.h explains the arguments of X.
#pragma once

// novaphy/dynamics/articulation/actuation.h has the law of actuators. A range is (lower, upper);
// (-1e10, 1e10) means no limit.
#define NOVAPHY_MODEL_ACTUATOR_FIELDS(X)                                                          \
  X(actuator_dof, int32_t, 1, actuator_count, "", "",                                             \
    "dof that the actuator drives; -1: the actuator acts on bodies")                              \
  X(actuator_body, Vec2i, 1, actuator_count, "", "",                                              \
    "for an actuator on bodies: the body and the reference body; -1: the world")                  \
  X(actuator_axes, int32_t, 1, actuator_count, "", "", "ActuatorAxes bits (actuators on bodies)") \
  X(actuator_frame, Transformf, 1, actuator_count, "m, 1", "body",                                \
    "for an actuator on bodies: the frame at which the body gets the wrench")                     \
  X(actuator_reference, Transformf, 1, actuator_count, "m, 1", "body, or world",                  \
    "for an actuator on bodies: the frame at which the reference body gets the opposite wrench")  \
  X(actuator_wrench, SpatialVectorf, 1, actuator_count, "1, m", "",                               \
    "for an actuator on bodies: force and moment per unit of actuator force")                     \
  X(actuator_state, int32_t, 1, actuator_count, "", "", "row in act; -1: without dynamics")       \
  X(actuator_dynamics, int32_t, 1, actuator_count, "", "", "ActuatorDynamics")                    \
  X(actuator_gear, float, 1, actuator_count, "1", "",                                             \
    "ratio of actuator length to joint position, and of joint force to actuator force")           \
  X(actuator_gain, Vec3f, 1, actuator_count, "N or N*m", "",                                      \
    "force per control: constant, per actuator length, per actuator rate")                        \
  X(actuator_bias, Vec3f, 1, actuator_count, "N or N*m", "",                                      \
    "force without a control: constant, per actuator length, per actuator rate")                  \
  X(actuator_time, float, 1, actuator_count, "s", "", "time constant of a filter")                \
  X(actuator_ctrl_range, Vec2f, 1, actuator_count, "1", "", "least and largest control")          \
  X(actuator_force_range, Vec2f, 1, actuator_count, "N or N*m", "", "least and largest force")    \
  X(actuator_act_range, Vec2f, 1, actuator_count, "1", "", "least and largest activation")        \
  X(ctrl, float, 1, actuator_count, "1", "", "initial controls of the actuators")                 \
  X(act, float, 1, actuator_state_count, "1", "", "initial activations of the actuators")
