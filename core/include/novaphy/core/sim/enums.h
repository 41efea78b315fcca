// The enumerations of the model. Their values are public: int32 arrays store them, and they equal
// the values of Newton 1.8.
#pragma once

#include <cstdint>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/shape_types.h"
#include "novaphy/math/types.h"

namespace novaphy {

enum class Axis : int32_t { X = 0, Y = 1, Z = 2 };

// Returns "PLANE" and so on, or "unknown" for any other value.
NOVAPHY_CORE_API const char* geo_type_name(GeoType type);

// Bit masks of the *_flags arrays.
enum class ParticleFlags : int32_t { ACTIVE = 1 };
enum class ShapeFlags : int32_t {
  VISIBLE = 1,
  COLLIDE_SHAPES = 2,
  COLLIDE_PARTICLES = 4,
  SITE = 8
};
// KINEMATIC: the body keeps moving with its velocity, and no force changes the velocity.
enum class BodyFlags : int32_t { DYNAMIC = 1, KINEMATIC = 2 };

enum class JointType : int32_t;  // joint_types.h
// Returns "PRISMATIC" and so on, or "unknown" for any other value.
NOVAPHY_CORE_API const char* joint_type_name(JointType type);

// The modes of a drive. A drive has a spring target_ke (target_q - q) and a damper target_kd
// (target_qd - qd) for each dof. The modes select its forces:
//   NONE, EFFORT        no force
//   POSITION            the spring, and the damper -target_kd qd
//   VELOCITY            the damper
//   POSITION_VELOCITY   the spring and the damper
enum class JointTargetMode : int32_t {
  NONE = 0,
  POSITION = 1,
  VELOCITY = 2,
  POSITION_VELOCITY = 3,
  EFFORT = 4,
};

// How the activation `act` of an actuator depends on its control.
enum class ActuatorDynamics : int32_t {
  NONE = 0,          // no activation: the control acts at once
  INTEGRATOR = 1,    // act' = control
  FILTER = 2,        // act' = (control - act) / time, explicit Euler
  FILTER_EXACT = 3,  // the same law, integrated exactly
};

// Axes of an actuator that acts on bodies. Combine the bits with |.
enum class ActuatorAxes : int32_t {
  FRAME = 0,             // force and moment have the axes of the actuator's frame; the length is 0
  REFERENCE_FORCE = 1,   // the force has the axes of the reference frame
  REFERENCE_MOMENT = 2,  // the moment has the axes of the reference frame
  LENGTH = 4,            // the length is the pose of the frame in the reference frame
};

// The kinds of edits that SolverBase::notify_model_changed reports. Combine the bits with |.
enum class ModelFlags : int32_t {
  JOINT_PROPERTIES = 1,
  JOINT_DOF_PROPERTIES = 2,
  BODY_PROPERTIES = 4,
  BODY_INERTIAL_PROPERTIES = 8,
  SHAPE_PROPERTIES = 16,
  MODEL_PROPERTIES = 32,
  ALL = 63,
};
constexpr ModelFlags operator|(ModelFlags a, ModelFlags b) {
  return static_cast<ModelFlags>(static_cast<int32_t>(a) | static_cast<int32_t>(b));
}

// Returns whether an element of a *_flags array has every bit of `flag`.
template <class Flag>
constexpr bool has_flag(int32_t flags, Flag flag) {
  return (flags & static_cast<int32_t>(flag)) == static_cast<int32_t>(flag);
}

// Returns the unit vector of an axis.
constexpr Vec3f axis_vector(Axis axis) {
  return {axis == Axis::X ? 1.0f : 0.0f, axis == Axis::Y ? 1.0f : 0.0f,
          axis == Axis::Z ? 1.0f : 0.0f};
}

}  // namespace novaphy
