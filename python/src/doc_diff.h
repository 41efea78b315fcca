// Docstrings of the module diff.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kRowLabels[] =
    R"(Returns a list with the label of each rigid contact: how DiffSemiImplicitSolver
differentiates the contact in a step from the state.

"exact": the contact points and the normal move with the poses of both bodies.
"frozen": the derivative keeps the points constant in the body frames, and the normal constant in
the world frame.

A contact can be "exact" only if collide found it from this state, and nothing was changed since.
Contacts of another state, contacts that were written or copied, and contacts of a captured graph
are "frozen". Contacts are also frozen if another library has a writable view of the contacts or
poses. A rollout with the argument `contacts` freezes all contacts.

ValueError: the state or the contacts belong to another model.)";

inline constexpr char kRigidStep[] =
    R"(Returns the poses {b, 7} and velocities {b, 6} of bodies after a step of dt (s).

One kernel finds contacts of boxes, spheres and capsules with infinite planes of the world, applies
the friction law "huber", and takes a step of symplectic Euler. Gradients are exact, also for
masses, inertias and contact materials.

body_q: poses {b, 7} (m, quaternion xyzw).
body_qd: velocity of the center of mass (m/s) and angular velocity (rad/s) {b, 6}.
body_f: force (N) and moment about the center of mass (N*m) {b, 6}.
angular_damping: 1/s.
friction_smoothing: the slip below which friction is smooth (m/s).
newton_spin: True gives the bits of Newton 1.8, whose rounding makes spins grow by 2e-7 per step.

NotImplementedError: two shapes may collide and are not supported; the message names them.)";

inline constexpr char kTrajectory[] =
    R"(The steps + 1 states of a rollout, contiguous in memory. trajectory[t] is the SimState after
t steps. State 0 starts with the model's initial values.

All states share the same force arrays, which act in every step. Write the forces through state
0.)";

inline constexpr char kTrajectoryInit[] =
    R"(Makes a trajectory for a model.

steps: the number of steps, >= 0.
requires_grad: True: gradients of the states are computed.
checkpoint: None: all states are stored. A number k: only every k-th state and the last state are
stored, and backward recomputes the steps between two stored states, with the same bits. A text such
as "64MiB": the smallest k whose stored states fit in this memory.

ValueError: steps < 0, an interval < 1, or no interval fits in the memory.)";

inline constexpr char kRollout[] =
    R"(Runs the steps of a trajectory from state `start` to state `stop`, with steps of dt (s). The
result has the same bits as a loop of calls of step, in which the forces of the trajectory are
restored before every step.

An array with a dimension {steps} has one value for each step. An array without this dimension acts
in every step. The call does not write its inputs.

control: a Control for all steps, or a sequence of m Controls, each for steps / m consecutive steps.
None: the control of the model.
contacts: Contacts for all steps; None: no contact.
forces: {n, 3} or {steps, n, 3} (N, world frame), added to particle_f.
body_forces: {b, 6} or {steps, b, 6}, added to body_f: force (N) and moment about the center of mass
(N*m), world frame.
targets: {k, 3} or {steps, k, 3} (m, world frame): positions of the k kinematic particles at the end
of a step, for SolverVBD and DiffSolverVBD. NotImplementedError: another solver.
pipeline: a CollisionPipeline, which finds the contacts of each step, instead of `contacts`.
start, stop: the first state, which must be a stored state, and the last state; None: the end.
joint_f, joint_target_qd: {dofs} or {steps, dofs}, in place of the arrays of the control.
joint_target_q: {coordinates} or {steps, coordinates}, in place of the array of the control.
ctrl: {actuators} or {steps, actuators}, in place of the array of the control.

An active tape records the rollout of a differentiable solver, with gradients for forces and
controls. Such a rollout may be captured. Other solvers raise an error on a tape and in a capture.

ValueError: an argument belongs to another model, or has a wrong size.)";

inline constexpr char kContactGradient[] =
    R"(How gradients treat the times at which contacts begin and end: "auto", "code" or "motion". The
states of the simulation are the same.

"code": the derivative of the computed steps. The steps in which a contact begins and ends count as
constants.
"motion": the derivative also moves the times at which a contact begins and ends.
NotImplementedError on a device, in a capture, with enable_static_contacts or penalty_law="mean".
"auto": "motion" where it is supported and the model has no springs, cloth or soft bodies, else
"code". gradient_info gives the reason.)";

inline constexpr char kDiffGradientInfo[] =
    R"(Returns the GradientInfo of the last consecutive steps on a tape: a rollout, a loop of steps,
or the last replay of a captured rollout or loop.

