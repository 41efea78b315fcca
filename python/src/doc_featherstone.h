// Docstrings of SolverFeatherstone and of the functions of articulations.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kFeatherstone[] =
    R"(Steps articulations in the coordinates of their joints. The bits are the same wherever an
articulation stands, and for any number of threads. DiffFeatherstoneSolver is the differentiable
one.

joints: all types but DISTANCE; drives by target mode, limits, effort and
velocity limits, damping, armature, dry friction.
forces: joint_f, body_f, gravity, angular damping, and contacts of shapes. Arrays without effect
(joint_enabled, joint_act, ...) raise NotImplementedError.
reads: joint_q, joint_qd and body_f of state_in.
writes: joint_q, joint_qd, body_q and body_qd of state_out, and rigid_contact_force of the contacts.

On a tape a step runs and is not recorded. The arrays that it wrote may not be used on that tape.

A model on a device is stepped there with the bits of the cpu, contacts only by "pgs" ("penalty"
raises NotImplementedError). The host does not wait for such a step, and a capture can record the
step. An articulation that fails, and with contacts its island, gets NaN. check_last_step() raises
the reason.)";

inline constexpr char kFeatherstoneInit[] =
    R"(Makes a solver for a model.

angular_damping: 1/s, of angular dofs; Newton 1.8 has 0.05.
implicit_drives: True: drives, limits and damping are evaluated at the end of the step. Any gains
are stable then, and limits only push. False: at the start of the step, as in Newton 1.8.
contact: "pgs" (impulses by projected Gauss-Seidel), "penalty" (springs of the shapes' ke, kd and
kf, explicit) or None (contacts raise).
friction_smoothing: m/s, of "penalty": friction is smooth below this slip.
joint_limits: "spring" (by joint_limit_ke and _kd) or "row": limits of joints with one dof let their
gap close in a step, and no more (an impulse that only pushes). Cones of BALL joints stay springs.
joint_limit_restitution: 0 to 1, of "row", for approaches above restitution_threshold.
sleep: a SleepConfig, with "pgs" or None on the CPU. Bodies on FREE joints may sleep, bodies of other
articulations never do. None: no body sleeps.

The other options belong to contact="pgs":
friction_cone: "cone" or "pyramid".
pgs_iterations, pgs_tolerance: at most so many sweeps, fewer when a sweep changes velocities by less
than the tolerance (m/s).
pgs_erp, pgs_slop, max_depenetration_velocity: a step takes the part pgs_erp of an overlap beyond
pgs_slop (m) away, at no more than this velocity (m/s).
pgs_cfm: softness, (m/s)/(N s).
restitution_threshold: m/s; slower approaches do not bounce.
warm_start: begins with the impulses of the step before.
compliant_contacts: overlaps push by the shapes' ke and kd instead of pgs_erp and pgs_slop.

ValueError: a bad option, or one that the contact does not read.
NotImplementedError: parts of a model that are not supported.)";

inline constexpr char kCheckLastStep[] =
    R"(Waits for the last step or replay of a model on a device.

`novaphy.Error`: the step failed; the message names the dof, as step does on the cpu.
IndexError: a row of the contacts names a shape that does not exist, or joins two worlds.)";

inline constexpr char kMassMatrix[] =
    R"(Returns the mass matrices {articulations, D, D}, padded with 0; D is the largest number of
dofs of an articulation. With mimic joints the matrix is that of the free tree. The matrix of the
joined tree is T^T M T, with qd = T qd_reduced.)";

inline constexpr char kInverseDynamics[] =
    R"(Returns the generalized forces {dofs} (N, N*m) that cause the accelerations qdd {dofs} at
state.joint_q and joint_qd: H qdd + bias, with armature. Drives, limits and body_f are left out. The
rates and forces of a FREE joint are those of the center of mass, in the axes of the joint's frame
in the parent.)";

}  // namespace novaphy::python::doc
