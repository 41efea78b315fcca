// Docstrings of GradientInfo.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kGradientInfo[] =
    R"(Reports how exact a solver's gradients are. Each field is an attribute and a key.

label: the worst label of the steps:
  "exact of the motion": the times of events move with the state too (contact_gradient="motion").
  "exact of the code": the derivative of what each step computes, with the contacts that it has.
  "implicit": the derivative of the solutions of the steps (DiffSolverVBD).
  "frozen": contacts push whose points or normals are frozen.
  "surrogate": the contact solve missed its law by more than 1e-3 of the largest impulse, or a law
  jumps.

With contact_gradient="motion" a gradient is a "surrogate" too if times of events move, but the
gradient may differ from that of the motion.

reason: the cause of the label and its consequence, with step and pair.
steps: exact_steps + frozen_steps + surrogate_steps. exact_steps includes implicit steps.
events: began + ended + turned, between two consecutive steps: contacts that began or ended to push,
or changed between sticking and slipping.
residual: the largest of the steps, relative to the impulses.

A gradient that is exact of the code does not move events in time. With events it may differ from
the gradient of the motion, also in sign. Solvers add fields of their own.)";

}  // namespace novaphy::python::doc
