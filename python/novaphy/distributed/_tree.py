"""Sums over blocks of worlds, added in a binary tree whose leaves are the blocks in order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float32]
Node = tuple[int, int, Vector]  # (level, index, sum of the blocks in the subtree)


def _sum(a: Vector, b: Vector) -> Vector:
    """Return a + b. ValueError: the sum of finite numbers is too large for float32."""
    with np.errstate(over="ignore"):
        values = a + b
    wrong = np.flatnonzero(~np.isfinite(values) & np.isfinite(a) & np.isfinite(b))
    if len(wrong):
        k = wrong[0]
        raise ValueError(
            "sum_blocks: function: expected numbers whose sum float32 holds, "
            f"got {a[k]!s} + {b[k]!s} at place {k}"
        )
    return values


class BlockSums:
    """The sums of subtrees of blocks, added as soon as both halves of a subtree are known.

    Node (level, index) is the sum of the blocks index * 2^level to (index + 1) * 2^level - 1. A
    node whose sibling has no blocks becomes the parent unchanged. The order of the additions
    depends only on the number of blocks, and not on which process computes a block, or when.
    """

    def __init__(self, blocks: int) -> None:
        self._blocks = blocks
        self._top = (blocks - 1).bit_length()
        self._nodes: dict[tuple[int, int], Vector] = {}

    def put(self, level: int, index: int, values: Vector) -> None:
        """Add the sum of a subtree; level 0 is a single block."""
        while level < self._top:
            sibling = index ^ 1
            if sibling << level < self._blocks:
                other = self._nodes.pop((level, sibling), None)
                if other is None:
                    break
                if other.shape != values.shape:
                    raise ValueError(
                        f"sum_blocks: function: expected rows of one length, got {len(values)} and "
                        f"{len(other)} numbers"
                    )
                values = _sum(values, other) if index < sibling else _sum(other, values)
            level, index = level + 1, index >> 1
        self._nodes[level, index] = values

    def nodes(self) -> list[Node]:
        """Return the sums so far: one node for each largest complete subtree."""
        return [(level, index, values) for (level, index), values in sorted(self._nodes.items())]

    def total(self) -> Vector:
        """Return the sum of all blocks."""
        return self._nodes[self._top, 0]
