// Docstrings of the optimizers.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kClipNorm[] =
    R"(Scales the gradients in place by min(1, max_norm / (norm + 1e-6)), as PyTorch does. norm is
the Euclidean norm over all values of all gradients. Returns the norm before, {1}.

The sum has a fixed order: the same bits for any number of threads. A norm that is not finite (a
gradient is not, or a square overflows) sets all gradients to zero.

ValueError: a parameter without gradient or given twice, no parameters, max_norm <= 0 or NaN
(infinity only measures).
TypeError: not float32.)";

inline constexpr char kOptimizerStep[] =
    R"(Takes one step of all parameters, in place and without a record on a tape. The step may be
captured: each launch of the graph is a step, with the learning rate of the capture.

On a device, and in a launch of a graph, the step notes a gradient that is not finite and writes
nothing. check() then raises. The next step or launch on the CPU, and reads of the state, raise too.

ValueError: a parameter has no gradient. Nothing was written.
`novaphy.Error`: a gradient is not finite. Nothing was written.)";

inline constexpr char kClippedSgd[] =
    R"(Takes a clipped gradient step for each row of param {n, 3}. A norm <= 0 switches its clip
off.

A row with a gradient that is not finite stays. A longer gradient is scaled to max_gradient_norm.
Then p -= learning_rate * g, and a longer result is scaled to max_parameter_norm.)";

}  // namespace novaphy::python::doc
