"""The storage of motion in a page: positions on a grid, as differences that compress well.

Float32 values hardly compress. Moving values are therefore stored as integer multiples of a
quantum, which is far below a pixel. Each multiple is predicted from earlier frames or from the row
before. The differences are small, and each of their four bytes is stored in a plane of its own.
"""

from __future__ import annotations

import zlib

import numpy as np

SMALLEST = 256  # numbers; less is stored as it is
LARGEST = 2.0**30  # quanta: beyond, differences might not fit 32 bits
# How a row is foretold: by the row before in the same frame, by the frame before, by two.
BY_ROW, BY_FRAME, BY_MOTION = 0, 1, 2


def quantum(resolution: float) -> float:
    """Return the largest power of two up to a resolution; its multiples are exact in float32."""
    return float(2.0 ** np.floor(np.log2(resolution)))


def pack(frames: np.ndarray, quanta: np.ndarray) -> tuple[int, bytes] | None:
    """Pack frames {n, rows, width} in the smallest of three ways, with a quantum per component.

    Returns the way and 16 bytes for every four numbers; None if the values do not fit the grid.
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
    """Return differences with the sign in the lowest bit, with all lowest bytes first."""
    flat = np.ascontiguousarray(differences, np.int32).ravel()
    zigzag = ((flat << 1) ^ (flat >> 31)).astype("<u4")
    return np.ascontiguousarray(zigzag.view(np.uint8).reshape(-1, 4).T).tobytes()
