// Docstrings of the readers of robot files.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddUrdf[] =
    R"(Adds a robot from a URDF file: a path, package://NAME/FILE, or the XML itself. A path that
ends in .xacro goes through the Python package xacro, which runs code of the file. Links become
bodies, joints joints, all of one articulation; names become labels. Returns a RobotImport.

xform: the pose of the root link (m, xyzw) in the world or parent_body.
floating: True: FREE; None and False: FIXED at the base.
base_joint: instead of floating, a dict of joint_type, linear_axes and angular_axes.
scale: a factor of all lengths; masses stay.
ignore_inertial_definitions: masses come from the colliders and default_shape_cfg.
links_to_keep: names of links that collapse_fixed_joints does not merge.
joint_ordering: "dfs", "bfs" or None (the order of the file).
mesh_maxhullvert: colliders of meshes become hulls with at most so many vertices.
joint_damping_mode: "passive" or "drive" (target_kd).
mimic: "follow", "refuse", "fixed" or "independent".
filter_overlaps: True: pairs of the robot's shapes that overlap at the start never collide. False:
the first collide names these pairs, with their depth.
ignore_zero_effort: effort="0" is no limit.

Joints start at 0 or the nearest limit. Unread elements give a UserWarning. After an error the
builder is as it was.

ValueError, NotImplementedError: name file, line and element.
OSError: no such file.)";

inline constexpr char kAddMjcf[] =
    R"(Adds the bodies, joints, geoms and actuators of an MJCF file: a path, or the XML itself.
Returns a RobotImport.

MJCF is supported in part. A part that would change the physics and is not supported raises
NotImplementedError by name. Joints start at 0, or where init_qpos says, or at the nearest limit.
Other arguments and errors are as of add_urdf.

xform: the pose of the file's world (m, xyzw).)";

inline constexpr char kLights[] =
    R"(A dict of each light to its body (-1: the world) and pose there (m, xyzw). Light goes to -z.)";

inline constexpr char kCameras[] =
    R"(A dict of each camera to its body (-1: the world), its pose there (m, xyzw) and its field of
view (rad, vertical). Cameras look along -z, and y points up.)";

inline constexpr char kLeftOut[] =
    R"(RobotNotes on elements that would change the motion but are not supported, and on missing
files.)";

}  // namespace novaphy::python::doc
