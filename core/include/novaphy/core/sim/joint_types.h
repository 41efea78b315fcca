// The types of joints, with the traits that the builder, solvers, file readers and Python need.
//
// A type is one line of the list. dynamics/articulation/joints/ has the kinematics of each type.
#pragma once

#include <cstdint>

#include "novaphy/core/sim/enums.h"

namespace novaphy {

// The constraint between the two frames of a joint.
enum class JointConstraint : int32_t {
  AXES,      // the frames coincide, except for motions along and about the axes
  DISTANCE,  // the origins keep a distance
  NONE,
};

// The number of axes that the caller of ModelBuilder::add_joint gives.
struct JointAxisCount {
  int32_t least = 0, most = 0;
};

struct JointTraits {
  // Axes of the type. Each axis is a degree of freedom with a coordinate, a drive, limits, damping
  // and actuators.
  JointAxisCount linear_axes = {}, angular_axes = {};
  int32_t linear = 0, angular = 0;  // degrees of freedom besides those of the axes
  int32_t quaternion = -1;          // index of its first coordinate; -1: no quaternion
  bool is_chain = false;            // an articulation has one link per axis, in the order of the
                                    // axes
  JointConstraint constraint = JointConstraint::AXES;
};

// X(name, value, traits). Each type with its number of coordinates and degrees of freedom:
//   PRISMATIC (1, 1) along an axis      REVOLUTE (1, 1) about an axis, not wrapped
//   BALL      (4, 3) quaternion xyzw; angular velocity of the child relative to the parent
//   FIXED     (0, 0)
//   FREE      (7, 6) position, quaternion xyzw; velocity of the child's center of mass, then
//                    angular velocity, relative to the parent
//   DISTANCE  (7, 6) as FREE; the origins of the joint frames keep a distance
//   D6        (n, n) translations along n_l axes, then rotations about n_a transported axes
//   ROD       (7, 6) as FREE; springs pull the joint frames together (rods.h)
//   PLANAR    (3, 3) translations x and y along two perpendicular axes, then an angle about their
//                    normal
// Coordinates have the axes of the joint frame of the parent. The values equal those of Newton 1.8,
// which has no PLANAR joint.
#define NOVAPHY_JOINT_TYPES(X)                                                                  \
  X(PRISMATIC, 0, {.linear_axes = {1, 1}})                                                      \
  X(REVOLUTE, 1, {.angular_axes = {1, 1}})                                                      \
  X(BALL, 2, {.angular = 3, .quaternion = 0})                                                   \
  X(FIXED, 3, {})                                                                               \
  X(FREE, 4, {.linear = 3, .angular = 3, .quaternion = 3, .constraint = JointConstraint::NONE}) \
  X(DISTANCE, 5,                                                                                \
    {.linear = 3, .angular = 3, .quaternion = 3, .constraint = JointConstraint::DISTANCE})      \
  X(D6, 6, {.linear_axes = {0, 3}, .angular_axes = {0, 3}, .is_chain = true})                   \
  X(ROD, 7, {.linear = 3, .angular = 3, .quaternion = 3, .constraint = JointConstraint::NONE})  \
  X(PLANAR, 8, {.linear_axes = {2, 2}, .angular_axes = {1, 1}, .is_chain = true})

// The values of Model::joint_type.
enum class JointType : int32_t {
#define NOVAPHY_VALUE(name, value, ...) name = value,
  NOVAPHY_JOINT_TYPES(NOVAPHY_VALUE)
#undef NOVAPHY_VALUE
};

constexpr JointTraits joint_traits(JointType type) {
  switch (type) {
#define NOVAPHY_TRAITS(name, value, ...) \
  case JointType::name:                  \
    return __VA_ARGS__;
    NOVAPHY_JOINT_TYPES(NOVAPHY_TRAITS)
#undef NOVAPHY_TRAITS
  }
  return {};
}
// Returns the index of a joint's first quaternion coordinate; -1: no quaternion.
constexpr int32_t quaternion_at(JointType type) { return joint_traits(type).quaternion; }
// Returns whether the coordinates of a joint are a pose: FREE, DISTANCE and ROD joints.
constexpr bool has_pose(JointType type) { return quaternion_at(type) == 3; }
// Returns whether a joint has axes, and so drives, limits and actuators.
constexpr bool has_axes(JointType type) {
  const JointTraits t = joint_traits(type);
  return t.linear_axes.most + t.angular_axes.most > 0;
}
constexpr bool can_move(JointType type) {
  const JointTraits t = joint_traits(type);
  return has_axes(type) || t.linear + t.angular > 0;
}
// Returns the number of coordinates of a joint with `axes` axes.
constexpr int32_t coordinate_count(JointType type, int32_t axes) {
  const JointTraits t = joint_traits(type);
  return axes + t.linear + t.angular + (t.quaternion >= 0 ? 1 : 0);
}

}  // namespace novaphy
