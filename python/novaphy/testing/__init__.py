"""Assertions for tests of simulations: equal bits, close arrays, gradients.

Arrays may be NumPy arrays, DeviceArrays, Tensors or nested lists. A failed assertion raises
AssertionError with the first difference.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._core import SimState, has_diff

__all__ = ["assert_allclose", "assert_gradcheck", "assert_same_bits", "assert_same_state"]


def assert_same_bits(actual: Any, expected: Any, what: str = "array") -> None:
    """Assert that two arrays have the same shape, dtype and bits.

    NaNs of the same bits are equal. +0 and -0 differ.
    """
    a, b = np.asarray(actual), np.asarray(expected)
    if a.shape != b.shape or a.dtype != b.dtype:
        raise AssertionError(f"{what}: {a.dtype} {a.shape} is not {b.dtype} {b.shape}")
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    unsigned = np.dtype(f"u{a.dtype.itemsize}")
    same = a.view(unsigned) == b.view(unsigned)
    if a.dtype.kind == "f":
        same |= np.isnan(a) & np.isnan(b)
    if not same.all():
        at = tuple(int(k) for k in np.argwhere(~same)[0])
        raise AssertionError(
            f"{what}: {int((~same).sum())} of {same.size} values differ; first at {at}: "
            f"{a[at]!r} is not {b[at]!r}"
        )


def assert_allclose(
    actual: Any, expected: Any, rtol: float = 1e-5, atol: float = 1e-6, what: str = "array"
) -> None:
    """Assert |actual - expected| <= atol + rtol * |expected| for every value; NaN fails."""
    np.testing.assert_allclose(
        np.asarray(actual),
        np.asarray(expected),
        rtol=rtol,
        atol=atol,
        equal_nan=False,
        err_msg=what,
    )


def assert_same_state(actual: SimState, expected: SimState) -> None:
    """Assert that every array of two states has the same bits."""
    for name in dir(SimState):
        value = getattr(actual, name)
        if hasattr(value, "numpy"):
            assert_same_bits(value.numpy(), getattr(expected, name).numpy(), name)


def assert_gradcheck(
    fn: Any, inputs: Any, *, epsilon: float = 1e-3, rtol: float = 2e-2, atol: float = 1e-4
) -> None:
    """Assert that nova.gradcheck(fn, inputs) passes (needs NOVAPHY_WITH_DIFF)."""
    from ..nova import gradcheck

    result = gradcheck(fn, list(inputs), epsilon=epsilon, rtol=rtol, atol=atol)
    if not result.ok:
        raise AssertionError(f"gradcheck: {result.worst}")


if has_diff():
    from .._core.nova import gradcheck as gradcheck

    __all__ += ["gradcheck"]
