// Docstrings of Tape, Graph and gradcheck.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kTapeInfo[] =
    R"(Returns the GradientInfo of the steps of all differentiable solvers on this tape: the worst
label with its reason, the largest residual, and the sums of the counts. Call it after backward.

For a solver of articulations on a device, or in a capture, the counts include all steps since the
last clear_gradient_info of the solver.

`novaphy.Error`: the tape has no step of a differentiable solver, or backward has not run.)";

inline constexpr char kBackward[] =
    R"(Computes the gradients of `loss`. Gradients of leaves accumulate over calls. All other
gradients are computed anew.

grad: the gradient of `loss`, of its shape. None: 1, for a loss with one value.
record: whether to store the data of adjoint_record(). The record needs memory for each step.

ValueError: a loss that is not on the tape, or of several values without `grad`.
NotImplementedError: `record` on a device, inside of a ScopedCapture, with checkpoints of
DiffSemiImplicitSolver or DiffSolverVBD, or with DiffSemiImplicitSolver and particles,
enable_static_contacts or penalty_law "mean".
`novaphy.Error`: `record` without steps of a solver.)";

inline constexpr char kAdjointRecord[] =
    R"(Returns the AdjointRecord of the last backward(loss, record=True): the gradient at each step
boundary, and for each contact its impulse and the derivative of the loss by the impulse.

The record also has the change of each impulse when the inputs move by a unit vector against the
gradient of the loss. For these changes the call runs one jvp, or a jvp for each pair of penalty
contacts. All particles of DiffSolverVBD that touch one shape are one pair.

inputs: leaves of the tape. None: all leaves that have a gradient.

`novaphy.Error`: no backward has made a record, or a later backward ran without record=True.
ValueError: an input is not a leaf with a gradient, or is given twice.
NotImplementedError: a custom operation was recorded without a tangent.)";

inline constexpr char kTape[] =
    R"(Records the operations on tensors that require a gradient, and computes gradients by running
the adjoints of the operations in reverse. In a block `with nova.Tape() as tape`, the tape is the
active tape of the thread.

The tape does not copy inputs. backward raises an error if it needs a value that was overwritten
after the recording.

leaf_gradients_only: True: only gradients of leaves are kept. The memory of other gradients is
reused, which halves the memory for gradients. The bits are the same. Reading such a gradient raises
novaphy.Error.

`novaphy.Error`: another tape is active.)";

inline constexpr char kActiveTape[] =
    R"(Returns the tape that records the operations of this thread; None: no tape records. Inside of
no_grad the result is None.)";

inline constexpr char kJvp[] =
    R"(Returns Jacobian-vector products (forward mode): the derivative of each of `outputs` when the
inputs move along `tangents`, as a list of new tensors with the shapes of the outputs.

outputs: results of operations on this tape.
inputs: leaves of this tape.
tangents: a tensor for each input, with the shape of the input.

`novaphy.Error`: a value that the call needs was overwritten after the recording.
ValueError: an input is not a leaf with a gradient or is given twice, or an output is not on the
tape.
NotImplementedError: a custom operation was recorded without a tangent.)";

inline constexpr char kGraphLaunch[] =
    R"(Runs all operations of the graph.

On a GPU the first launches run kernel by kernel. Meanwhile a single kernel with all operations is
compiled in the background, which takes some seconds unless it is in the cache on disk. The bits are
the same with both. The destruction of the graph, and the exit of Python, wait for the compilation.

`novaphy.Error`: an index table, such as that of the contacts, changed after the capture.)";

inline constexpr char kGradcheck[] =
    R"(Compares the gradient of fn, computed by a tape, with central differences. Returns a
GradcheckResult.

The test for each input value is |ad - fd| <= atol + rtol * max|fd|, with the gradient ad and the
difference quotient fd. After the call, the inputs have the same values, gradients and requires_grad
as before, even if fn raises.

fn: fn(*inputs) returns a Tensor with one value.
epsilon: the step of the differences, relative to max(1, |x|).
dot_product_tolerance: also compares the derivative in one random direction from the gradient with
that of forward mode (Tape.jvp). The relative difference must be below this bound. Differences of
the two are due to rounding only.)";

inline constexpr char kRecordCustom[] =
    R"(Records an operation with a derivative written in Python. Call record_custom after the
outputs were computed.

name: the name of the operation.
inputs, outputs: the tensors that the operation reads and writes.
backward: backward(grad_outputs) gets a list with the gradient of each output (a Tensor or None),
and returns a list with the gradient of each input (a Tensor or None).
forward: forward() computes the outputs again, into the same memory. Checkpoints need forward.)";

}  // namespace novaphy::python::doc
