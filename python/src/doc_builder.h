// Docstrings of ModelBuilder, its bodies and its shapes.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddBody[] =
    R"(Adds a rigid body at rest that moves freely: a link, its FREE joint to the world, and an
articulation of both. Returns the index.

xform: the pose (m, xyzw).
mass: kg. com: the center of mass (m, body frame).
inertia: 3x3 (kg*m^2) about com; None: a point mass. Shapes with a density add to mass and inertia.
lock_inertia: shapes add no mass and no inertia.
is_kinematic: the body follows its velocity, and no force moves it.
gravcomp: the part of the weight that a force at the center of mass cancels.

ValueError: a mass or inertia that no body can have. finalize checks again.)";

inline constexpr char kSetFluid[] =
    R"(Sets the fluid of this builder, which drags the links of articulations.

Worlds take the fluid as they take gravity. The fluid acts on a box for each body: the box of uniform
density with the body's mass and inertia. SolverFeatherstone and DiffFeatherstoneSolver have these
forces, which are explicit. The law is MuJoCo's inertia-based model.

density: kg/m^3.
viscosity: Pa*s.
wind: the velocity of the fluid (m/s, world frame).

ValueError: a number is not finite, or the density or the viscosity is negative. finalize,
begin_world and add_builder check.)";

inline constexpr char kAddShape[] =
    R"(Adds a shape of a GeoType to a body. Returns the index.

scale: the size (m).
src: the mesh of a MESH or CONVEX_MESH, as of add_shape_mesh.
is_static: the shape adds no mass to its body.
color: red, green and blue, 0 to 1, in viewers; None: viewers choose. Every add_shape function
takes a color.

NotImplementedError: a type that is not supported.)";

inline constexpr char kAddSite[] =
    R"(Adds a site: a frame of a body (-1: the world), without contacts and mass.

A site is a shape with ShapeFlags.SITE. Returns the index of the shape. Model.select finds sites by
name. Sensors, targets and actuators refer to their poses.

xform: the pose in the body (m, xyzw).
type, scale: the GeoType and the size (m) in which viewers draw a visible site.

IndexError: no such body.
ValueError: a pose or a size that is not finite, a quaternion that is not of length 1.)";

inline constexpr char kBuilder[] =
    R"(Collects particles, elements over them, bodies and shapes, and makes Models.

Positions may be tuples, lists or arrays of any float type; they are rounded to float32. A bad
argument raises and leaves the builder as it was.

ValueError: a number that is not finite, negative, a vector not of unit length, ...
IndexError: no such body or shape.
NotImplementedError: a shape type that is not supported.)";

inline constexpr char kAddPlane[] =
    R"(Adds a plane a*x + b*y + c*z + d = 0 with the normal (a, b, c), or at `xform` with its +z as
the normal. Returns the index.

width, length: m, along local x and y; infinite unless both are > 0.)";

inline constexpr char kBalanceInertia[] =
    R"(Whether finalize corrects an inertia of which one principal moment exceeds the sum of the
others. All moments then grow by the same amount until none does, with a RuntimeWarning. False: a
ValueError.)";

inline constexpr char kAddParticles[] =
    R"(Adds many particles.

pos, vel: arrays {n, 3} (m, m/s).
mass, radius, flags: {n}, as of add_particle; mass in kg, radius in m.

ValueError: lists of different lengths.)";

inline constexpr char kAddParticle[] =
    R"(Adds a particle at `pos` (m) with the velocity `vel` (m/s) and `mass` (kg; 0: kinematic).
radius (m): None takes default_particle_radius. Returns the index.)";

inline constexpr char kBoundMass[] =
    R"(The least mass of dynamic bodies (kg, > 0). finalize raises masses but not 0, keeps the
inertia, and warns. None: no bound.)";

inline constexpr char kBoundInertia[] =
    R"(The least principal moment of a body with a mass (kg*m^2, > 0). finalize adds what one lacks
to all three, and warns. None: no bound.)";

inline constexpr char kBuilderJointQ[] =
    R"(The initial joint coordinates, see JointType. The entries of a body of add_body follow body_q
until they are set here.)";

inline constexpr char kBeginWorld[] =
    R"(Opens a world and returns its index. Additions until end_world belong to this world.
Additions outside of worlds belong to all worlds (-1). Shapes collide within a world, and with the
shapes of all worlds.

gravity: m/s^2, world frame; None: the builder's gravity.

novaphy.Error: a world is open.)";

}  // namespace novaphy::python::doc
