// Docstrings of SolverBase, SolverSemiImplicit and the functions of joint coordinates.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kStep[] =
    R"(Advances state_in by dt (s) and writes the result to state_out. The forces in state_in act in
the step. A solver may add its own forces to the forces in state_in.

state_in, state_out: two states. Without a tape, both may be the same state (else novaphy.Error).
control: the inputs of the step. None: the control of the model.
contacts: the contacts of state_in. None: no contact.

ValueError: two states that share memory, dt not finite or <= 0, objects of another model or
device.)";

inline constexpr char kSemiImplicit[] =
    R"(Models elements and contacts as springs and dampers, and integrates by symplectic Euler
(explicit forces). The bits are the same for any number of threads. On a tape a step raises an
error: DiffSemiImplicitSolver is the differentiable solver.

particles: external forces, springs, triangles, bending edges, tetrahedra, contacts with world-owned
shapes, gravity, the velocity limit.
rigid bodies: external forces, contacts, joints, gravity, the gyroscopic term, angular damping.)";

inline constexpr char kSemiImplicitInit[] =
    R"(Makes a solver for a model.

angular_damping: the damping of the angular velocity of bodies (1/s).
friction_law: the friction law of rigid contacts:

  "viscous": kf times the slip velocity, limited by the Coulomb cone.
  "huber": the same, smoothed for slip below friction_smoothing.
  "newton18": "viscous" with the bits of Newton 1.8, for comparison. Each of the two bodies gets the
  force at its own surface, and rounding makes spins grow, so angular momentum is not conserved.
  "newton17": the law of Newton 1.7, for comparison. This law uses friction_smoothing, and the
  friction force may exceed the Coulomb cone.

friction_smoothing: m/s; None: 0.1. ValueError with "viscous" and "newton18", which do not use it.
stick_ke: the stiffness (N/m) of a tangential spring at each rigid contact, with "viscous" only.
The springs let friction hold bodies at rest. 0: bodies creep slowly. A spring is found again in the
next step by rigid_contact_point_id. If state_in was not written by the last step, all springs
start anew.
joint_attach_ke: the stiffness of the springs that hold joints together (N/m and N*m/rad).
joint_attach_kd: the damping of these springs (N*s/m). The angular damping is 0.01 times this number
(N*m*s/rad). step raises an error if dt is so large that a single joint diverges.
enable_tri_contact: no effect, because contacts of particles with triangles are not supported.
particle_kf_bound: the largest allowed kf dt / m (1) of a contact of a particle of mass m. A larger
kf is reduced. With a bound of 2 or more, gradients can grow in every step in which friction acts.
inf: no bound, as in Newton.
penalty_law: "sampled": the force of a rigid contact at the start of the step. "mean": near the
begin and the end of a contact, the mean of this force over one step around the start. Near means: a
distance from the surface of at most the travel in half a step. Bounces then depend less on the time
within a step at which a contact begins.
sleep: a SleepConfig, on the CPU. None: no body sleeps.

step gives a RuntimeWarning (once) if ke or kd of touching shapes is so large that the contact
diverges.

NotImplementedError: a part of the model is not supported, or sleep on another device than the CPU.
NotImplementedError: penalty_law="mean" with particles, stick_ke or a law of Newton.)";

inline constexpr char kSleepConfig[] =
    R"(The rule by which bodies fall asleep: sleeping bodies do not move and cost little time.

An island is a set of bodies that contacts link. An island falls asleep when each of its bodies has
been slower than both `speed` and `spin` for the time `after`. The velocities are then set to 0, and
the poses stay the same bit by bit. SimState.body_sleep says which bodies sleep.

An island wakes in the step in which a moving body touches it, a force acts on it, or a kinematic
body that touches it moves. A write to an array of the model wakes all bodies. A write to the pose
or velocity of a body wakes the island of the body. For a kinematic body, the write wakes its world.

speed: the bound of the speed of the center of mass (m/s).
spin: the bound of the angular speed (rad/s).
after: how long a body must be below both bounds (s).

With the broad phase "sap" on the CPU, CollisionPipeline.collide leaves out contacts between
sleeping bodies if at most half of the shapes move.

ValueError: a number is negative or not finite, or `after` is 0 or more than 1000 s.)";

inline constexpr char kStableDt[] =
    R"(Returns the longest dt (s) at which springs, dampers and sticking friction are stable
together; inf if none of them acts. The bound holds for any motion of the neighbors of a body or
particle. Elements of particles are evaluated at their rest shape, and contacts at the state. A
longer step may also be stable, because the friction force is limited by its cone.

ValueError: the state or the contacts belong to another model, or the contacts have overflowed.)";

inline constexpr char kEvalMimic[] =
    R"(Sets the positions and rates of all mimic joints (add_constraint_mimic) from the joints that
they mimic, as every step does. Call eval_mimic after joint_q or joint_qd was edited.

joint_q: {coordinates} (m, rad), written in place.
joint_qd: {degrees of freedom} (m/s, rad/s), written in place.

The function has no gradient: on a tape it raises an error for arrays that require a gradient.
ValueError: an array has a wrong number of rows.)";

inline constexpr char kSolverBase[] =
    R"(The base class of all solvers. Only one thread at a time may use a solver and its captured
graphs. A second thread gets a novaphy.Error.)";

inline constexpr char kEvalFk[] =
    R"(Computes the poses and velocities of bodies from joint coordinates (forward kinematics), and
writes them to body_q and body_qd of the state.

Bodies that are the child of a joint of an articulation are written. All other bodies keep their
values. Quaternions in joint_q are normalized. Mimic joints use their own entries of joint_q.

joint_q: {coordinates} (m, rad, quaternions).
joint_qd: {degrees of freedom} (m/s, rad/s).

The function has no gradient: on a tape it raises an error for arrays that require a gradient.

ValueError: an array has a wrong number of rows, the state belongs to another model, or a quaternion
has the length 0. On a device, on a tape and in a capture such a quaternion gives NaN instead.)";

inline constexpr char kEvalIk[] =
    R"(Computes the joint coordinates of all joints from the poses and velocities of bodies in a
state, and writes them to joint_q and joint_qd. The part of a relative motion that a joint does not
allow is ignored. Angles are in [-pi, pi].

joint_q: {coordinates} (m, rad, quaternions), written in place.
joint_qd: {degrees of freedom} (m/s, rad/s), written in place.

The function has no gradient: on a tape it raises an error for states that require a gradient.

ValueError: an array has a wrong number of rows, or the state belongs to another model.
NotImplementedError: the axes of a D6 joint are not perpendicular.)";

inline constexpr char kNotify[] =
    R"(Tells the solver that parts of the model were changed by other means than NovaPhy's arrays,
for example through a pointer.

flags: the ModelFlags of the changed parts.)";

}  // namespace novaphy::python::doc