The call reads the states and contacts of the steps. With checkpoints each step is read when it
runs. A step has the label "frozen" if a contact pushes whose point and normal are frozen (see
diff.rigid_contact_gradient_labels). Contacts of particles are frozen, unless the pipeline of a
rollout finds them on shapes other than hulls, meshes and finite planes. The contacts of enable_static_contacts are exact, and count as events.)";

inline constexpr char kDiffSemiImplicit[] =
    R"(The differentiable form of SolverSemiImplicit, whose steps have the same bits. An active tape
records the kernels of a step.

Gradients are exact for positions, velocities, forces, masses, radii, gravity, contact materials,
activations, and for materials, rest lengths and rest angles of elements. Points and normals of
contacts are frozen, with two exceptions. Contacts between bodies are exact if collide found them
from the state of the step (see diff.rigid_contact_gradient_labels). Contacts of particles are exact
if the pipeline of a rollout finds them, except on hulls, meshes and finite planes.

A step adds the forces of elements and contacts to state_in.particle_f. Call clear_forces() before
state_in is used for another step.)";

inline constexpr char kDiffStableDt[] =
    R"(Returns the longest stable dt (s) for the elements of particles and for the contacts in the
state, as SolverSemiImplicit.stable_dt does.

contacts: the contacts of the state. None: with enable_static_contacts, each particle counts one
contact with each shape that it may touch.

A step with a longer dt gives a RuntimeWarning (once) if springs or dampers certainly diverge.

ValueError: the state or the contacts belong to another model.)";

inline constexpr char kRecompute[] =
    R"(Returns a copy of state t. If state t is not stored, the call recomputes the state from the
last stored state before t.

RuntimeError: no rollout has run. RuntimeError: the recomputed steps do not reproduce the next
stored state, because an input of the rollout was changed.)";

inline constexpr char kKfBound[] =
    R"(The largest allowed kf dt / m (1) of a contact of a particle: kf is the friction coefficient
(N*s/m), dt the step and m the particle's mass. A larger kf is reduced to this bound. With a bound
of 2 or more, gradients can grow in every step in which friction acts. inf: no bound, as in
Newton.)";

inline constexpr char kOrientationLoss[] =
    R"(Returns a loss {1} for the orientation, the height and the velocities of a body:

    wa (1 - R a . ta) + wb (1 - R b . tb) + wh (z - h)^2 + wv |v|^2 + ww |w|^2

R is the body's rotation, z its height (m), v its velocity (m/s) and w its angular velocity (rad/s).
local_axis_a, local_axis_b: the axes a and b in the body frame; they are normalized.
target_axis_a, target_axis_b: the directions ta and tb in the world frame; they are normalized.
axis_weight_a, axis_weight_b: wa and wb. target_height: h (m). height_weight: wh.
linear_velocity_weight, angular_velocity_weight: wv and ww.

IndexError: the body does not exist.
ValueError: an axis has the length 0.)";

inline constexpr char kStaticForces[] =
    R"(Returns particle_f {n, 3} plus the contact forces (N) of all world-owned planes, boxes,
spheres, capsules, cylinders, cones and ellipsoids, by exact distances.

particle_q, particle_qd, particle_f: {n, 3} (m, m/s, N).
soft_contact_margin: the distance up to which a shape acts (m).

Gradients are exact for positions, velocities, forces, radii and materials. Shapes have no
gradient.)";

inline constexpr char kParticleStep[] =
    R"(Returns the positions {n, 3} (m) and velocities {n, 3} (m/s) of particles after a step of dt
(s) of symplectic Euler. Gradients are exact, also for gravity and masses.

particle_q, particle_qd, particle_f: {n, 3} (m, m/s, N).)";

inline constexpr char kTrianglesForces[] =
    R"(Returns particle_f {n, 3} plus the forces (N) of all triangles.

particle_q, particle_qd, particle_f: {n, 3} (m, m/s, N).
tri_activations: {t}.
tri_materials: {t, 5}: tri_ke, tri_ka, tri_kd, tri_drag, tri_lift.

Gradients are exact for all inputs.)";

inline constexpr char kSpringsForces[] =
    R"(Returns particle_f {n, 3} plus the forces (N) of all springs.

particle_q, particle_qd, particle_f: {n, 3} (m, m/s, N).
spring_stiffness: {s} (N/m).
spring_damping: {s} (N*s/m).
spring_rest_length: {s} (m).

Gradients are exact for all inputs.)";

inline constexpr char kStaticContactsOption[] =
    R"(Whether every step itself computes the contacts of particles with world-owned shapes, by
exact distances. The argument `contacts` of step must then be None.)";

inline constexpr char kRigidContactsOption[] =
    R"(Whether contacts of bodies act: the rigid contacts of `contacts`, or with
enable_static_contacts the contacts with infinite planes of the world.)";

}  // namespace novaphy::python::doc
