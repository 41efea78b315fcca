// Docstrings of SolverVBD and DiffSolverVBD.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDiffVbd[] =
    R"(The differentiable SolverVBD. An active tape records a step or rollout, for backward and for
jvp.

Gradients: positions, velocities, forces, targets, gravity, masses, radii, materials, rest shapes,
activations, and margins and materials of shapes. Points and normals of contacts are frozen. Another
array that carries a gradient raises NotImplementedError, with its name.

gradient: "unrolled" is exact for the sweeps that ran, back through every color of every iteration.
"implicit" is the gradient of the step's solution. Newton's method then takes the step to its
solution. Contacts damp only the motion inside the overlap.
initial_guess: "adaptive" carries a velocity from step to step and from rollout to rollout until
reset(). Unrolled gradients flow through this velocity. A solution does not depend on it.

Captures on a device record no jvp and no gradient="implicit".)";

inline constexpr char kDiffVbdInit[] =
    R"(Options are those of SolverVBD that have a gradient, and with gradient="implicit":

gradient_tolerance: 1e-4; the relative residual at which the step and the linear system count as
solved.
gradient_sweeps: 200; the most sweeps for a linear system.
newton_iterations: 30; the most iterations for a step.
allow_unconverged: False: novaphy.Error names the system that is not solved. True: gradient_info()
reports it.

Errors are those of SolverVBD. ValueError: one of these options with "unrolled".)";

inline constexpr char kDiffVbdInfo[] =
    R"(Returns the GradientInfo of the last chain of steps on a tape, after a backward or jvp. The
chain is a rollout, a loop of steps, or the last replay of a captured one.

A step is frozen if particles push against shapes other than infinite planes, because points and
normals of contacts are frozen.

primal: the VbdResidual of the step of the last backward or jvp.
linear_residual: with implicit gradients the relative residual of the linear system, else 0.
linear_sweeps: with implicit gradients the sweeps for the linear system.
converged: whether the step and the linear system are within the tolerance; True with unrolled
gradients.
halvings: with unrolled gradients the number of coarse steps of the step that were halved. The
result jumps where this number changes.

`novaphy.Error`: no backward or jvp has run.
`novaphy.Error`: a replay, or a step on a device, failed since the last call (not finite, not
solved, contacts that overflowed).)";

inline constexpr char kVbdInit[] =
    R"(iterations: the number of sweeps over all colors.
friction_epsilon: m/s; the slip at which friction reaches the Coulomb limit.
initial_guess: "inertia" (the inertial position), "previous" (the positions before) or "adaptive"
(the inertial position with the part of gravity that acted in the last step).
acceleration: the spectral radius of Chebyshev acceleration, in (0, 1).
tolerance: a connected component of particles ends its iterations when its relative residual is at
most this. None: with solve="converged" 1e-4.
safeguard: halves the step of a particle while its energy rises.
coarse: "auto": a coarse correction follows each iteration, for errors that span many particles.
None: iterations alone. Not together with acceleration.
solve: "iterations", or "converged": Newton's method continues after the iterations, until the step
is at the minimum of its energy. On the CPU, outside of captures.
particle_enable_self_contact: triangles push each other apart, with the model's soft_contact_ke,
soft_contact_kd and soft_contact_mu, and never cross. On the CPU, outside of captures, with
iterations alone.
particle_self_contact_radius: m; the distance at which contacts begin. None: twice particle_radius.
particle_self_contact_margin: Newton's name of the radius.
particle_self_contact_gap: m; how far beyond the radius contacts are known. None: a third of it.

ValueError: a bad option, particles without a color, a negative or NaN material.
NotImplementedError: names what is not supported.)";

inline constexpr char kVbdStep[] =
    R"(Advances state_in by dt (s) into state_out.

targets: {kinematic_count, 3} positions (m, world frame) of the kinematic particles at the end of
the step, in the order of their indices. None: the particles stay in place.

Errors are those of SolverBase.step.
ValueError: indices or colors that were edited after the solver was made, numbers that are not
finite.
`novaphy.Error`: contacts that overflowed, positions that do not stay finite, a step that
solve="converged" does not solve.)";

inline constexpr char kVbdResidual[] =
    R"(Returns the VbdResidual of the last step.

`novaphy.Error`: no step has run.
`novaphy.Error`: since the last call, a replay or a step on a device met numbers that are not
finite, or contacts that had overflowed.)";

}  // namespace novaphy::python::doc
