// Docstrings of SolverFeatherstone and of the functions of articulations.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kFeatherstone[] =
    R"(Simulates articulations in generalized coordinates, by Featherstone's algorithms. The bits do
not depend on the position of an articulation in the model or on the number of threads.
DiffFeatherstoneSolver is the differentiable solver.

joints: all types but DISTANCE; drives by target mode, position limits, effort and velocity limits,
damping, armature, dry friction.
forces: joint_f, body_f, gravity, angular damping, and contacts of shapes. An array that has no
effect (joint_enabled, joint_act, ...) raises NotImplementedError if its values are not the default.
reads: joint_q, joint_qd and body_f of state_in.
writes: joint_q, joint_qd, body_q and body_qd of state_out, and rigid_contact_force of the contacts.

On a tape a step runs without being recorded. Operations on this tape may not use its results.

A model on a device is simulated on the device, with the same bits as on the CPU. Contacts on a
device must be "pgs" ("penalty" raises NotImplementedError). The host does not wait for the step,
and a capture can record the step. If the step of an articulation fails, the state of the
articulation becomes NaN, with contacts that of its island. check_last_step() then raises an error
with the reason.)";

inline constexpr char kFeatherstoneInit[] =
    R"(Makes a solver for a model.

angular_damping: the damping of angular dofs (1/s); Newton 1.8 has 0.05.
implicit_drives: True: drives, limits and damping are evaluated at the end of the step. All gains
are then stable, and limits only push. False: evaluated at the start of the step, as in Newton 1.8.
contact: "pgs" (impulses by projected Gauss-Seidel), "penalty" (explicit springs with the shapes'
ke, kd and kf) or None (contacts raise an error).
friction_smoothing: the slip below which friction is smooth (m/s), for "penalty".
joint_limits: "spring": springs with joint_limit_ke and joint_limit_kd. "row": an impulse that only
pushes keeps a joint with one dof from passing its limit in a step. The cone limits of BALL joints
are always springs.
joint_limit_restitution: 0 to 1, for "row": the restitution of a limit that is reached faster than
restitution_threshold.
sleep: a SleepConfig, on the CPU and with contact "pgs" or None. Only bodies on FREE joints can
sleep. None: no body sleeps.

The other options belong to contact="pgs":
friction_cone: "cone" or "pyramid".
pgs_iterations: the largest number of sweeps.
pgs_tolerance: m/s; the sweeps end when a sweep changes velocities by less than this.
pgs_erp: the part of the overlap beyond pgs_slop that a step removes (1).
pgs_slop: the overlap that remains (m).
max_depenetration_velocity: the largest velocity at which a step removes overlap (m/s).
pgs_cfm: the softness of contacts, (m/s)/(N s).
restitution_threshold: the approach speed below which contacts do not bounce (m/s).
warm_start: True: the sweeps start with the impulses of the last step.
compliant_contacts: True: overlaps push by the shapes' ke and kd instead of pgs_erp and pgs_slop.

ValueError: an option is out of range, or has no effect with this contact.
NotImplementedError: a part of the model is not supported.)";

inline constexpr char kCheckLastStep[] =
    R"(Waits for the last step or replay of a model on a device.

`novaphy.Error`: the step has failed. The message names the dof, like the error of step on the CPU.
IndexError: a contact has a shape that does not exist, or two shapes of different worlds.)";

inline constexpr char kMassMatrix[] =
    R"(Returns the mass matrices {articulations, D, D}, padded with 0; D is the largest number of
dofs of an articulation (kg, kg*m, kg*m^2). Mimic joints count as free joints. The mass matrix with
the mimic constraints is T^T M T, where qd = T qd_reduced.

include_armature: whether the armatures are added to the diagonal.)";

inline constexpr char kInverseDynamics[] =
    R"(Returns the generalized forces {dofs} (N, N*m) that give the accelerations qdd {dofs} (m/s^2,
rad/s^2) at state.joint_q and state.joint_qd: H qdd + bias, where the mass matrix H includes the
armature. Drives, limits and body_f are left out. The rates and forces of a FREE joint refer to the
center of mass, in the axes of the joint frame of the parent.)";

inline constexpr char kInverseDerivatives[] =
    R"(Returns the analytic derivatives (dtau_dq, dtau_dqd, H) of eval_inverse_dynamics by q, qd and
qdd, {articulations, D, D} each, padded with 0. D is the largest number of dofs of an articulation.

A derivative by q has one column per dof. The columns of a BALL joint are a small rotation e (rad):
q -> exp(e) q. The columns of a FREE joint are a displacement of the center of mass (m), and a small
rotation about the center of mass (rad).)";

inline constexpr char kForwardDerivatives[] =
    R"(Returns the analytic derivatives (dqdd_dq, dqdd_dqd, dqdd_dtau) of eval_forward_dynamics by
q, qd and tau, {articulations, D, D} each, padded with 0. The columns of q are those of
eval_inverse_dynamics_derivatives.)";

}  // namespace novaphy::python::doc
