// Docstrings of ControlSensitivity.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kSensitivity[] =
    R"(Computes how an articulation of SolverFeatherstone, and a point of it, change with parameters
of the control.

The derivative is 0 at reset. Each step carries it through the mass matrix, the implicit response of
drives and the point's Jacobian. The parameters may be anything: key poses, a spline, gains, a
network. The parameters enter by dcontrol, the change of the control with them. If the control
depends on the state, add that part to dcontrol by dq and dqd.

gradient: "exact", or "frozen": mass matrix, bias (with the stiffness of gravity), wrenches and the
turning of the point's Jacobian are not differentiated.

Joints are FIXED, PRISMATIC, REVOLUTE, and for kind "torque" a FREE root. NotImplementedError: other
joints.)";

inline constexpr char kSensitivityInit[] =
    R"(Starts with a derivative of 0.

articulation: the index of the articulation.
parameter_count: the number of parameters.
point_body, point_local: a body of the articulation, and a point in its frame (m).
kind: "position": dcontrol is the change of joint_target_q. "torque": of joint_f.
exact: True by default, and False ("frozen") with contact_projection.
solver: the solver that steps, whose options count; None: the default options.
contact_projection: changes of rates keep to the null space of the normals of the contacts that
push, which step takes. Normals, points, friction and the set of pushing contacts are frozen.

NotImplementedError: contact_projection with exact.
ValueError: contact_projection with a solver without contact "pgs".)";

inline constexpr char kSensitivityStep[] =
    R"(Carries the derivative over the solver's step from state_in to state_out, with the step's
control and dt (s). Call it after the step.

dcontrol: {dofs, parameters}, the change of joint_target_q (or joint_f) per unit of each parameter.
dtarget_qd: likewise of joint_target_qd.
contacts: with contact_projection, those of the step, with the rigid_contact_force that it wrote.

Nothing has changed after an error:
ValueError: another shape, numbers that are not finite, a change of a target that no drive follows,
contacts without contact_projection.
NotImplementedError: a contact that pushes another articulation too.
IndexError: contacts of shapes that do not exist.
`novaphy.Error`: a state_in in which the last step did not end.
`novaphy.Error`: a state_out that this step does not give: another solver, control, dt or contacts.)";

}  // namespace novaphy::python::doc
