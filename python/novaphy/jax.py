"""NovaPhy functions in JAX programs, with their gradients.

    step = novaphy.jax.wrap(lambda q: ..., (3,))   # nova Tensors in, nova Tensors out
    jax.grad(lambda q: step(q).sum())(q)           # JAX arrays in and out

The module needs JAX, which NovaPhy does not install.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ._require import require_diff

require_diff("novaphy.jax")

from . import nova  # noqa: E402

__all__ = ["wrap"]


def _jax() -> Any:
    """Return the module jax, imported at the first use."""
    try:
        return importlib.import_module("jax")
    except ImportError as error:
        raise ImportError("novaphy.jax needs JAX: pip install jax", name="jax") from error


def wrap(
    function: Callable[..., Any], result: Sequence[int] | Sequence[Sequence[int]]
) -> Callable[..., Any]:
    """Convert a function of nova Tensors to a function of JAX arrays with gradients.

    Args:
        function: takes nova Tensors and returns one Tensor or several, by any recorded operations.
            The function must be pure, because JAX may call it at any time. The backward pass calls
            the function again, on a tape, because JAX cannot store a tape.
        result: the shape of the result, or a list with the shape of each result.

    Returns:
        A `jax.custom_vjp` with the same number of arguments and results, as float32 JAX arrays.
        The function works in jit (as a `jax.pure_callback`), in vmap (one call after the other) and
        in grad. Only first derivatives are supported. Input arrays are copied, because JAX arrays
        are read-only. The gradient of a result that depends on no input is 0.

    Raises:
        ImportError: JAX is not installed.
        TypeError, ValueError: an argument is not float32, or a result has a wrong shape.
    """
    jax = _jax()
    shapes = _shapes(result)
    kinds = tuple(jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes)
    single = not _is_list(result)

    def outputs(values: Any) -> list[nova.Tensor]:
        made = function(*values)
        made = [made] if isinstance(made, nova.Tensor) else list(made)
        if [tensor.shape for tensor in made] != shapes:
            found = [tensor.shape for tensor in made]
            raise ValueError(f"function: expected results of shape {shapes}, got {found}")
        return made

    def run(*values: Any) -> tuple[np.ndarray, ...]:
        with nova.no_grad():
            made = outputs([nova.tensor(_float32(value)) for value in values])
        return tuple(tensor.numpy() for tensor in made)

    def pull(values: Any, gradients: Any) -> tuple[np.ndarray, ...]:
        inputs = [nova.tensor(_float32(value), requires_grad=True) for value in values]
        with nova.Tape() as tape:  # clone() records a result that is also an input
            made = [tensor.clone() if tensor.is_leaf else tensor for tensor in outputs(inputs)]
        for tensor, gradient in zip(made, gradients, strict=True):
            if tape.follows(tensor) and np.any(gradient):
                tape.backward(tensor, nova.tensor(_float32(gradient)))
        return tuple(
            np.zeros(tensor.shape, np.float32) if tensor.grad is None else tensor.grad.numpy()
            for tensor in inputs
        )

    @jax.custom_vjp
    def call(*values: Any) -> Any:
        made = jax.pure_callback(run, kinds, *values, vmap_method="sequential")
        return made[0] if single else made

    def forward(*values: Any) -> Any:
        return call(*values), values

    def backward(values: Any, gradients: Any) -> Any:
        like = tuple(jax.ShapeDtypeStruct(value.shape, np.float32) for value in values)
        each = (gradients,) if single else tuple(gradients)
        return jax.pure_callback(pull, like, values, each, vmap_method="sequential")

    call.defvjp(forward, backward)
    return call


def _is_list(shape: Sequence[Any]) -> bool:
    """Return whether the argument is a list of shapes."""
    return bool(shape) and not isinstance(shape[0], (int, np.integer))


def _shapes(result: Sequence[Any]) -> list[tuple[int, ...]]:
    """Return the shapes of all results."""
    return [tuple(shape) for shape in (result if _is_list(result) else [result])]


def _float32(value: Any) -> np.ndarray:
    """Return a copy of a JAX array on the host. TypeError: the array is not float32."""
    array = np.array(value)
    if array.dtype != np.float32:
        raise TypeError(f"expected a float32 array, got {array.dtype}")
    return array
