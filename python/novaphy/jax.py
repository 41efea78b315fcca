"""Functions of NovaPhy inside of JAX, with their gradients.

    step = novaphy.jax.wrap(lambda q: ..., (3,))   # nova Tensors in, nova Tensors out
    jax.grad(lambda q: step(q).sum())(q)           # JAX arrays in and out

Needs JAX, which NovaPhy does not install.
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
    """The library, which is imported by the first function that needs it."""
    try:
        return importlib.import_module("jax")
    except ImportError as error:
        raise ImportError("novaphy.jax needs JAX: pip install jax", name="jax") from error


def wrap(
    function: Callable[..., Any], result: Sequence[int] | Sequence[Sequence[int]]
) -> Callable[..., Any]:
    """Make a function of JAX arrays, with gradients, of one of nova Tensors.

    Args:
        function: takes nova Tensors, and returns one or several: any step, rollout or loss, made of
            recorded operations. The function must be pure. JAX calls the function at any time, and
            once more on a tape for the backward pass, because JAX keeps arrays and no tapes.
        result: the shape of its result, or a list of shapes.

    Returns:
        A `jax.custom_vjp` of as many float32 arrays, which may stand inside of jit (a
        `jax.pure_callback`), vmap (one call after the other) and grad, once. Arrays are copied on
        the way in, because JAX's may not be written to. A result that depends on no input has the
        gradient 0.

    Raises:
        ImportError: JAX is not installed.
        TypeError: an argument that is not float32. Inside of jit errors arrive as JAX's own.
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
        with nova.Tape() as tape:  # with inputs among the results as copies that it recorded
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
    """Whether these are several shapes."""
    return bool(shape) and not isinstance(shape[0], (int, np.integer))


def _shapes(result: Sequence[Any]) -> list[tuple[int, ...]]:
    """The shapes of all results."""
    return [tuple(shape) for shape in (result if _is_list(result) else [result])]


def _float32(value: Any) -> np.ndarray:
    """A copy on the host."""
    array = np.array(value)
    if array.dtype != np.float32:
        raise TypeError(f"expected a float32 array, got {array.dtype}")
    return array
