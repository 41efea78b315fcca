// Arguments of the add_joint_* functions of ModelBuilder.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "novaphy/core/sim/joint_types.h"
#include "novaphy/math/types.h"

namespace novaphy {

// A joint limit of this size means no limit (Newton's MAXVAL).
inline constexpr float kJointUnlimited = 1.0e10f;

// One degree of freedom of a joint. Units: m and N along an axis, rad and N*m about an axis. All
// numbers are finite. All but targets and limits are >= 0, and limit_lower <= limit_upper.
struct JointDofConfig {
  Vec3f axis = {1.0f, 0.0f, 0.0f};  // in the joint frame of the parent, any length > 0
  float limit_lower = -kJointUnlimited, limit_upper = kJointUnlimited;
  float limit_ke = 1.0e4f, limit_kd = 10.0f;  // spring and damper of the limits
  float target_q = 0.0f, target_qd = 0.0f;    // targets of the drive
  float target_ke = 0.0f, target_kd = 0.0f;   // gains of the drive
  float damping = 0.0f;                       // viscous damping: force per velocity
  float armature = 0.0f;                      // kg or kg m^2, added to the diagonal of the mass
                                              // matrix
  float effort_limit = 1.0e6f;                // largest force of the drive
  float velocity_limit = 1.0e6f, friction = 0.0f;
  JointTargetMode actuator_mode = JointTargetMode::POSITION_VELOCITY;
};

// The options that all joints share. X_p and X_c are the poses of the joint frames in the bodies.
struct JointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  // The number of axes depends on the type (joint_types.h). The axes are linearly independent.
  std::vector<JointDofConfig> linear_axes = {}, angular_axes = {};
  bool collision_filter_parent = true;  // filters collisions between child and parent
  bool enabled = true;
  std::string label = {};  // "joint_<index>" when empty
};
// Arguments of REVOLUTE and PRISMATIC joints, which have one axis.
struct AxisJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  std::optional<JointDofConfig> dof = {};  // empty: ModelBuilder::default_joint_cfg
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};
struct BallJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  float damping = 0.0f, armature = 0.0f, friction = 0.0f;  // of each axis, see JointDofConfig
  Quatf target_q = Quatf::identity();                      // target of the drive
  float target_ke = 0.0f, target_kd = 0.0f;                // gains of the drive about each axis
  float limit_angle = kJointUnlimited;                     // rad, largest rotation of the child
  // N m/rad and N m s/rad, spring and damper of the limit
  float limit_ke = 1.0e4f, limit_kd = 10.0f;
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
  // m, bounds of the distance between the origins of the joint frames. A negative value means no
  // bound.
  float min_distance = -1.0f, max_distance = 1.0f;
  float limit_ke = 1.0e4f, limit_kd = 10.0f;  // N/m, N*s/m
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};

// An actuator of one degree of freedom. dynamics/articulation/actuation.h has its law. A range is
// (lower, upper).
struct ActuatorArgs {
  int32_t axis = 0;  // index of the dof in the joint
  float gear = 1.0f;
  Vec3f gain = {1.0f, 0.0f, 0.0f}, bias = {};  // constant term, coefficient of the length,
                                               // coefficient of the rate
  ActuatorDynamics dynamics = ActuatorDynamics::NONE;
  float time = 1.0f;  // s, time constant of filters
  Vec2f ctrl_range = {-kJointUnlimited, kJointUnlimited};
  Vec2f force_range = {-kJointUnlimited, kJointUnlimited};
  Vec2f act_range = {-kJointUnlimited, kJointUnlimited};
  float ctrl = 0.0f, act = 0.0f;  // initial values of control and activation
  std::string label = {};         // "actuator_<index>" when empty
};

// An actuator that applies a wrench to a frame of a body and the opposite wrench to a frame of a
// reference body. dynamics/articulation/body_actuation.h has its law. `law.axis` and `law.gear` are
// ignored.
struct BodyActuatorArgs {
  Transformf frame = Transformf::identity();  // pose of the frame in the body
  int32_t reference_body = -1;                // -1: the world
  Transformf reference = Transformf::identity();
  SpatialVectorf wrench = {};  // force and moment per unit of actuator force
  int32_t axes = 0;            // bits of ActuatorAxes
  ActuatorArgs law = {};
};

// The result of ModelBuilder::collapse_fixed_joints, with one entry per body or joint before the
// call.
struct CollapsedJoints {
  std::vector<int32_t> body_remap = {}, joint_remap = {};  // new index; -1: removed
  // For a removed body: the new index of the body into which it was merged (-1: the world), and its
  // pose in that body. For other bodies: -1 and the identity.
  std::vector<int32_t> body_merged_parent = {};
  std::vector<Transformf> body_merged_transform = {};
};

}  // namespace novaphy
