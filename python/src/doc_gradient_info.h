// Docstrings of GradientInfo.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kGradientInfo[] =
    R"(Reports how exact a solver's gradients are. Each field is an attribute and a key.

label: the worst of the labels of all steps, from best to worst:

  "exact of the motion": the derivative also moves the times of events (see contact_gradient).
  "exact of the code": the derivative of the computed steps, with the contacts that each step has.
  "implicit": the derivative of the solutions of the steps (DiffSolverVBD).

  "frozen": the derivative keeps points or normals of pushing contacts constant.
  "surrogate": the contact solver missed the contact law by more than 1e-4 of the largest impulse,
or
  a contact law has a jump. Or the times of events move, but the gradient may differ from that of
  the motion.

reason: a sentence with the cause of the label and its consequence, with step and pair.
steps: the number of steps: exact_steps + frozen_steps + surrogate_steps.
events: the number of events: began + ended + turned. An event is a change from one step to the
next: a contact begins or ceases to push, or changes between sticking and slipping.
residual: the largest residual of a step, relative to the largest impulse (1).

A gradient that is "exact of the code" does not move events in time. With events it may differ from
the gradient of the motion, even in sign. A joint that meets its limit and a rope or a DISTANCE joint
that becomes taut have the same effect, but are no events here. Solvers add further fields.)";

}  // namespace novaphy::python::doc
