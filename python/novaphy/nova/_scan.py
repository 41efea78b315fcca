"""A loop over steps as one operation of a tape, on structures of tensors."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

from .._core.nova import Tensor, _scan


def scan(
    body: Callable[[Any, Any], tuple[Any, Any]],
    carry: Any,
    xs: Any = None,
    length: int | None = None,
) -> tuple[Any, Any]:
    """Run ``carry, y = body(carry, x)`` for each step, and return the last carry and all ys.

    The body is called once, and the engine launches its operations for each step. An active tape
    records one operation for any number of steps. Values and gradients have the bits of the loop
    without a scan. The backward pass computes each step once more, from a copy of its carry.

    Args:
        body: the function of a step. ``x`` is row k of each tensor of ``xs`` in step k, or None.
            ``y`` is a result of the step, or None. The body may read tensors from outside, and must
            not write to them or to its arguments.
        carry: a float32 Tensor, or tuples, lists and dicts of Tensors. The body returns the same
            structure with the same shapes.
        xs: a Tensor {n, ...} of any type, or a structure of Tensors with the same n. Row k of a
            tensor {n, a, b} is {a, b}, and row k of a tensor {n} is {1}.
        length: the number of steps n. None: the leading dimension of ``xs``.

    Returns:
        The carry after the last step, and the ys with the leading dimension n. With n = 0, the
        carry is a copy of the argument.

    Raises:
        TypeError: a value in a structure is not a Tensor, or a carry is not float32.
        novaphy.Error: the body reads values on the host, or uses another tape.
        ValueError: no n >= 0 is given, xs have different lengths, or the body changes the shape or
            the values of its arguments.
        NotImplementedError: a custom operation without a ``forward``, or the rollout of a solver
            that reports on its gradients.

    """
    names, tensors = _flatten(carry, "carry")
    of_y: list[Any] = [None]

    def step(leaves: list[Tensor], rows: list[Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        result = body(_rebuild(carry, iter(leaves)), _rebuild(xs, iter(rows)))
        if not isinstance(result, tuple) or len(result) != 2:
            raise TypeError(f"scan, body: expected (carry, y), got {_kind(result)}")
        of_y[0] = result[1]
        names_after, after = _flatten(result[0], "carry")
        if names_after != names:
            raise ValueError(f"scan, body: expected the carry {names}, got {names_after}")
        for name, is_, was in zip(names, after, tensors, strict=True):
            if is_.shape != was.shape or is_.dtype != was.dtype:
                raise ValueError(
                    f"scan, body, {name}: expected {was.shape} {was.dtype} as before the "
                    f"step, got {is_.shape} {is_.dtype}"
                )
        return after, _flatten(result[1], "y")[1]

    steps = None if length is None else operator.index(length)
    last, ys = _scan(step, tensors, _flatten(xs, "xs")[1], steps)
    return _rebuild(carry, iter(last)), _rebuild(of_y[0], iter(ys))


def _flatten(tree: Any, name: str) -> tuple[list[str], list[Tensor]]:
    """Return the names and the tensors of a structure, in order; TypeError for another value."""
    if tree is None:
        return [], []
    if isinstance(tree, Tensor):
        return [name], [tree]
    if isinstance(tree, Mapping):
        parts = [(f"{name}[{key!r}]", tree[key]) for key in sorted(tree)]
    elif isinstance(tree, (tuple, list)):
        parts = [(f"{name}[{k}]", part) for k, part in enumerate(tree)]
    else:
        raise TypeError(
            f"scan, {name}: expected a Tensor, or a tuple, list or dict of them, got {_kind(tree)}"
        )
    found = [_flatten(part, at) for at, part in parts]
    return [n for names, _ in found for n in names], [t for _, ts in found for t in ts]


def _rebuild(tree: Any, tensors: Any) -> Any:
    """Return the structure with the next tensors in place of its own."""
    if tree is None:
        return None
    if isinstance(tree, Tensor):
        return next(tensors)
    if isinstance(tree, Mapping):
        made = {key: _rebuild(tree[key], tensors) for key in sorted(tree)}
        return {key: made[key] for key in tree}
    parts = [_rebuild(part, tensors) for part in tree]
    if hasattr(tree, "_fields"):  # a named tuple
        return type(tree)(*parts)
    return tuple(parts) if isinstance(tree, tuple) else parts


def _kind(value: Any) -> str:
    return type(value).__name__
