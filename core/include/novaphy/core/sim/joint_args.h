// Arguments of the add_joint_* functions of ModelBuilder.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "novaphy/core/sim/joint_types.h"
#include "novaphy/math/types.h"

namespace novaphy {

// A joint limit of this size is none (Newton's MAXVAL).
inline constexpr float kJointUnlimited = 1.0e10f;

// One degree of freedom of a joint. Units: m and N along an axis, rad and N*m about one. All
// numbers finite; all but the targets and limits >= 0; limit_lower <= limit_upper.
struct JointDofConfig {
  Vec3f axis = {1.0f, 0.0f, 0.0f};  // joint frame of the parent; need not be of unit length
  float limit_lower = -kJointUnlimited, limit_upper = kJointUnlimited;
  float limit_ke = 1.0e4f, limit_kd = 10.0f;  // spring and damper of the limits
  float target_q = 0.0f, target_qd = 0.0f;    // of the drive
  float target_ke = 0.0f, target_kd = 0.0f;   // its gains
  float damping = 0.0f;                       // force per velocity, against it
  float armature = 0.0f;                      // kg or kg m^2, added to the inertia of the dof
  float effort_limit = 1.0e6f;                // of the drive
  float velocity_limit = 1.0e6f, friction = 0.0f;
  JointTargetMode actuator_mode = JointTargetMode::POSITION_VELOCITY;
};

// The options that all joints share. X_p and X_c are the poses of the joint frames in the bodies.
struct JointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  // As many as the type takes (joint_types.h), linearly independent.
  std::vector<JointDofConfig> linear_axes = {}, angular_axes = {};
  bool collision_filter_parent = true;  // shapes of the child do not meet those of the parent
  bool enabled = true;
  std::string label = {};  // "joint_<index>" when empty
};
// REVOLUTE and PRISMATIC.
struct AxisJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  std::optional<JointDofConfig> dof = {};  // ModelBuilder::default_joint_cfg when empty
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};
struct BallJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  float damping = 0.0f, armature = 0.0f, friction = 0.0f;  // of each axis, see JointDofConfig
  Quatf target_q = Quatf::identity();                      // of the drive
  float target_ke = 0.0f, target_kd = 0.0f;                // its gains about each axis
  float limit_angle = kJointUnlimited;                     // rad, that the child turns at most
  float limit_ke = 1.0e4f, limit_kd = 10.0f;               // N m/rad and N m s/rad of the limit
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};
struct FreeJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  int32_t parent = -1;
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};
struct DistanceJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  // m, between the origins of the joint frames; negative: no such limit.
  float min_distance = -1.0f, max_distance = 1.0f;
  float limit_ke = 1.0e4f, limit_kd = 10.0f;  // N/m, N*s/m
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};

// An actuator of one degree of freedom, see dynamics/articulation/actuation.h. Ranges: lower,
// upper.
struct ActuatorArgs {
  int32_t axis = 0;  // degree of freedom of the joint
  float gear = 1.0f;
  Vec3f gain = {1.0f, 0.0f, 0.0f}, bias = {};  // a number, per length, per rate
  ActuatorDynamics dynamics = ActuatorDynamics::NONE;
  float time = 1.0f;  // s, of filters
  Vec2f ctrl_range = {-kJointUnlimited, kJointUnlimited};
  Vec2f force_range = {-kJointUnlimited, kJointUnlimited};
  Vec2f act_range = {-kJointUnlimited, kJointUnlimited};
  float ctrl = 0.0f, act = 0.0f;  // what controls and states start from
  std::string label = {};         // "actuator_<index>" when empty
};

// An actuator that pushes a frame of a body and pushes back a frame of another one, see
// dynamics/articulation/body_actuation.h. `law.axis` and `law.gear` do not count.
struct BodyActuatorArgs {
  Transformf frame = Transformf::identity();  // in the body
  int32_t reference_body = -1;                // -1: the world
  Transformf reference = Transformf::identity();
  SpatialVectorf wrench = {};  // force and moment of a force of 1
  int32_t axes = 0;            // bits of ActuatorAxes
  ActuatorArgs law = {};
};

// What ModelBuilder::collapse_fixed_joints did; one entry per body or joint as it was.
struct CollapsedJoints {
  std::vector<int32_t> body_remap = {}, joint_remap = {};  // the new index; -1: it is gone
  // Of a body that is gone: what it was merged into (-1: the world), as a new index, and its pose
  // there. Of others -1 and the identity.
  std::vector<int32_t> body_merged_parent = {};
  std::vector<Transformf> body_merged_transform = {};
};

}  // namespace novaphy
