// Docstrings of Contacts.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kRigidContacts[] =
    R"(Returns the rigid contacts as a structured NumPy array {contacts}, a copy in the order of
rows. The columns are the arrays rigid_contact_*: shape0, shape1, point0, point1, offset0, offset1,
normal, margin0, margin1, point_id and force. The column force has the contact force of the last
step (N, world frame, on body1).

With a model and a state, the result has four more columns:
body0, body1: the indices of the bodies; -1: the world.
position: the point halfway between the two surfaces (m, world frame).
penetration: the depth of the overlap along the normal (m). A negative value is the distance of
surfaces that do not touch.

ValueError: the model or the state does not belong to the contacts.)";

inline constexpr char kMatch[] =
    R"(Finds each rigid contact in earlier contacts. Returns an int32 array {contacts} with the row
of the contact in `previous`, or -1 if `previous` does not have it.

A contact is the same if its two shapes and its point_id are the same. With pairs=True the result is
the first row with the same two shapes.

Example: before = now.clone() is called before collide(state, now). Contacts that began have -1 in
now.match(before). Contacts that ended have -1 in before.match(now).

ValueError: previous belongs to another model.)";

inline constexpr char kContactsClass[] =
    R"(Contacts of particles with shapes (soft) and of shapes with each other (rigid). len() is the
number of contacts. CollisionPipeline.contacts() makes them.

The capacities soft_contact_max and rigid_contact_max are fixed. If collide finds more contacts, the
first ones are kept, and overflowed is True.)";

inline constexpr char kModel[] =
    R"(The constant part of a scene: particles, bodies, shapes, joints and materials.
ModelBuilder.finalize makes a model. The sizes of arrays are fixed. Values may be edited at any
time. An edited value acts from the next step on.)";

inline constexpr char kColorGroups[] =
    R"(A list with an int32 array for each color: the particles of the color, ascending. The list is
empty if ModelBuilder.color and set_coloring were not called.)";

inline constexpr char kShapeSource[] =
    R"(A list with an entry for each shape: the novaphy.io.Mesh of a mesh or hull, with copies of
the vertices before shape_scale is applied, or None. Shapes with the same mesh share one Mesh.)";

inline constexpr char kSimState[] =
    R"(The changing part of a scene: positions, velocities and forces. Model.state() makes a state,
and a Trajectory has several states. If the model has no particles, bodies or joints, their arrays
have 0 rows.)";

inline constexpr char kModelCollide[] =
    R"(Finds the contacts of a state and returns them.

contacts: the Contacts to write; None: new Contacts.
collision_pipeline: the CollisionPipeline to use; None: a default pipeline.)";

inline constexpr char kNewState[] =
    R"(Returns a new state with the model's initial values.

requires_grad: True: positions and velocities become leaves when a tape records a step. None: the
value of the model.)";

inline constexpr char kNewControl[] =
    R"(Returns a new control with copies of the model's joint forces, targets, controls and
activations.

clone_variables: True, because a control always has separate arrays.
requires_grad: whether the arrays are leaves; None: the value of the model.)";

inline constexpr char kNewContacts[] =
    R"(Returns empty contacts of a CollisionPipeline; None: of a default pipeline.)";

inline constexpr char kSetGravity[] =
    R"(Sets the gravity (m/s^2, world frame) of one world; None: of all worlds. ValueError: a number
is not finite.)";

inline constexpr char kAssignState[] =
    R"(Copies all values of another state. ValueError, before any copy: sizes or devices differ.)";

inline constexpr char kControl[] =
    R"(The inputs of a step, such as joint forces, targets and controls of actuators.
Model.control() makes a Control.)";

inline constexpr char kContactsInit[] =
    R"(Makes empty contacts without a model. CollisionPipeline.collide does not accept such
contacts: use CollisionPipeline.contacts.)";

inline constexpr char kPerContact[] =
    R"(Whether each row of rigid contacts has a separate stiffness, damping and friction.)";

inline constexpr char kActiveRigid[] =
    R"(The number of rigid contacts: min(rigid_contact_count, rigid_contact_max). Waits for the
device.)";

inline constexpr char kActiveSoft[] =
    R"(The number of soft contacts: min(soft_contact_count, soft_contact_max). Waits for the
device.)";

inline constexpr char kOverflowed[] =
    R"(Whether more contacts were found than fit into the arrays. Waits for the device.)";

inline constexpr char kSoftContacts[] =
    R"(Returns the soft contacts as a structured NumPy array {contacts}, a copy in slot order. The
columns are particle, shape, body_pos (m, body frame), body_vel (m/s, body frame) and normal (world
frame).)";

}  // namespace novaphy::python::doc
