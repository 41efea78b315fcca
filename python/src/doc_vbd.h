// Docstrings of SolverVBD and DiffSolverVBD.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDiffVbd[] =
    R"(The differentiable SolverVBD. An active tape records a step or rollout, for backward and for
jvp.

Gradients: positions, velocities, forces, targets, gravity, masses, radii, materials, rest shapes,
activations, and margins and materials of shapes. Points and normals of contacts are frozen. Other
arrays that carry a gradient raise NotImplementedError by name.

gradient: "unrolled": exact for the sweeps that ran, back through every color of every iteration.
"implicit": of the solution of the step. Newton's method takes the step to its solution, which step
returns.
initial_guess: the velocity of "adaptive" goes from step to step and rollout to rollout until
reset(), with its gradient where it is unrolled. A solution does not depend on that velocity.

Captures on a device record no jvp and no gradient="implicit".)";

inline constexpr char kDiffVbdInit[] =
    R"(Options are those of SolverVBD that have a gradient, and with gradient="implicit":

gradient_tolerance: 1e-4; the relative residual of the step and of the linear system at which both
count as solved.
gradient_sweeps: 200; at most for a linear system.
newton_iterations: 30; at most for a step.
allow_unconverged: False: a novaphy.Error names what is not solved. True: gradient_info() says it.

Errors are those of SolverVBD. ValueError: one of these options with "unrolled".
NotImplementedError: coarse="auto" with gradient="unrolled".)";

inline constexpr char kDiffVbdInfo[] =
    R"(Returns the GradientInfo of the last chain of steps on a tape, after a backward or jvp. The
chain is a rollout, a loop of steps, or the last replay of a captured one.

Steps are frozen where particles push against shapes other than infinite planes: points and normals
of contacts are held.

primal: the VbdResidual of the step of the last backward or jvp.
linear_residual: with implicit gradients the relative residual of the linear system, else 0.
linear_sweeps: with implicit gradients the sweeps for the linear system.
converged: whether both are within the tolerance; True where unrolled.

`novaphy.Error`: there was no backward.
`novaphy.Error`: a replay, or a step on a device, failed since the last call (not finite, not
solved, contacts that overflowed).)";

inline constexpr char kVbdInit[] =
    R"(iterations: sweeps over all colors.
friction_epsilon: m/s; the slip at which friction reaches the Coulomb limit.
initial_guess: "inertia", "previous" (the positions before) or "adaptive" (with as much of gravity
as acted in the last step).
acceleration: Chebyshev's, by a spectral radius in (0, 1).
tolerance: ends a step when residual().relative is at most this.
safeguard: halves the step of a particle while its energy rises.
coarse: "auto": a step on smooth fields follows each iteration, for errors that span many particles.
None: iterations alone. Not together with acceleration.

ValueError: a bad option, particles without a color, a negative or NaN material.
NotImplementedError: names what is not covered.)";

inline constexpr char kVbdStep[] =
    R"(Advances state_in by dt (s) into state_out.

targets: {kinematic_count, 3} positions (m, world frame) of the kinematic particles at the end of
the
step, in the order of their indices. None: they stay.

Errors as SolverBase.step.
ValueError: indices or colors that were edited after the solver was made, numbers that are not
finite.
`novaphy.Error`: contacts that overflowed, positions that do not stay finite.)";

inline constexpr char kVbdResidual[] =
    R"(Returns the VbdResidual of the last step.

`novaphy.Error`: there was no step.
`novaphy.Error`: since the last call, a replay or a step on a device read or made numbers that are
not finite, or contacts that had overflowed.)";

}  // namespace novaphy::python::doc
