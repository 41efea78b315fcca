// Docstrings of ModelBuilder, its bodies and its shapes.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddBody[] =
    R"(Adds a rigid body that moves freely, with the velocity 0: a link, a FREE joint to the world,
and an articulation of the joint. Returns the index of the body.

xform: the pose of the body's origin (m, quaternion xyzw, world frame).
mass: kg. Shapes with a density add to the mass and the inertia.
com: the center of mass (m, body frame).
inertia: 3x3 (kg*m^2) about com, in body axes. None: a point mass.
lock_inertia: shapes add no mass and no inertia.
is_kinematic: the body moves with its prescribed velocity, and no force changes the velocity.
gravcomp: the part of the weight that a force at the center of mass cancels (1).

ValueError: the mass or the inertia is not possible for a body. finalize checks again.)";

inline constexpr char kSetFluid[] =
    R"(Sets the fluid around the bodies of this builder, which exerts drag on links of
articulations.

A world takes the fluid of its builder, as it takes the gravity. The drag is that of a box of
uniform density with the body's mass and inertia. The law is MuJoCo's inertia-based fluid model.
SolverFeatherstone and DiffFeatherstoneSolver compute the forces at the start of a step.

density: kg/m^3.
viscosity: Pa*s.
wind: the velocity of the fluid (m/s, world frame).

finalize, begin_world and add_builder raise ValueError if a number is not finite, or the density or
the viscosity is negative.)";

inline constexpr char kAddShape[] =
    R"(Adds a shape of a GeoType to a body. Returns the index.

body: the index of the body; -1: the world.
xform: the pose of the shape (m, quaternion xyzw) in the body frame.
cfg: the ShapeConfig; None: default_shape_cfg.
scale: the size (m), as in Model.shape_scale.
src: the mesh of a MESH or CONVEX_MESH, as the argument mesh of add_shape_mesh.
is_static: the shape adds no mass to its body.
color: red, green and blue (0 to 1) for viewers; None: viewers choose. Every add_shape function
takes a color.

NotImplementedError: a type that is not supported.)";

inline constexpr char kAddSite[] =
    R"(Adds a site: a named frame on a body (-1: the world), without contacts and mass.

A site is a shape with ShapeFlags.SITE. Returns the index of the shape. Model.select finds sites by
name. Sensors, targets and actuators can refer to the pose of a site.

xform: the pose in the body frame (m, quaternion xyzw).
type, scale: the GeoType and the size (m) that viewers draw for a visible site.

IndexError: the body does not exist.
ValueError: a pose or a size is not finite, or a quaternion does not have length 1.)";

inline constexpr char kBuilder[] =
    R"(Collects particles, elements between particles, bodies, joints and shapes. finalize makes a
Model.

Positions may be tuples, lists or arrays of any float type, and are rounded to float32. A call with
a wrong argument raises an error and does not change the builder.

ValueError: a number is not finite or is out of range, a vector does not have unit length, ...
IndexError: a body, joint, particle or shape does not exist.
NotImplementedError: a shape type is not supported.)";

inline constexpr char kAddPlane[] =
    R"(Adds a plane as a shape and returns its index.

plane: (a, b, c, d) of the plane a*x + b*y + c*z + d = 0 with the normal (a, b, c), body frame.
xform: used in place of `plane`: the pose (m, quaternion xyzw) of a plane with the normal +z.
width, length: the size along local x and y (m). The plane is infinite unless both are > 0.)";

inline constexpr char kBalanceInertia[] =
    R"(Whether finalize corrects an impossible inertia: one principal moment exceeds the sum of the
other two. True: finalize adds the least equal amount to all three moments and gives a
RuntimeWarning. False: finalize raises ValueError.)";

inline constexpr char kAddParticles[] =
    R"(Adds n particles.

pos, vel: positions {n, 3} (m) and velocities {n, 3} (m/s), world frame.
mass: {n} (kg); 0: a kinematic particle.
radius: {n} (m); None: default_particle_radius.
flags: {n} ParticleFlags; None: ACTIVE.

ValueError: the lists have different lengths.)";

inline constexpr char kAddParticle[] =
    R"(Adds a particle and returns its index.

pos, vel: position (m) and velocity (m/s), world frame.
mass: kg; 0: a kinematic particle.
radius: m; None: default_particle_radius.
flags: ParticleFlags.)";

inline constexpr char kBoundMass[] =
    R"(The least mass of dynamic bodies (kg, > 0); None: no bound. finalize sets a smaller mass to
this bound, except 0, and gives a warning. The inertia is not changed.)";

inline constexpr char kBoundInertia[] =
    R"(The least principal moment of inertia of bodies with a mass (kg*m^2, > 0); None: no bound. If
a moment is smaller, finalize adds the difference to all three moments and gives a warning.)";

inline constexpr char kBuilderJointQ[] =
    R"(The initial joint coordinates (m, rad, quaternions), joint by joint. For a body of add_body,
the coordinates are those of body_q unless they are set here.)";

inline constexpr char kBeginWorld[] =
    R"(Opens a new world and returns its index. All objects that are added until end_world belong to
this world. Objects outside of worlds have the index -1 and belong to all worlds. A shape of a world
collides with shapes of the same world and with shapes of all worlds.

gravity: m/s^2, world frame; None: the builder's gravity.

novaphy.Error: another world is open.)";

inline constexpr char kFinalize[] =
    R"(Checks the scene and returns a Model. The builder is not changed and may be finalized again.

device: the device of the model; None: the default device.
requires_grad: whether states of the model require gradients.
skip_validation: True: skip the checks and corrections of values, colors, masses and joints.

novaphy.Error: the device is not available.
ValueError: the scene is not valid.)";

}  // namespace novaphy::python::doc
