// Docstrings of the module diff.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kRowLabels[] =
    R"(Returns the label of the gradient of each row of rigid_contact_*, in a step from the state.

"exact": DiffSemiImplicitSolver follows points and normal with the poses of both bodies.
"frozen": the points stay in the frames of their bodies, and the normal in the world.

A row is also "frozen" unless collide found it from this state as it is. Examples are rows of
another state, rows that were written or copied, and rows of a captured graph. Rows are frozen too
if another library has a writable view of the rows or poses. A rollout with `contacts` freezes all
rows in all steps.

ValueError: a state or contacts of another model.)";

inline constexpr char kRigidStep[] =
    R"(Returns poses {b, 7} and twists {b, 6} after dt (s).

One kernel finds contacts of boxes, spheres and capsules with infinite planes of the world, applies
the friction law "huber", and takes a step of symplectic Euler. Gradients are exact, for masses,
inertias and contact materials too.

newton_spin: the bits of Newton 1.8, whose rounding makes spins grow by 2e-7 in each step.

NotImplementedError: names two shapes that may meet and are not supported.)";

inline constexpr char kTrajectory[] =
    R"(The states of a rollout, contiguous in memory: steps + 1 states, of which [t] is the SimState
after t steps. State 0 starts with the model's initial values.

The states share their force arrays. Forces act in every step, and state 0 alone writes them.)";

inline constexpr char kTrajectoryInit[] =
    R"(Makes a trajectory for a model.

steps: the number of steps, >= 0.
checkpoint: None keeps all states. An interval k keeps every k-th state and the last one. "64MiB"
chooses the smallest interval whose states take no more. With an interval, backward runs each
stretch between two kept states once more: the same bits for more time.

ValueError: steps < 0, an interval < 1, or a size that no interval meets.)";

inline constexpr char kRollout[] =
    R"(Runs the steps of a trajectory from its state `start` (kept) to `stop` (None: the last). The
bits are those of a loop of step in which every step starts from the force in trajectory.particle_f.

Arrays with a row for each step act each in its own step, other arrays in every step. Inputs are
only read.

forces: {n, 3} or {steps, n, 3} (N, world frame), besides particle_f.
body_forces: {b, 6} or {steps, b, 6} (N, N*m about the center of mass, world frame), besides body_f.
targets: {k, 3} or {steps, k, 3} (m, world frame), the positions of the k kinematic particles of
SolverVBD or DiffSolverVBD at the end of a step. NotImplementedError: another solver.
pipeline: a CollisionPipeline that finds the contacts of every step anew, instead of `contacts`.
control: one for all steps, or a sequence of m, each for an m-th of the steps.
joint_f, joint_target_qd: {dofs} or {steps, dofs}, in place of that array of the control.
joint_target_q: {coordinates} or {steps, coordinates}, likewise.
ctrl: {actuators} or {steps, actuators}, likewise.

A differentiable solver records on an active tape, with gradients for the forces and the controls,
and may be captured. Other solvers raise there.

ValueError: an argument of another model or size.)";

inline constexpr char kContactGradient[] =
    R"(The treatment of contacts that begin and end. The states are the same with both.

"code": the steps in which a contact begins and ends do not depend on the state.
"motion": the times at which a contact begins and ends move with the state. On the CPU, outside of
captures and without enable_static_contacts; else NotImplementedError.)";

inline constexpr char kDiffGradientInfo[] =
    R"(Returns the GradientInfo of the last chain of steps on a tape: a rollout, a loop of steps, or
the last replay of a captured one.

The call reads the states and contacts. With checkpoints, steps are read as they run. A step is
frozen if contacts push whose points and normals are frozen: see
diff.rigid_contact_gradient_labels. Contacts of particles are frozen unless a rollout finds them.
The contacts of enable_static_contacts are exact, and count as events.)";

inline constexpr char kDiffSemiImplicit[] =
    R"(The differentiable SolverSemiImplicit: the same step as generated kernels, with the same
bits. An active tape records the kernels on the states' own arrays.

Exact gradients: positions, velocities, forces, masses, radii, gravity, contact materials,
activations, and materials, rest lengths and rest angles of elements.
Frozen: points and normals of contacts. Contacts between bodies are exact if collide found them from
the state of the step as it is. See diff.rigid_contact_gradient_labels.

A step leaves forces in state_in.particle_f for reading. Call clear_forces() before the state is
used again.)";

inline constexpr char kDiffStableDt[] =
    R"(Returns the longest stable dt (s) for the elements of particles and the contacts that touch
in the state, as SolverSemiImplicit.stable_dt. Without contacts, static contacts
count as one contact of each particle with each shape that the particle may touch.

A longer step warns (RuntimeWarning, once) where springs or dampers diverge in any case.

ValueError: a state or contacts of another model.)";

inline constexpr char kRecompute[] =
    R"(Returns a copy of state t. A state that is not kept is computed again from the last kept
state before it.

RuntimeError: no rollout has run, or the next kept state does not come out bit by bit, because
something was changed.)";

inline constexpr char kKfBound[] =
    R"(The largest kf dt/m of a contact of a particle of mass m (1). A larger kf counts as this
bound. From 2 on, gradients grow in every step in which friction acts. inf: kf as it is, as in
Newton.)";

inline constexpr char kOrientationLoss[] =
    R"(Returns the loss {1} of one body: wa (1 - R a . ta) + wb (1 - R b . tb) + wh (z - h)^2 + wv
|v|^2 + ww |w|^2. R is the body's rotation. The local axes a and b have the targets ta and tb in the
world frame. All four are normalized. z is the height (m), v and w are the velocities.

IndexError: no such body.
ValueError: an axis of length 0.)";

}  // namespace novaphy::python::doc
