// Docstrings of Tape, Graph and gradcheck.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kTapeInfo[] =
    R"(Returns the GradientInfo of the steps of all differentiable solvers on this tape, after a
backward: the worst label with its reason, the largest residual, and the sums of the counts.

A solver of articulations on a device, or in a capture, counts all steps since its
clear_gradient_info.

`novaphy.Error`: no such step is on the tape, or no backward has run.)";

inline constexpr char kBackward[] =
    R"(Computes the gradients of `loss`. Gradients of leaves accumulate over calls, all others start anew.

grad: the gradient of `loss`, of its shape. None: 1, for a loss with one value.
record: keep what adjoint_record() returns. The record needs memory for each step.

ValueError: a loss that is not on the tape, or of several values without `grad`.
NotImplementedError: `record` with steps of DiffSolverVBD, of particles, of enable_static_contacts,
of penalty_law "mean", with checkpoints of DiffSemiImplicitSolver, on a device, or inside of a
ScopedCapture.
`novaphy.Error`: `record` without steps of a solver.)";

inline constexpr char kAdjointRecord[] =
    R"(Returns the AdjointRecord of the last backward(loss, record=True): the gradient at each step
boundary, and the impulse of each contact with its adjoint. The changes of impulses are those along
the unit vector against the gradient of this loss by `inputs`. The call runs one jvp, or a jvp for
each pair of penalty contacts.

inputs: leaves of the tape. None: all leaves that have a gradient.

`novaphy.Error`: no backward had a record, or a backward without one has run behind it.
ValueError: an input that is no leaf with a gradient, or given twice.
NotImplementedError: a custom operation that was recorded without a tangent.)";

inline constexpr char kTape[] =
    R"(Records the operations whose inputs carry gradients, and runs their adjoints in reverse.
`with nova.Tape() as tape` makes the tape the active one of the thread.

The tape keeps inputs by reference, with their version. backward raises if an adjoint would read a
value that was overwritten since.

leaf_gradients_only: the tape reuses the memory of every other gradient once it was read. The bits
are the same, with half the memory. Reading such a gradient afterwards raises novaphy.Error.

`novaphy.Error`: another tape is active.)";

inline constexpr char kActiveTape[] =
    R"(Returns the tape that records on this thread, or None. Inside of no_grad nothing is recorded,
so the result is None.)";

inline constexpr char kJvp[] =
    R"(Pushes tangents of leaves forward (forward mode). Returns, for each of `outputs`, its
derivative in the direction of `tangents`, as new tensors.

tangents: one per input, and shaped like it.

`novaphy.Error`: a value that the call reads is not as recorded.
ValueError: an input that is no leaf with a gradient or given twice, an output that is not on the
tape.
NotImplementedError: a custom operation that was recorded without a tangent.)";

inline constexpr char kGraphLaunch[] =
    R"(Runs all operations of the graph.

On a GPU the first launches run kernel by kernel. Meanwhile a kernel that fuses these is compiled in
the background. The compilation takes some seconds if the kernel is not on disk. The bits are the
same before and after. The destruction of the graph, and the exit of Python, wait for the
compilation.

`novaphy.Error`: an index table (the contacts) changed since the capture.)";

inline constexpr char kGradcheck[] =
    R"(Compares the tape's gradient of the one-value fn(*inputs) with central differences of every
input value: |ad - fd| <= atol + rtol * max|fd|. The inputs keep their values, gradients and
requires_grad, also if fn raises.

epsilon: the step, relative to max(1, |x|).
dot_product_tolerance: the bound for the derivative in one random direction, compared with that of
forward mode (Tape.jvp). This comparison has no step, so its only error is rounding.)";

inline constexpr char kRecordCustom[] =
    R"(Records a differentiable operation that is no kernel. Call it after the outputs were
computed.

backward: backward(grad_outputs) gets and returns a list with a Tensor or None for each output and
input.
forward: forward() computes the outputs again, in their memory. Checkpoints need it.)";

}  // namespace novaphy::python::doc
