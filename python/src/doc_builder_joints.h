// Docstrings of ModelBuilder: joints and actuators.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddJoint[] =
    R"(Adds a joint of a JointType between a parent body (-1: the world) and a child body. Returns
the index of the joint.

parent_xform: the pose of the joint frame in the parent's frame (m, quaternion xyzw).
child_xform: the pose of the joint frame in the child's frame (m, quaternion xyzw).
linear_axes, angular_axes: lists of JointDofConfig. A D6 joint takes up to three axes in each list.
A REVOLUTE joint takes one angular axis, a PRISMATIC joint one linear axis. A PLANAR joint takes two
perpendicular linear axes, and their cross product as angular axis.

ValueError: a pose, axis or number is not valid, or the bodies are in two worlds.
IndexError: a body does not exist.)";

inline constexpr char kAddPlanar[] =
    R"(Adds a joint with three coordinates: x and y (m) in a plane, and an angle (rad) about the
normal of the plane. Returns the index.

axis: the normal of the plane (an Axis or a vector, in the parent's joint frame); None: Z. For the
normal Z, the coordinates x and y are along the axes x and y of the frame. For another normal, these
two directions are rotated by the shortest rotation from Z to the normal.
x, y, angle: JointDofConfigs with drives, limits and damping; None: default_joint_cfg. The axes in
the JointDofConfigs are not used.

The joint rates are the time derivatives of the coordinates. The directions of x and y are fixed in
the parent.)";

inline constexpr char kAddActuator[] =
    R"(Adds an actuator that drives one degree of freedom of a joint. Returns the index, which is
the row of Control.ctrl.

The law is MuJoCo's. The actuator has the length l = gear q and the rate v = gear qd, with the
joint's position q and rate qd. The force is (gain[0] + gain[1] l + gain[2] v) c + bias[0] + bias[1]
l + bias[2] v, clipped to force_range. The force on the joint is gear times this force. The input c
is the control, clipped to ctrl_range. With an ActuatorDynamics, c is the activation.

axis: the number of the degree of freedom in the joint.
gear: the factor between joint and actuator.
gain, bias: three numbers each; the defaults make a motor. A position servo has gain (kp, 0, 0) and
bias (0, -kp, -kv). A velocity servo has gain (kv, 0, 0) and bias (0, 0, -kv).
dynamics, time: the ActuatorDynamics and its time constant (s).
ctrl_range, force_range, act_range: (low, high); None: no limit.
ctrl, act: the initial control and the initial activation.)";

inline constexpr char kAddBodyActuator[] =
    R"(Adds an actuator that applies a force and a moment to a body. Returns the index, which is the
row of Control.ctrl.

The scalar force f follows the law of add_actuator. The body gets f times wrench.

wrench: force (1) and moment (m) per unit of f, in the axes of frame, at the origin of frame.
frame: the pose (m, quaternion xyzw) of the frame in the body frame. None: the body frame.
reference_body: a body (-1: the world) that gets the opposite wrench. None: no body gets one.
reference: the pose (m, quaternion xyzw) of a frame in the frame of reference_body.

Without a reference_body, the length l is 0 and the rate v is the body's velocity along the wrench.
With a reference_body, the wrench has the axes of reference, and l and v are the position and the
velocity of frame relative to reference. Joints that carry both bodies get no force.

The force is computed at the start of a step and constant over the step.)";

inline constexpr char kAddMimic[] =
    R"(Makes joint0 a mimic joint of joint1: q0 = coef0 + coef1 q1 (m or rad). The equation holds
exactly at the end of every step of an articulation.

Both joints are REVOLUTE or PRISMATIC joints of the same articulation. A mimic joint may itself have
mimic joints. Drives, limits, forces and inertia of joint0 act on joint1. The velocity limit of
joint0 has no effect. Solvers without articulations raise NotImplementedError.

IndexError: a joint does not exist.
ValueError: a joint has another type, joint0 already has a leader, or the joints form a cycle.)";

inline constexpr char kCollapse[] =
    R"(Removes enabled FIXED joints: the child body is merged into the parent body, which gets the
mass, the shapes and the joints of the child.

A FIXED joint is kept if its label is in joints_to_keep, if the child has a second parent joint, or
if gravcomp of child and parent differ.
A joint between a body and a kinematic child is kept. The root joint of an articulation is kept if
the root body has more than one child.

Returns a dict of four dicts, whose keys are indices before the call:
body_remap, joint_remap: the new index of each body or joint that remains.
body_merged_parent: for each merged body, the new index of the body that contains it; -1: the world.
body_merged_transform: for each merged body, its pose in that body (m, quaternion xyzw).)";

}  // namespace novaphy::python::doc
