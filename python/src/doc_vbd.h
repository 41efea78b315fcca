// Docstrings of SolverVBD and DiffSolverVBD.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDiffVbd[] =
    R"(The differentiable form of SolverVBD. An active tape records a step or a rollout, for
backward and jvp.

Gradients are computed for positions, velocities, forces, targets, gravity, masses, radii,
materials, rest shapes, activations, and margins and materials of shapes. Points and normals of
contacts are frozen. NotImplementedError, with the name of the array: another array requires a
gradient.

gradient: "unrolled": the exact derivative of the iterations that ran. "implicit": the derivative of
the solution of a step, by the implicit function theorem. A step then continues by Newton's method
until it has converged, and contacts damp only the motion within the overlap.
initial_guess: "adaptive" keeps a velocity from step to step and from rollout to rollout until
reset(). Unrolled gradients include the derivative by this velocity. A converged solution does not
depend on the initial guess.

A model with bodies, joints and contacts, without particles, needs gradient="implicit". Gradients are
computed for poses, velocities, body_f, gravity, masses, inertias, joint_f, targets, stiffness and
damping of drives and rods, damping, armature and friction of joints, and materials of shapes.
Captures and checkpoints raise NotImplementedError.

A capture on a device cannot record jvp or gradient="implicit".)";

inline constexpr char kDiffVbdInit[] =
    R"(Makes a solver. For the first options see SolverVBD; gradient is "unrolled" or "implicit".
The following options need gradient="implicit":

gradient_tolerance: the relative residual at which a step and the linear system of its gradient
count as solved; None: 1e-4.
gradient_sweeps: the largest number of sweeps for a linear system; None: 200.
newton_iterations: the largest number of Newton iterations of a step; None: 30.
allow_unconverged: False or None: a system that is not solved raises novaphy.Error, which names the
system. True: gradient_info() reports the system.

The errors are those of SolverVBD. ValueError: one of these options with gradient="unrolled".)";

inline constexpr char kDiffVbdInfo[] =
    R"(Returns the GradientInfo of the last consecutive steps on a tape, after backward or jvp. The
steps are a rollout, a loop of steps, or the last replay of a captured rollout or loop.

A step has the label "frozen" if particles push against shapes other than infinite planes, because
the derivative keeps points and normals of contacts constant.

Fields of this solver, for the step that backward or jvp processed last:
primal: the VbdResidual of the step.
linear_residual: with implicit gradients, the relative residual of the linear system, else 0.
linear_sweeps: with implicit gradients, the number of sweeps for the linear system.
converged: whether the step and the linear system are within the tolerance; True with unrolled
gradients.
halvings: with unrolled gradients, how many coarse corrections of the step were halved. The gradient
is not continuous where this number changes.

`novaphy.Error`: neither backward nor jvp has run.
`novaphy.Error`: since the last call, a replay or a step on a device has failed: its values are not
finite, its system is not solved, or the contacts have overflowed.)";

inline constexpr char kVbdInit[] =
    R"(Makes a solver for a model.

iterations: the number of sweeps over all colors in a step.
friction_epsilon: the slip at which friction reaches the Coulomb limit (m/s).
initial_guess: the positions at which the iterations start. "inertia": the inertial positions.
"previous": the positions of state_in. "adaptive": the inertial positions, but with only the part of
gravity that accelerated the particles in the last step.
acceleration: the spectral radius of Chebyshev acceleration, in (0, 1). None: no acceleration.
tolerance: the relative residual at which a connected component of particles ends its iterations.
None: all iterations run. With solve="converged" all iterations run, and the tolerance (None: 1e-4)
is the residual at which the step counts as converged.
safeguard: True halves the step of a particle as long as the step raises the energy.
coarse: "auto": a coarse correction follows each iteration and reduces errors that span many
particles. Acceleration, safeguard, self-contact and dynamic bodies switch the correction off; the
attribute `coarse` is then None. None: no correction.
solve: "iterations": a step ends after the iterations. "converged": Newton's method continues until
the step is at the minimum of its energy; on the CPU, outside of captures.
lhs_regularization: the relative regularization of nearly singular blocks (1).
particle_enable_self_contact: True: triangles push each other apart, with the model's
soft_contact_ke, soft_contact_kd and soft_contact_mu, and never cross. Possible on the CPU, outside
of captures, with solve="iterations" and without acceleration, tolerance and safeguard.
particle_self_contact_radius: the distance at which self-contacts begin (m). None: twice
particle_radius.
particle_self_contact_margin: another name of the radius, as in Newton.
particle_self_contact_gap: the additional distance up to which pairs are searched (m). None: a third
of the radius.

ValueError: an option is out of range, a particle has no color, or a material is negative or NaN.
NotImplementedError: a part of the model is not supported; the message names the part.)";

inline constexpr char kVbdStep[] =
    R"(Advances state_in by dt (s) into state_out.

targets: {kinematic_count, 3} positions (m, world frame) of the kinematic particles at the end of
the step, in the order of their indices. None: the particles stay in place.

The errors of SolverBase.step, and these:
ValueError: indices or colors were edited after the solver was made, or an input is not finite.
`novaphy.Error`: the contacts have overflowed, or positions became infinite or NaN.
`novaphy.Error`: the step has not converged with solve="converged".)";

inline constexpr char kVbdResidual[] =
    R"(Returns the VbdResidual of the last step.

`novaphy.Error`: no step has run.
`novaphy.Error`: since the last call, a replay or a step on a device had values that are not finite,
or contacts that had overflowed.)";

}  // namespace novaphy::python::doc
