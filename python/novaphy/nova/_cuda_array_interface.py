"""Tensors that share device memory of other libraries, by ``__cuda_array_interface__``."""

from __future__ import annotations

import math
from typing import Any

from .._core.nova import Tensor, external, float32, int32

_DTYPES = {"<f4": float32, "<i4": int32}
_NAME = "from_cuda_array_interface"


def _is_packed(shape: tuple[int, ...], strides: tuple[int, ...]) -> bool:
    """Return whether an array of four-byte values with these strides (bytes) has no gaps."""
    packed = (4 * math.prod(shape[k + 1 :]) for k in range(len(shape)))
    steps = zip(shape, strides, packed, strict=True)
    return 0 in shape or all(n == 1 or given == wanted for n, given, wanted in steps)


def from_cuda_array_interface(obj: Any, device: Any = "cuda:0") -> Tensor:
    """Return a tensor over device memory of another library, without a copy.

    Use this function for objects without DLPack. For other objects `from_dlpack` is better: it also
    finds the device and waits for any stream. The protocol is Numba's CUDA array interface,
    versions 2 and 3.

    Args:
        obj: an object with ``__cuda_array_interface__``, which the tensor keeps alive. Its values
            are float32 or int32 in row-major order without gaps. Work that writes them must have
            been submitted to the default stream.
        device: the device of the memory, because the protocol does not name the device.

    Returns:
        A tensor with the object's shape. Writing to the tensor writes to the object.

    Raises:
        TypeError: the object has no such interface, or its values have another type.
        ValueError: the values have gaps or a mask, or the object names another stream.
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
