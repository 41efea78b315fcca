"""Sums over blocks of worlds, up a binary tree by block number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float32]
Node = tuple[int, int, Vector]  # level, index, sum of the blocks below


def _sum(a: Vector, b: Vector) -> Vector:
    """Return the sum of two rows. ValueError: a sum of finite numbers is too large for float32."""
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
    """The sums of whole subtrees, joined as soon as both halves are there.

    Node (level, index) is the sum of the blocks index * 2^level to (index + 1) * 2^level - 1. A
    node whose sibling has no blocks goes up as it is. The order of the additions therefore depends
    on the number of blocks alone, and not on who computed them or when.
    """

    def __init__(self, blocks: int) -> None:
        self._blocks = blocks
        self._top = (blocks - 1).bit_length()
        self._nodes: dict[tuple[int, int], Vector] = {}

    def put(self, level: int, index: int, values: Vector) -> None:
        """Add a node; level 0 is a block."""
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
        """Return the sums so far, one for each of the largest subtrees that are complete."""
        return [(level, index, values) for (level, index), values in sorted(self._nodes.items())]

    def total(self) -> Vector:
        """Return the sum of all blocks."""
        return self._nodes[self._top, 0]
