// Docstrings of the optimizers.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kClipNorm[] =
    R"(Scales the gradients in place by min(1, max_norm / (norm + 1e-6)), as PyTorch does. norm is
the Euclidean norm over all values of all gradients. Returns the norm before scaling, {1}.

The sum has a fixed order, so the bits are the same for any number of threads. If the norm is not
finite, because a gradient is not finite or a square overflows, all gradients are set to zero.

params: a Tensor or a list of Tensors.
max_norm: > 0; infinity measures the norm without scaling.

ValueError: a parameter has no gradient or is given twice, there are no parameters, or max_norm is
<= 0 or NaN.
TypeError: a parameter is not float32.)";

inline constexpr char kOptimizerStep[] =
    R"(Updates all parameters in place by one step. A tape does not record the step. The step may be
captured: each launch of the graph is then a step, with the learning rate of the capture.

If a gradient is not finite, a step on the CPU raises an error. On a device, and in a launch of a
graph, the step changes nothing and sets a flag, and check() raises the error. The next step or
launch on the CPU, and reads of the optimizer's state, raise the error too.

ValueError: a parameter has no gradient. Nothing is changed.
`novaphy.Error`: a gradient is not finite. Nothing is changed.)";

inline constexpr char kClippedSgd[] =
    R"(Updates each row p of param {n, 3} by a clipped gradient step, in place.

The row's gradient g is first shortened to max_gradient_norm. The step is p -= learning_rate * g,
and the result is shortened to max_parameter_norm. A norm <= 0 switches the clipping off. A row
whose gradient is not finite is not changed.)";

}  // namespace novaphy::python::doc
