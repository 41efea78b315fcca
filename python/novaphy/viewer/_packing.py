"""Compression of motion for ViewerHTML: values are rounded to a grid, and predicted.

Float32 values hardly compress. Therefore moving values are stored as integer multiples of a
quantum, which is far below a pixel. Each integer is predicted from earlier frames or from the row
before, and only the difference is stored. The differences are small: first come the lowest bytes of
all differences, then the second bytes, and so on.
"""

from __future__ import annotations

import zlib

import numpy as np

SMALLEST = 256  # values; a smaller array is stored unpacked
LARGEST = 2.0**30  # quanta: differences of larger integers might not fit in 32 bits
# How a value is predicted: by the row before, by the frame before, or by the two frames before.
BY_ROW, BY_FRAME, BY_MOTION = 0, 1, 2


def quantum(resolution: float) -> float:
    """Return the largest power of two that is not above a resolution. Multiples of it are exact."""
    return float(2.0 ** np.floor(np.log2(resolution)))


def pack(frames: np.ndarray, quanta: np.ndarray) -> tuple[int, bytes] | None:
    """Pack frames {n, rows, width} by the predictor that compresses best.

    quanta: {width}, the quantum of each component.

    Returns the predictor (BY_ROW, BY_FRAME or BY_MOTION) and four bytes per value. None: an array
    is small, a value is not finite, or a value is too large for the grid.
    """
    if not np.isfinite(frames).all() or frames.size < SMALLEST:
        return None
    grid = np.rint(frames / quanta)
    if np.abs(grid).max() > LARGEST:
        return None
    numbers = grid.astype(np.int32)
    by_frame = np.diff(numbers, axis=0, prepend=np.zeros_like(numbers[:1]))
    ways = [np.diff(numbers, axis=1, prepend=np.zeros_like(numbers[:, :1])), by_frame]
    if len(frames) > 2:
        ways.append(np.diff(by_frame, axis=0, prepend=np.zeros_like(numbers[:1])))
    coded = [_planes(way) for way in ways]
    sizes = [len(zlib.compress(data, 1)) for data in coded]
    best = int(np.argmin(sizes))
    return best, coded[best]


def _planes(differences: np.ndarray) -> bytes:
    """Return zigzag-coded differences (sign in the lowest bit), all lowest bytes first."""
    flat = np.ascontiguousarray(differences, np.int32).ravel()
    zigzag = ((flat << 1) ^ (flat >> 31)).astype("<u4")
    return np.ascontiguousarray(zigzag.view(np.uint8).reshape(-1, 4).T).tobytes()
