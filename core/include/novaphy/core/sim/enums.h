// The enumerations of the model. The values are part of the public interface (they are stored in
// int32 arrays) and equal Newton 1.8's.
#pragma once

#include <cstdint>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

enum class Axis : int32_t { X = 0, Y = 1, Z = 2 };

// What a row of Model::shape_type holds. `shape_scale` by type:
//   PLANE    (width, length, 0): local +z is the normal; infinite unless both are > 0
//   SPHERE   (radius, 0, 0)
//   CAPSULE  (radius, half_height, 0): along local z, half_height excludes the caps
//   ELLIPSOID (rx, ry, rz): half axes
//   CYLINDER (radius, half_height, 0): along local z
//   BOX      (hx, hy, hz): half extents
//   CONE     (radius, half_height, 0): along local z, apex at +half_height
//   MESH, CONVEX_MESH (x, y, z): factors of the vertices of Model::mesh_vertices
// HFIELD is reserved: adding one raises ErrorKind::NotImplemented.
enum class GeoType : int32_t {
  NONE = 0,
  PLANE = 1,
  HFIELD = 2,
  SPHERE = 3,
  CAPSULE = 4,
  ELLIPSOID = 5,
  CYLINDER = 6,
  BOX = 7,
  MESH = 8,
  CONE = 9,
  CONVEX_MESH = 10,
};
// "PLANE", ...; "unknown" for a value that is none.
NOVAPHY_CORE_API const char* geo_type_name(GeoType type);

// Bit masks of the *_flags arrays.
enum class ParticleFlags : int32_t { ACTIVE = 1 };
enum class ShapeFlags : int32_t {
  VISIBLE = 1,
  COLLIDE_SHAPES = 2,
  COLLIDE_PARTICLES = 4,
  SITE = 8
};
// KINEMATIC: the body follows its velocity; no force moves it.
enum class BodyFlags : int32_t { DYNAMIC = 1, KINEMATIC = 2 };

enum class JointType : int32_t;  // joint_types.h
// "PRISMATIC", ...; "unknown" for a value that is none.
NOVAPHY_CORE_API const char* joint_type_name(JointType type);

// Which of target_ke (target_q - q) and target_kd (target_qd - qd) the drive of a dof has:
//   NONE, EFFORT        none
//   POSITION            the first, and -target_kd qd
//   VELOCITY            the second
//   POSITION_VELOCITY   both
enum class JointTargetMode : int32_t {
  NONE = 0,
  POSITION = 1,
  VELOCITY = 2,
  POSITION_VELOCITY = 3,
  EFFORT = 4,
};

// How the activation of an actuator follows its control.
enum class ActuatorDynamics : int32_t {
  NONE = 0,          // it has none: the control acts at once
  INTEGRATOR = 1,    // act' = control
  FILTER = 2,        // act' = (control - act) / time, explicit
  FILTER_EXACT = 3,  // the same, exactly
};

// Of an actuator that pushes bodies; combine with |.
enum class ActuatorAxes : int32_t {
  FRAME = 0,             // its force and moment have the axes of its frame, and its length is 0
  REFERENCE_FORCE = 1,   // the force has the axes of the reference
  REFERENCE_MOMENT = 2,  // the moment has
  LENGTH = 4,            // its length is the pose of its frame in the reference
};

// What SolverBase::notify_model_changed is told. Combine with |.
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

// True if every bit of `flag` is set in an element of a *_flags array.
template <class Flag>
constexpr bool has_flag(int32_t flags, Flag flag) {
  return (flags & static_cast<int32_t>(flag)) == static_cast<int32_t>(flag);
}

// The unit vector of an axis.
constexpr Vec3f axis_vector(Axis axis) {
  return {axis == Axis::X ? 1.0f : 0.0f, axis == Axis::Y ? 1.0f : 0.0f,
          axis == Axis::Z ? 1.0f : 0.0f};
}

}  // namespace novaphy
