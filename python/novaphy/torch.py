"""NovaPhy functions in PyTorch programs, with their gradients.

    step = novaphy.torch.wrap(lambda q, qd: ...)   # nova Tensors in, nova Tensors out
    loss = step(q, qd).sum()                       # torch tensors in and out
    loss.backward()

The module needs PyTorch, which NovaPhy does not install.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from ._require import require_diff

require_diff("novaphy.torch")

from . import nova  # noqa: E402

__all__ = ["wrap"]


def _torch() -> Any:
    """Return the module torch, imported at the first use."""
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        raise ImportError("novaphy.torch needs PyTorch: pip install torch", name="torch") from error


class _Call:
    """The inputs, results and tape of a call, for its backward pass."""

    def __init__(self, inputs: list[nova.Tensor]) -> None:
        self.inputs = inputs
        self.outputs: list[nova.Tensor] = []
        self.tape: nova.Tape | None = None
        self.single = True


def _results(result: Any, *, on_tape: bool) -> list[nova.Tensor]:
    """Return the results of a function as a list. On a tape, results that are inputs are copied."""
    made = [result] if isinstance(result, nova.Tensor) else list(result)
    for k, tensor in enumerate(made):
        if not isinstance(tensor, nova.Tensor):
            raise TypeError(f"function, result {k}: expected a nova.Tensor, got {type(tensor)}")
    return [t.clone() if on_tape and t.is_leaf else t for t in made]


def _forward(ctx: Any, function: Callable[..., Any], call: list[_Call], *values: Any) -> Any:
    """Run a function of nova Tensors, on a tape if a gradient is needed."""
    torch = _torch()
    inputs = [nova.from_dlpack(value.detach().contiguous()) for value in values]
    made = _Call(inputs)
    wanted = ctx.needs_input_grad[2:]
    if any(wanted):
        for tensor, needs in zip(inputs, wanted, strict=True):
            tensor.requires_grad = needs
        made.tape = nova.Tape()
        with made.tape:
            result = function(*inputs)
            made.outputs = _results(result, on_tape=True)
    else:
        with nova.no_grad():
            result = function(*inputs)
            made.outputs = _results(result, on_tape=False)
    made.single = isinstance(result, nova.Tensor)
    ctx.save_for_backward(*values)
    ctx.call = made
    call.append(made)
    ctx.set_materialize_grads(False)
    return tuple(torch.from_dlpack(output) for output in made.outputs)


def _backward(ctx: Any, *gradients: Any) -> Any:
    """Compute the gradients of the inputs by the tape of the forward pass."""
    torch = _torch()
    if torch.is_grad_enabled():  # create_graph=True: torch would treat the gradient as a constant
        raise NotImplementedError("novaphy.torch: expected one derivative, got create_graph=True")
    made, wanted = ctx.call, ctx.needs_input_grad[2:]
    _ = ctx.saved_tensors  # raises if an input was written to after the forward pass
    for tensor, needs in zip(made.inputs, wanted, strict=True):
        if needs:
            tensor.zero_grad()
    for output, gradient in zip(made.outputs, gradients, strict=True):
        if gradient is not None and made.tape.follows(output):
            made.tape.backward(output, nova.from_dlpack(gradient.detach().contiguous()))
    # The gradients are copied, because the next backward pass of this call reuses their memory.
    found = (
        torch.from_dlpack(tensor.grad).clone() if needs and tensor.grad is not None else None
        for tensor, needs in zip(made.inputs, wanted, strict=True)
    )
    return None, None, *found


_classes: list[Any] = []  # the one torch.autograd.Function class, created at the first use


def _recorded() -> Any:
    """Return the autograd class with the forward and backward pass above."""
    if not _classes:
        passes = {"forward": staticmethod(_forward), "backward": staticmethod(_backward)}
        _classes.append(type("Recorded", (_torch().autograd.Function,), passes))
    return _classes[0]


def wrap(function: Callable[..., Any]) -> Callable[..., Any]:
    """Convert a function of nova Tensors to a function of torch tensors with gradients.

    Args:
        function: takes nova Tensors and returns one Tensor or several. Any step, rollout or loss
            of recorded operations is possible. Every call runs the function on a new tape. The
            objects behind the results (a Trajectory, states) must not change before the backward
            pass, so create them inside of the function. Values other than the arguments are
            constants.

    Returns:
        A function with the same number of arguments, as float32 torch tensors on one device. The
        function returns a torch tensor, or a tuple of torch tensors.

        Inputs and results share memory with the nova Tensors, without a copy. Two kinds of inputs
        are copied: inputs that are not contiguous, and inputs that the function returns as results
        if a gradient is needed.

        The tape computes the gradients, so its labels (exact, surrogate, frozen) hold. The gradient
        of a result that depends on no input is 0. Only first derivatives are supported:
        create_graph=True raises NotImplementedError. A backward pass raises an error if an input,
        or other memory that the tape needs, was overwritten.

    Raises:
        ImportError: PyTorch is not installed.
        TypeError: an argument is not a float32 torch tensor.
        novaphy.Error, ValueError: errors of the function or the tape.
    """

    torch, recorded = _torch(), _recorded()

    def call(*values: Any) -> Any:
        for k, value in enumerate(values):
            if not isinstance(value, torch.Tensor):
                raise TypeError(f"argument {k}: expected a torch tensor, got {type(value)}")
            if value.dtype != torch.float32:
                raise TypeError(f"argument {k}: expected torch.float32, got {value.dtype}")
        made: list[_Call] = []
        results = recorded.apply(function, made, *values)
        return results[0] if made[0].single else results

    return call
