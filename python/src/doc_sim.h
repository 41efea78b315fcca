// Docstrings of Contacts.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kRigidContacts[] =
    R"(Returns the rigid contacts in order, as a NumPy copy with a column for each array
rigid_contact_*: shape0, shape1, point0, point1, offset0, offset1, normal, margin0, margin1,
point_id, force. force (N, world frame, on body1) is that of the last step.

With a model and a state there are four more columns:
body0, body1: indices; -1: the world.
position: m, world frame; the middle between both surfaces.
penetration: m, along the normal; negative: the surfaces are apart, within the gaps.

ValueError: another model.)";

inline constexpr char kMatch[] =
    R"(Returns, for every rigid contact, its row in `previous` (NumPy int32); -1: there is none. The
row is that of the same shapes and point_id. With pairs=True the row is the first one of the same
shapes.

Contacts begin where now.match(before) is -1, and end where before.match(now) is. before is
now.clone() ahead of collide.

ValueError: contacts of another model.)";

inline constexpr char kContactsClass[] =
    R"(Contacts of particles with shapes (soft) and of shapes with each other (rigid). len() is the
number of contacts. CollisionPipeline.contacts() makes them.

The capacities are fixed. When more are found, the first soft_contact_max (rigid_contact_max) are
kept and overflowed is True.)";

inline constexpr char kModel[] =
    R"(The constant part of a scene: particles, bodies, shapes, joints and materials.
ModelBuilder.finalize makes a model. The sizes are fixed. Values may be edited at any time, and act
from the next step on.)";

inline constexpr char kColorGroups[] =
    R"(The particles of each color, ascending, as NumPy int32. The list is empty unless the builder
was colored.)";

inline constexpr char kShapeSource[] =
    R"(The mesh of each shape, or None: a novaphy.io.Mesh of copies before shape_scale. Shapes of
one mesh share it.)";

inline constexpr char kSimState[] =
    R"(The changing part of a scene: positions, velocities, forces. Model.state() makes a state, and
a Trajectory holds states. An array of a kind that the model lacks has 0 rows.)";

inline constexpr char kModelCollide[] =
    R"(Finds the contacts of a state. collision_pipeline: None takes a default pipeline. contacts:
None makes new contacts.)";

}  // namespace novaphy::python::doc
