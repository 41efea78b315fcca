"""Tensors over memory that another library describes with ``__cuda_array_interface__``."""

from __future__ import annotations

import math
from typing import Any

from .._core.nova import Tensor, external, float32, int32

_DTYPES = {"<f4": float32, "<i4": int32}
_NAME = "from_cuda_array_interface"


def _is_packed(shape: tuple[int, ...], strides: tuple[int, ...]) -> bool:
    """Whether rows of four-byte values lie one after the other."""
    packed = (4 * math.prod(shape[k + 1 :]) for k in range(len(shape)))
    steps = zip(shape, strides, packed, strict=True)
    return 0 in shape or all(n == 1 or given == wanted for n, given, wanted in steps)


def from_cuda_array_interface(obj: Any, device: Any = "cuda:0") -> Tensor:
    """Look at device memory of another library, without a copy.

    For objects that have no DLPack; where there is both, `from_dlpack` also tells the device and
    waits for any stream. Protocol: Numba's CUDA array interface, versions 2 and 3.

    Args:
        obj: an object with ``__cuda_array_interface__``; kept alive with the tensor. Its values are
            float32 or int32, in packed rows, complete in the order of the default stream.
        device: where the memory is, which the protocol does not say.

    Returns:
        A tensor of the object's shape. Writing to it writes to the object.

    Raises:
        TypeError: there is no such interface, or the values have another type.
        ValueError: the rows are not packed, values are masked, or a stream other than the default
            one is still to be waited for.
        BufferError: the memory is read-only.
    """
    interface = getattr(obj, "__cuda_array_interface__", None)
    if not isinstance(interface, dict):
        raise TypeError(
            f"{_NAME}: expected an object with __cuda_array_interface__, got {type(obj).__name__}"
        )
    version = interface.get("version", 0)
    if version < 2:
        raise ValueError(f"{_NAME}: expected version 2 or 3 of the interface, got {version}")
    dtype = _DTYPES.get(interface["typestr"])
    if dtype is None:
        raise TypeError(f"{_NAME}: expected float32 or int32, got {interface['typestr']}")
    if interface.get("mask") is not None:
        raise ValueError(f"{_NAME}: expected no mask; pass a copy of the values")
    shape = tuple(interface["shape"])
    strides = interface.get("strides")
    if strides is not None and not _is_packed(shape, strides):
        raise ValueError(
            f"{_NAME}: expected packed rows, got strides {tuple(strides)} for shape {shape}; "
            "pass a contiguous copy"
        )
    stream = interface.get("stream")
    if stream not in (None, 1):
        raise ValueError(
            f"{_NAME}: expected values of the default stream (None or 1), got stream {stream}; "
            "pass an object with DLPack to from_dlpack, which waits for any stream"
        )
    pointer, read_only = interface["data"]
    if read_only:
        raise BufferError(f"{_NAME}: the memory is read-only; pass a copy")
    return external(pointer or 0, shape, dtype, device, obj)
