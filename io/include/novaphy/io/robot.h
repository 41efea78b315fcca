// Reads robots from URDF and MJCF files into a ModelBuilder.
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
  DepthFirst,    // depth first: each child, in the order of the file, with its subtree
  BreadthFirst,  // breadth first: all joints of one depth before the next depth
  File           // order of the file, where parents must come before children
};

// What the reader does with <mimic> elements of URDF.
enum class MimicMode {
  Follow,      // a mimic joint (add_constraint_mimic) without its own drive
  Refuse,      // ErrorKind::NotImplemented
  Fixed,       // a fixed joint at the mimic offset
  Independent  // a joint without the mimic constraint
};

// The builder's setting that receives <dynamics damping="..."/> of URDF.
enum class JointDampingMode {
  Passive,  // JointDofConfig::damping
  Drive     // JointDofConfig::target_kd
};

// What the reader does with parts of a file that NovaPhy does not support.
enum class Unsupported {
  Error,  // ErrorKind::NotImplemented
  Warn    // left out and listed in RobotReport::left_out
};

struct UrdfOptions {
  Transformf xform = Transformf::identity();  // pose of the root link, in the world or
                                              // `parent_body`
  std::optional<bool> floating = {};          // true: a FREE base joint; false or empty: a FIXED
                                              // base joint
  std::optional<BaseJoint> base_joint = {};   // replaces `floating`
  // The body to which the root link is attached; -1: the world. With a body the joints belong to no
  // articulation, because an articulation starts at the world.
  int32_t parent_body = -1;
  float scale = 1.0f;         // factor of all lengths; masses stay, inertias are scaled by its
                              // square
  bool hide_visuals = false;  // skips <visual> elements, whose meshes may then be missing
  bool parse_visuals_as_colliders = false;  // reads <visual> in place of <collision>
  Axis up_axis = Axis::Z;                   // up axis of the file, rotated to that of the builder
  bool force_show_colliders = false;        // false: colliders of links with a <visual> are hidden
  bool enable_self_collisions = true;
  bool ignore_inertial_definitions = false;  // computes masses from colliders with the density of
                                             // default_shape_cfg
  JointOrdering joint_ordering = JointOrdering::DepthFirst;
  bool bodies_follow_joint_ordering = true;     // false: bodies in the order of the file
  bool collapse_fixed_joints = false;           // merges a link on a fixed joint into its parent
  std::vector<std::string> links_to_keep = {};  // links that collapse_fixed_joints does not merge
  // Replaces meshes of colliders by their convex hull with at most this many vertices. If empty,
  // colliders keep their meshes.
  std::optional<int32_t> mesh_maxhullvert = {};
  JointDampingMode joint_damping_mode = JointDampingMode::Passive;
  // Folders for package://NAME/...: a listed folder contains a folder NAME, or is itself named
  // NAME.
  std::vector<std::filesystem::path> package_dirs = {};
  MimicMode mimic = MimicMode::Follow;
  // Whether a mass without inertia, or with an unphysical inertia, is corrected. A link on a fixed
  // joint adds its mass to the parent. For other links the principal moments are raised to those of
  // a ball of water. If false, ModelBuilder::finalize throws an error for such a mass.
  bool mend_inertias = true;
  bool ignore_zero_effort = false;  // <limit> with effort="0" means no limit
  Unsupported unsupported = Unsupported::Error;
};

struct MjcfOptions {
  Transformf xform = Transformf::identity();
  bool collapse_fixed_joints = false;  // merges a body without a joint into its parent
  std::vector<std::string> links_to_keep = {};
  bool enable_self_collisions = true;
  // Folders from which files may be read, besides the folder of the file and its parent folder.
  std::vector<std::filesystem::path> package_dirs = {};
  Unsupported unsupported = Unsupported::Error;
};

// A site of an MJCF file: a frame on a body.
struct RobotSite {
  int32_t body;  // -1: the world
  Transformf pose;
};

// A camera of an MJCF file, which looks along -z with y up.
struct RobotCamera {
  RobotSite at;
  float fovy;  // rad, vertical field of view
};

// A keyframe of an MJCF file: values of joint_q, beginning at row `coord`.
struct RobotKeyframe {
  float time;
  int32_t coord;
  std::vector<float> joint_q;
};

// A remark of the reader about an element of the file.
struct RobotNote {
  std::string file;
  int32_t line;
  std::string element;  // <joint name="knee">
  std::string text;
};

// The report of what the reader read, corrected and left out.
struct RobotReport {
  std::map<std::string, int32_t> read;  // number of supported elements, by kind
  std::vector<RobotNote> mended;        // corrected elements
  std::vector<RobotNote> left_out;      // unsupported elements that affect the motion
  std::vector<RobotNote> ignored;       // elements that do not affect the motion, or settings that
                                        // the simulation chooses
};

// An equality, tendon, height field or sensor of an MJCF file, not interpreted, with the defaults
// of its class. Attributes with names and with lists of numbers are stored separately. A tendon has
// parts.
struct RobotPart {
  std::string kind, name = {};
  std::map<std::string, std::string> names = {};
  std::map<std::string, std::vector<double>> numbers = {};
  std::vector<RobotPart> parts = {};
};

// The objects that the reader added, by their names in the file.
struct RobotImport {
  std::map<std::string, int32_t> links;   // body index; for a merged link, the body into which it
                                          // was merged
  std::map<std::string, int32_t> joints;  // joint index; -1: merged
  // First row of each joint in arrays of degrees of freedom, such as joint_qd, and first row in
  // joint_q; -1: merged.
  std::map<std::string, int32_t> joint_dofs, joint_coords;
  // Pose of each link in its body: the identity unless the link was merged.
  std::map<std::string, Transformf> link_poses;
  std::map<int32_t, Vec4f> shape_colors;  // r, g, b, a of shapes with a color
  std::vector<int32_t> shapes, articulations;
  std::map<std::string, int32_t> actuators;        // rows of Control::ctrl
  std::map<std::string, RobotSite> sites, lights;  // a light points along -z of its frame
  std::map<std::string, RobotCamera> cameras;
  std::map<std::string, RobotKeyframe> keyframes;
  std::optional<float> timestep;  // s, time step of the file
  // ModelBuilder::finalize refuses active equalities, tendons and height fields, unless unsupported
  // parts are left out.
  std::vector<RobotPart> equalities, tendons, height_fields;
  std::vector<RobotPart> sensors;
  RobotReport report;
  std::vector<std::string> warnings;  // remarks of the report; equal texts are combined
};

// Adds a robot from a URDF file: a path, package://NAME/..., or the XML text. Links become bodies,
// and joints become joints of one articulation. load_mesh reads the meshes, which lie in the folder
// of the file, in its parent folder, or in package_dirs. ErrorKind::Value and
// ErrorKind::NotImplemented name the file, the line and the element. After an error the builder is
// unchanged.
NOVAPHY_IO_API RobotImport add_urdf(ModelBuilder& builder, std::string_view source,
                                    const UrdfOptions& options = {});

// Adds the contents of an MJCF file. docs/guide/robots.md lists the supported subset. An
// unsupported element that affects the physics throws ErrorKind::NotImplemented with its name. In
// other respects add_mjcf is like add_urdf.
NOVAPHY_IO_API RobotImport add_mjcf(ModelBuilder& builder, std::string_view source,
                                    const MjcfOptions& options = {});

}  // namespace novaphy
