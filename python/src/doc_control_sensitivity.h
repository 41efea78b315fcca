// Docstrings of ControlSensitivity.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kSensitivity[] =
    R"(Computes the derivatives of an articulation's coordinates, and of a point on the
articulation, by parameters of its control, along the steps of SolverFeatherstone (forward
sensitivity).

The derivatives are 0 at reset. Each call of step advances them by one step. The parameters may be
anything that the control depends on: key poses, a spline, gains, a network. The caller gives
dcontrol, the derivative of the control by the parameters. If the control also depends on the state,
dcontrol has to include that part, which follows from dq and dqd.

The label says how exact the derivatives are. "exact": all terms are differentiated. "frozen": the
mass matrix, the bias forces with gravity, external wrenches and the rotation of the point's
Jacobian count as constants.

Supported joints are FIXED, PRISMATIC, REVOLUTE, and for kind "torque" a FREE root.
NotImplementedError: other joints.)";

inline constexpr char kSensitivityInit[] =
    R"(Makes the sensitivity of an articulation, with derivatives of 0.

articulation: the index of the articulation.
parameter_count: the number of parameters.
point_body, point_local: a body of the articulation, and a point in the body's frame (m).
kind: "position": dcontrol is the derivative of joint_target_q. "torque": the derivative of joint_f.
exact: True: the label is "exact". False: the label is "frozen". None: True, unless
contact_projection is True.
solver: the SolverFeatherstone of the steps, whose options are used; None: the default options.
contact_projection: True: the derivative of the rates is projected onto the null space of the
normals of pushing contacts, which step gets. Normals, points, friction and the set of pushing
contacts count as constants.

NotImplementedError: contact_projection with exact.
ValueError: contact_projection with a solver without contact "pgs".)";

inline constexpr char kSensitivityStep[] =
    R"(Advances the derivatives over a step of the solver. Call step after the solver's step.

state_in, state_out: the states before and after the solver's step.
control, dt: the control and the length (s) of the solver's step.
dcontrol: {dofs, parameters}, the derivative of joint_target_q (or joint_f) by the parameters.
dtarget_qd: {dofs, parameters}, the derivative of joint_target_qd; None: 0.
contacts: with contact_projection, the contacts of the step, with their rigid_contact_force.

An error leaves the derivatives unchanged:
ValueError: an array has a wrong shape or a value that is not finite, a target changes that no drive
follows, or contacts are given without contact_projection.
NotImplementedError: a contact pushes another articulation too.
IndexError: a contact has a shape that does not exist.
`novaphy.Error`: state_in is not the state in which the last step (or reset) ended.
`novaphy.Error`: state_out differs from the result of the step, because of another solver, control,
dt or contacts.)";

}  // namespace novaphy::python::doc
