// Docstrings of the readers of robot files.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddUrdf[] =
    R"(Adds a robot from a URDF file and returns a RobotImport. Links become bodies, and the joints
form one articulation. Names become labels. Joints start at 0 or at the nearest limit.

source: a path, package://NAME/FILE, or the XML text. A path that ends in .xacro is expanded by the
Python package xacro, which runs code of the file.
xform: the pose of the root link (m, quaternion xyzw) in the world or in parent_body.
floating: True: the base joint is FREE. None or False: the base joint is FIXED.
base_joint: used instead of floating: a dict with joint_type, linear_axes and angular_axes.
parent_body: the body that carries the root link; -1: the world. With a parent_body the joints
belong to no articulation.
scale: a factor for all lengths. Masses do not change.
hide_visuals: True ignores <visual> elements.
parse_visuals_as_colliders: True reads <visual> elements in place of <collision> elements.
up_axis: the up axis of the file.
force_show_colliders: False: viewers hide the colliders of links with a <visual> element.
enable_self_collisions: whether shapes of the robot collide with each other.
ignore_inertial_definitions: masses and inertias are computed from the colliders, with the density
of default_shape_cfg.
joint_ordering: "dfs" (depth first), "bfs" (breadth first) or None (the order of the file).
bodies_follow_joint_ordering: False: bodies have the order of the file.
collapse_fixed_joints: merges links on fixed joints into their parents, except links_to_keep.
mesh_maxhullvert: mesh colliders are replaced by convex hulls with at most this many vertices.
joint_damping_mode: "passive" (joint damping) or "drive" (target_kd of the drive).
package_dirs: folders for package://NAME/...: folders that contain NAME, or that are named NAME.
mimic: mimic joints become mimic joints ("follow"), errors ("refuse"), fixed joints ("fixed") or
joints without the constraint ("independent").
mend_inertias: corrects a missing or impossible inertia of a link with a mass.
unsupported: "error", or "warn": unsupported parts are left out and listed in the report.
filter_overlaps: True: pairs of the robot's shapes that overlap at the start never collide. False:
the first collide warns of these pairs, with their depth.
ignore_zero_effort: a limit with effort="0" counts as no limit.

Elements of the file that are not read give a UserWarning. After an error the builder is unchanged.

ValueError, NotImplementedError: the message has the file, the line and the element.
OSError: the file does not exist.)";

inline constexpr char kAddMjcf[] =
    R"(Adds the bodies, joints, geoms and actuators of an MJCF file (MuJoCo) and returns a
RobotImport.

MJCF is partly supported. NotImplementedError, with the name of the element: an element would change
the physics and is not supported. Joints start at 0, at the init_qpos of the file, or at the nearest
limit. For the other arguments and errors see add_urdf.

source: a path, or the XML text.
xform: the pose of the file's world frame (m, quaternion xyzw) in the world.)";

inline constexpr char kLights[] =
    R"(A dict: name of a light -> (body, pose). The body -1 is the world. The pose (m, quaternion
xyzw) is in the body frame. The light shines along -z.)";

inline constexpr char kCameras[] =
    R"(A dict: name of a camera -> (body, pose, vertical field of view (rad)). The body -1 is the
world. The pose (m, quaternion xyzw) is in the body frame. A camera looks along -z, and y points
up.)";

inline constexpr char kLeftOut[] =
    R"(The RobotNotes on elements that were left out: elements that would change the motion but are
not supported, and missing files.)";

inline constexpr char kNoteText[] =
    R"(The action of the reader on the element, and the reason.)";

inline constexpr char kReport[] =
    R"(A report on the elements of a robot's file: read, corrected, left out or ignored. str() lists
them.)";

inline constexpr char kIgnored[] =
    R"(RobotNotes on elements that do not affect the motion, or only set up MuJoCo's simulation.)";

inline constexpr char kLinkPoses[] =
    R"(A dict: name of a link -> pose in its body (m, quaternion xyzw). The pose is the identity,
unless the link was merged.)";

}  // namespace novaphy::python::doc
