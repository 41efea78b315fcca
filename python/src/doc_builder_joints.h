// Docstrings of ModelBuilder: joints and actuators.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddJoint[] =
    R"(Adds a joint of a JointType between a parent body (-1: the world) and a child. Returns the
index.

parent_xform, child_xform: the joint frames in the bodies (m, xyzw).
linear_axes, angular_axes: lists of JointDofConfig. A D6 takes up to three of each, a REVOLUTE or
PRISMATIC joint takes one, and a PLANAR joint takes two perpendicular ones and their cross product.

ValueError: a bad pose, axis or number, bodies of two worlds.
IndexError: no such body.)";

inline constexpr char kAddPlanar[] =
    R"(Adds a joint with three coordinates: x and y (m) in a plane, and an angle (rad) about its
normal. Returns the index.

axis: the normal (an Axis or a vector, joint frame of the parent); None: Z. The plane of Z has the
axes x and y of that frame. For another normal, the shortest rotation from Z to the normal carries
x and y along.
x, y, angle: JointDofConfig of the drives, limits and damping; None: default_joint_cfg. Their axes
are not used.

The rates are the derivatives of the coordinates. The directions of x and y do not turn with the
child.)";

inline constexpr char kAddActuator[] =
    R"(Adds an actuator of a degree of freedom of a joint with axes. Returns the
index, which is the row of Control.ctrl.

The length l and the rate v of the actuator are those of the joint times gear. The force is
(gain[0] + gain[1] l + gain[2] v) c + bias[0] + bias[1] l + bias[2] v, clipped to force_range. The
joint feels gear times the force. c is the control, clipped to ctrl_range; with an ActuatorDynamics
c is the activation.

gain, bias: the defaults make a motor. A servo of the position has gain (kp, 0, 0) and bias
(0, -kp, -kv). A servo of the velocity has gain (kv, 0, 0) and bias (0, 0, -kv).
ctrl, act: the initial values of a control and of a state.)";

inline constexpr char kAddBodyActuator[] =
    R"(Adds an actuator of a body. Returns the index, which is the row of Control.ctrl.

The force law is that of add_actuator. The force acts at the origin of frame, a frame of the body.
wrench: the force and the moment (m) of a force of 1, in the axes of frame. The length l is 0, and
the rate v is the rate along the wrench.

reference_body: -1 is the world. The wrench then has the axes of reference, a frame of that body,
and the opposite wrench acts there. l and v are those of frame relative to reference. Joints that
carry both bodies feel nothing.

The force of the start of a step acts through the step.)";

inline constexpr char kAddMimic[] =
    R"(Makes joint0 follow joint1: q0 = coef0 + coef1 q1 (m or rad), exactly, at the end of every
step of an articulation.

Both are REVOLUTE or PRISMATIC joints of one articulation. A joint that follows another may lead a
third one. Drives, limits, forces and inertia of joint0 act on joint1; its velocity limit does not.
Solvers without articulations raise NotImplementedError.

IndexError: no such joint.
ValueError: another type, a second leader, a cycle.)";

inline constexpr char kCollapse[] =
    R"(Merges the child of every enabled FIXED joint into the parent: mass, shapes, joints.

Joints with a label in joints_to_keep stay. Other joints stay too if the child has another joint to
a parent, or is kinematic under a body. A root with more than one child stays.

Returns four dicts:
body_remap, joint_remap: the new index by the old one, for the bodies and joints that remain.
body_merged_parent: the new index of the body that took in a merged one, by the old index of the
merged one; -1: the world.
body_merged_transform: the pose of the merged body there (xyz and xyzw).)";

}  // namespace novaphy::python::doc
