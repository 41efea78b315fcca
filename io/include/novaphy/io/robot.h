// Robots from URDF and MJCF files, added to a ModelBuilder.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/io/export.h"

namespace novaphy {

// The joint between a robot's root link and the world (or `parent_body`).
struct BaseJoint {
  JointType type = JointType::FIXED;
  std::vector<JointDofConfig> linear_axes = {}, angular_axes = {};  // as in JointArgs
};

enum class JointOrdering {
  DepthFirst,    // the children of a link in the order of the file, each with all below it
  BreadthFirst,  // all joints of one depth before those of the next
  File           // as in the file, which must have parents before children
};

// What a <mimic> element of URDF becomes.
enum class MimicMode {
  Follow,      // ModelBuilder::add_constraint_mimic, without a drive of its own
  Refuse,      // ErrorKind::NotImplemented
  Fixed,       // the joint is fixed where the other one is at 0: at its offset
  Independent  // a joint of its own
};

// Where <dynamics damping="..."/> of URDF goes.
enum class JointDampingMode {
  Passive,  // JointDofConfig::damping
  Drive     // JointDofConfig::target_kd
};

struct UrdfOptions {
  Transformf xform = Transformf::identity();  // of the root link, in the world or `parent_body`
  std::optional<bool> floating = {};          // true: FREE; false and empty: FIXED
  std::optional<BaseJoint> base_joint = {};   // instead of `floating`
  // The body that carries the root link, -1: the world. With a body the joints are of no
  // articulation, whose root is at the world.
  int32_t parent_body = -1;
  float scale = 1.0f;         // of all lengths; masses stay, inertias grow with its square
  bool hide_visuals = false;  // leaves the <visual> elements out; their meshes may be missing
  bool parse_visuals_as_colliders = false;  // <visual> in place of <collision>
  Axis up_axis = Axis::Z;                   // of the file; turned to that of the builder
  bool force_show_colliders = false;        // else they are hidden where the link has a <visual>
  bool enable_self_collisions = true;
  bool ignore_inertial_definitions = false;  // masses from the colliders, of default_shape_cfg
  JointOrdering joint_ordering = JointOrdering::DepthFirst;
  bool bodies_follow_joint_ordering = true;  // false: bodies in the order of the file
  bool collapse_fixed_joints = false;        // merges a link on a fixed joint into its parent
  // Meshes of colliders become their convex hull of at most so many vertices; empty: they stay.
  std::optional<int32_t> mesh_maxhullvert = {};
  JointDampingMode joint_damping_mode = JointDampingMode::Passive;
  // Where package://NAME/... is: a folder that has a folder NAME, or that is called NAME.
  std::vector<std::filesystem::path> package_dirs = {};
  MimicMode mimic = MimicMode::Follow;
  // Pairs of its shapes that overlap where its joints start (find_overlaps) never meet. False: they
  // do, and a warning names them.
  bool filter_overlaps = false;
};

struct MjcfOptions {
  Transformf xform = Transformf::identity();
  bool collapse_fixed_joints = false;  // merges a body without a joint into its parent
  bool enable_self_collisions = true;
  bool filter_overlaps = false;  // as in UrdfOptions
};

// A motor of an MJCF file: joint_f[dof] = gear * clip(control, lower, upper).
struct RobotActuator {
  std::string name, joint;
  int32_t dof;  // row of joint_f
  float gear, lower, upper;
};

// What was added, by the names of the file.
struct RobotImport {
  std::map<std::string, int32_t> links;   // body; a merged link: the one it is part of
  std::map<std::string, int32_t> joints;  // -1: merged
  // The first row of the joint in joint_qd and the like, and in joint_q; -1: merged.
  std::map<std::string, int32_t> joint_dofs, joint_coords;
  // Of each link in its body: the identity, unless it was merged.
  std::map<std::string, Transformf> link_poses;
  std::map<int32_t, Vec4f> shape_colors;  // r, g, b, a of the shapes that have one
  std::vector<int32_t> shapes, articulations;
  std::vector<RobotActuator> actuators;  // in the order of the file
  // What the file says and no option can take over, and which of its shapes overlap at the start.
  std::vector<std::string> warnings;
};

// Adds a robot of a URDF file: a path, package://NAME/..., or the XML itself. Links become bodies,
// joints joints, of one articulation. Meshes are read by load_mesh; they lie in the folder of the
// file, the one above it, or in package_dirs. ErrorKind::Value and ErrorKind::NotImplemented name
// the file, the line and the element; the builder is then as it was.
NOVAPHY_IO_API RobotImport add_urdf(ModelBuilder& builder, std::string_view source,
                                    const UrdfOptions& options = {});

// Adds what an MJCF file has: a subset of the format, see docs/guide/robots.md. What would change
// the physics and is not in it raises ErrorKind::NotImplemented by name. As add_urdf otherwise.
NOVAPHY_IO_API RobotImport add_mjcf(ModelBuilder& builder, std::string_view source,
                                    const MjcfOptions& options = {});

}  // namespace novaphy
