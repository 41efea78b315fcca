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

// What becomes of a part of a file that has no counterpart here.
enum class Unsupported {
  Error,  // ErrorKind::NotImplemented
  Warn    // it is left out, and RobotReport::left_out has it
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
  bool bodies_follow_joint_ordering = true;     // false: bodies in the order of the file
  bool collapse_fixed_joints = false;           // merges a link on a fixed joint into its parent
  std::vector<std::string> links_to_keep = {};  // that collapse_fixed_joints does not merge
  // Meshes of colliders become their convex hull of at most so many vertices; empty: they stay.
  std::optional<int32_t> mesh_maxhullvert = {};
  JointDampingMode joint_damping_mode = JointDampingMode::Passive;
  // Where package://NAME/... is: a folder that has a folder NAME, or that is called NAME.
  std::vector<std::filesystem::path> package_dirs = {};
  MimicMode mimic = MimicMode::Follow;
  // A mass without an inertia that a body can have gets one: on a fixed joint it is a part of its
  // parent, else its principal moments are at least those of a ball of water. False: an error of
  // ModelBuilder::finalize.
  bool mend_inertias = true;
  bool ignore_zero_effort = false;  // a <limit> with effort="0" leaves the force open
  Unsupported unsupported = Unsupported::Error;
};

struct MjcfOptions {
  Transformf xform = Transformf::identity();
  bool collapse_fixed_joints = false;  // merges a body without a joint into its parent
  std::vector<std::string> links_to_keep = {};
  bool enable_self_collisions = true;
  // Folders beside that of the file, and the one above it, that it may read from.
  std::vector<std::filesystem::path> package_dirs = {};
  Unsupported unsupported = Unsupported::Error;
};

// A site of an MJCF file: a frame of a body.
struct RobotSite {
  int32_t body;  // -1: the world
  Transformf pose;
};

// A camera of an MJCF file: it looks along -z, and y points up.
struct RobotCamera {
  RobotSite at;
  float fovy;  // rad, of the height
};

// A keyframe of an MJCF file: the rows of joint_q from `coord` on.
struct RobotKeyframe {
  float time;
  int32_t coord;
  std::vector<float> joint_q;
};

// What the reader has to say of an element.
struct RobotNote {
  std::string file;
  int32_t line;
  std::string element;  // <joint name="knee">
  std::string text;
};

// What was read, mended and left out.
struct RobotReport {
  std::map<std::string, int32_t> read;  // elements that count, by kind
  std::vector<RobotNote> mended;        // what was changed to be read
  std::vector<RobotNote> left_out;      // what changes the motion and has no counterpart here
  std::vector<RobotNote> ignored;       // what does not change it, or is up to the simulation
};

// An equality, tendon, height field or sensor of an MJCF file as it stands there, with the defaults
// of its class: names and words, and lists of numbers, by attribute; a tendon has parts.
struct RobotPart {
  std::string kind, name = {};
  std::map<std::string, std::string> names = {};
  std::map<std::string, std::vector<double>> numbers = {};
  std::vector<RobotPart> parts = {};
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
  std::map<std::string, int32_t> actuators;        // rows of Control::ctrl
  std::map<std::string, RobotSite> sites, lights;  // a light shines along -z
  std::map<std::string, RobotCamera> cameras;
  std::map<std::string, RobotKeyframe> keyframes;
  std::optional<float> timestep;  // s, that of the file
  // ModelBuilder::finalize refuses those that act, unless they are left out.
  std::vector<RobotPart> equalities, tendons, height_fields;
  std::vector<RobotPart> sensors;
  RobotReport report;
  std::vector<std::string> warnings;  // the notes of the report, those of one text as one
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
