// Docstrings of DiffFeatherstoneSolver and of the planar arm.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDiffFeatherstone[] =
    R"(The differentiable form of SolverFeatherstone, whose steps have the same bits. An active tape
records one operation per step, with the exact adjoint and tangent. A rollout may be captured.

Gradients are exact, except at kinks, where a limit or a clamp is just reached:
state and forces: joint_q (for quaternions the part tangent to the unit sphere), joint_qd, body_f,
joint_f.
drives and limits: targets, target_ke, target_kd, damping, armature; the bounds, ke, kd, effort and
velocity of limits.
bodies: body_mass, body_com, body_inertia (the symmetric part), gravity.

For contacts ("pgs") and joint_friction, the gradient is that of the active constraints, see
gradient_info. The same holds for shape_material_mu, _restitution, _ke and _kd. Joint frames and
axes have no gradient: a step raises an error if they require one.

Models on devices work as in SolverFeatherstone, but step waits for the device.)";

inline constexpr char kDiffFeatherstoneInit[] =
    R"(Makes a solver. For the other options see SolverFeatherstone. The contact solver starts from
impulses of 0 in every step. Sweeps go on until pgs_tolerance is met, at most pgs_iterations times.

pgs_iterations: at least 1000.
allow_unconverged: False: backward and jvp raise novaphy.Error if the contacts of a step have not
converged. The test: the last sweep changed velocities by more than 1 % of the largest impulse,
as a velocity. The error names the step, and the pair of shapes or the joint.
contact_gradient: "code": the derivative of the computed steps. The step in which a contact begins
counts as a constant. "motion": the derivative also moves the time at which a contact begins
(saltation matrix). The gradient of a bounce then agrees with differences of the motion in sign and
size. "auto": "motion" in steps with contacts where it is supported, else "code"; gradient_info
gives the reason. The states are the same.

NotImplementedError: contact="penalty". NotImplementedError: "motion" on a device, in a capture or
with compliant_contacts.)";

inline constexpr char kFeatherstoneInfo[] =
    R"(Returns the GradientInfo of all steps since the last clear_gradient_info.

A step is "exact of the code" if the derivative moves the points and normals of all pushing contacts
with the bodies. This holds for contacts of planes with all shapes, and of spheres, capsules and
boxes with each other, if collide found them from the state of the step. A step is "frozen" if
another contact pushes. The points of such a contact are constant in the body frames, and the normal
is constant in the world frame.

Fields of this solver:
contact_steps: the number of steps with contacts or dry friction.
frozen_contacts: the number of frozen contacts.
unconverged_steps: the number of steps whose gradient raises an error, see allow_unconverged.
breaking, sticking, sliding: the number of contacts in each state.

Margins say how near the steps were to a jump of the gradient. None: no such contact.
normal_margin: m/s; the least normal impulse of a contact, as a velocity, or the least opening
speed.
gap_margin: m; for pushing contacts, the least distance to an overlap of 0 or pgs_slop.
cone_margin: the least distance of a sticking contact from the friction cone, without unit.
slip_margin: m/s; the least slip of a sliding contact.)";

inline constexpr char kPlanarArm[] =
    R"(Records a step of SolverFeatherstone for a planar arm of two links on the active tape, with
the exact adjoint in closed form. Call it after the step. Without a tape the call only checks the
arm.

q, qd: the state before the step {2} (rad, rad/s). q_out, qd_out: the state after the step {2}.

The arm is one articulation of two links, with REVOLUTE joints about +Y and without rotated frames.
The first joint is on the world, and the centers of mass are at the bodies' origins. The arm has no
drives, damping, friction, joint_f or body_f, and gravity is along -Z.

`novaphy.Error`: the arm does not meet a condition; the message names it. `novaphy.Error`: q_out or
qd_out differs from the closed form, because of a clamp or another angular_damping.)";

inline constexpr char kPlanarTipLoss[] =
    R"(Returns |tip - target|^2 {1} (m^2) for the arm of record_planar_2r_featherstone_step at the
joint angles q {2} (rad). target_x, target_z: the target in the plane XZ (m). The tip is twice as
far from the second joint as the center of mass of the second link.)";

}  // namespace novaphy::python::doc
