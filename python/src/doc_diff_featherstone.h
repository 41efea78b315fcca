// Docstrings of DiffFeatherstoneSolver and of the planar arm.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDiffFeatherstone[] =
    R"(The differentiable SolverFeatherstone, with its bits. An active tape records one operation
per step, with the exact adjoint and tangent. A rollout may be captured.

Exact gradients, where no limit or clamp is just reached:
state and forces: joint_q (of quaternions, tangent to the unit sphere), joint_qd, body_f, joint_f.
drives and limits: targets, target_ke, target_kd, damping, armature; bounds, ke, kd, effort and
velocity of limits.
bodies: body_mass, body_com, body_inertia (its symmetric part), gravity.

Contacts ("pgs") and joint_friction have the gradient of the active rows, see gradient_info;
shape_material_mu, _restitution, _ke and _kd too. Joint frames and axes have no gradient: a gradient
that is wanted there raises.

Models on devices work as in SolverFeatherstone; step waits for the device there.)";

inline constexpr char kDiffFeatherstoneInit[] =
    R"(Options are those of SolverFeatherstone. With contacts, sweeps start from zero impulses and
go on to pgs_tolerance, at most pgs_iterations times (at least 1000).

allow_unconverged: False: backward and jvp raise novaphy.Error if the last sweep of a step changed
velocities by more than 1 % of its largest impulse (as a velocity). The error names the step, and
the pair of shapes or the joint.
contact_gradient: "code": the derivative of the steps as they ran, in which a contact begins in the
same step whatever the state. "motion": the time of its begin moves with the state (saltation
matrix). A bounce then has the sign and length that differences over many steps have. On the CPU,
outside of captures; second derivatives raise. The states are the same.

NotImplementedError: contact="penalty"; "motion" on a device or with compliant_contacts.)";

inline constexpr char kFeatherstoneInfo[] =
    R"(Returns the GradientInfo of all steps since the last clear_gradient_info.

Steps are exact of the code where points and normals of all pushing contacts move as the search
moves them. These are contacts of planes with all shapes, and of spheres, capsules and boxes with
each other, found from the state of the step as it is. Steps are frozen where frozen_contacts other
contacts push: their points stay in the frames of their bodies, their normals in the world.

contact_steps: steps with contacts or dry friction.
unconverged_steps: steps whose gradient raises.
breaking, sticking, sliding: numbers of contacts.

Margins say how far the nearest jump of the gradient is; None without a contact of the kind:
normal_margin: m/s, the least normal impulse as a velocity, or speed of opening.
gap_margin: m, to where an overlap begins or leaves pgs_slop, of pushing contacts.
cone_margin: the least distance of a sticking contact from its cone, without unit.
slip_margin: m/s, the least slip.)";

inline constexpr char kPlanarArm[] =
    R"(Records a step of SolverFeatherstone of a planar arm of two links, with the exact adjoint in
closed form, from q, qd {2} (rad, rad/s) to q_out, qd_out {2}. Call it after the step, on an active
tape. Without a tape the call only checks the arm.

The arm is one articulation of two links on the world, REVOLUTE about +Y, without rotated frames,
with centers of mass at the bodies' origins. The arm has no drives, damping, friction, joint_f or
body_f, and gravity is along -Z.

`novaphy.Error`: the first condition that is not met, or a q_out or qd_out that differs from the
closed form, because of a clamp or another angular_damping.)";

inline constexpr char kPlanarTipLoss[] =
    R"(Returns |tip - target|^2 {1} (m^2), in XZ, of record_planar_2r_featherstone_step's arm at q
{2}. The last center of mass is midway from the joint to the tip.)";

}  // namespace novaphy::python::doc
