// Docstrings of SolverBase, SolverSemiImplicit and the functions of joint coordinates.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kStep[] =
    R"(Advances state_in by dt (s) into state_out. Forces in state_in act. After the step state_in
also holds the forces that the solver added.

state_in, state_out: two states, or the same state twice where no tape records (else novaphy.Error).
control: None: the model's.
contacts: None: no contact.

ValueError: two states that share memory, dt not finite or <= 0, objects of another model or device.)";

inline constexpr char kSemiImplicit[] =
    R"(Computes forces as springs and dampers, then takes a step of symplectic Euler. The bits are
the same for any number of threads. DiffSemiImplicitSolver is the differentiable one; this solver
raises on a tape.

particles: external forces, springs, triangles, bending edges, tetrahedra, contacts with world-owned
shapes, gravity, the velocity limit.
rigid bodies: external forces, contacts, gravity, the gyroscopic term, angular damping.)";

inline constexpr char kSemiImplicitInit[] =
    R"(Makes a solver for a model.

angular_damping: 1/s, of bodies.
friction_law: the law of friction of rigid contacts:
  "viscous": kf times the slip, cut off at the Coulomb cone.
  "huber": the same, smooth for slips below friction_smoothing.
  "newton18": "viscous" with the bits of Newton 1.8, for comparison. Two bodies get the force each
  at its own surface, and rounding makes spins grow, so angular momentum is not kept.
  "newton17": the law of Newton 1.7, for comparison. This law reads friction_smoothing, and its
  force may exceed the cone.
friction_smoothing: m/s; None: 0.1. ValueError with "viscous" and "newton18", which do not read it.
stick_ke: N/m of each rigid contact, with "viscous" only. A spring along the surface lets friction
hold bodies at rest. rigid_contact_point_id identifies the spring from step to step. 0: bodies
creep. A state that the last step has not written starts new springs.
joint_attach_ke: the stiffness that holds joints together (N/m and N*m/rad).
joint_attach_kd: the damping that holds joints together (N*s/m). The angular damping has 0.01 of the
number (N*m*s/rad). step raises for a dt at which one attachment alone diverges.
enable_tri_contact: contacts of particles with triangles, which are not supported yet.
particle_kf_bound: the largest kf dt/m of a contact of a particle of mass m; a larger kf counts as
this bound. From 2 on, gradients grow in every step in which friction acts. inf: kf as it is, as
in Newton.
penalty_law: "sampled": the force of a rigid contact at the start of the step. "mean": for gaps
below the travel of half a step, the mean of that force over one step around the start. Bounces then
depend little on the time in its step at which a touch begins.
sleep: a SleepConfig, on the CPU. None: no body sleeps.

step warns (RuntimeWarning, once) if ke or kd of touching shapes diverges.

NotImplementedError: parts of a model that are not supported, sleep on another device;
penalty_law="mean" with particles, stick_ke or a law of Newton.)";

inline constexpr char kSleepConfig[] =
    R"(The rule by which bodies fall asleep. An island is a set of bodies that touch each other. An island falls
asleep once each of its bodies has been slower than speed and spin for the time after. Its bodies
then get the velocity 0 and keep their bits. SimState.body_sleep says which bodies sleep.

An island wakes in the step in which a moving body touches it, a force acts on it, or a kinematic
body that touches it moves. A written array of the model wakes all bodies. A written pose or velocity
of a body wakes its island, and that of a kinematic body its world.

speed: the bound of the speed of the center of mass (m/s).
spin: the bound of the angular speed (rad/s).
after: the time below both bounds (s).

CollisionPipeline.collide leaves out contacts between bodies that sleep with the broad phase "sap"
on the CPU, where at most half of the shapes move.

ValueError: a number is negative or not finite, or `after` is 0 or more than 1000 s.)";

inline constexpr char kStableDt[] =
    R"(Returns the longest dt (s) at which springs, dampers and sticking friction are stable
together, for any motion of the neighbors of a body or particle; inf if none acts. Elements of
particles count at their rest shape, contacts as they touch in the state. A longer step may work,
because friction ends at its cone.

ValueError: a state or contacts of another model, contacts that have overflowed.)";

inline constexpr char kEvalMimic[] =
    R"(Writes the coordinates and rates of mimic joints (add_constraint_mimic) from those of their
leaders, as a step does. Call the function after a write to the leaders' values.

joint_q, joint_qd: {coordinates} and {degrees of freedom}.

No gradient: on a tape the call raises for coordinates that carry one. ValueError: wrong rows.)";

inline constexpr char kSolverBase[] =
    R"(The base of all solvers. One thread at a time may use a solver and its captured graphs.
Another thread gets a novaphy.Error.)";

inline constexpr char kEvalFk[] =
    R"(Writes body_q and body_qd of the state, from joint_q {coordinates} and joint_qd {degrees of
freedom}: the poses and velocities of the children of all joints of articulations. Other bodies keep
their values. Quaternions are normalized. Mimic joints take their own entries of joint_q.

No gradient: on a tape the call raises for coordinates that carry one.

ValueError: wrong rows, a state of another model, a quaternion of length 0 (NaN on a device, on a
tape and in a capture).)";

inline constexpr char kEvalIk[] =
    R"(Writes joint_q and joint_qd, the coordinates and rates of all joints, from body_q and body_qd
of the state. Motions that a joint does not allow are left out. Angles are in [-pi, pi].

No gradient: on a tape the call raises for poses and velocities that carry one.

ValueError: wrong rows, a state of another model.
NotImplementedError: a D6 whose axes are not perpendicular.)";

}  // namespace novaphy::python::doc
