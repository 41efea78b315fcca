"""Boxes with the mass and inertia of bodies, drawn as lines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ._scene import f32, rotate

# The corners of a box, and the pairs of corners that its edges join.
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_EDGES = np.array([(a, a | b) for b in (1, 2, 4) for a in range(8) if not a & b])


def inertia_boxes(mass: np.ndarray, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half extents {n, 3} (m) and axes of boxes with a given mass and inertia {n, 3, 3}.

    The axes {n, 3, 3} are columns in the frame of the body. A body without mass has no extent.
    """
    moments, axes = np.linalg.eigh(inertia.astype(np.float64))
    others = moments.sum(axis=1, keepdims=True) - 2.0 * moments  # m/6 times the length squared
    heavy = np.where(mass > 0.0, mass, np.inf)[:, None]
    return np.sqrt(1.5 * np.maximum(others, 0.0) / heavy), axes


def inertia_edges(
    arrays: Mapping[str, np.ndarray], body_q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends {12 n, 3} of the edges of a model's inertia boxes, around the centers of
    mass.
    """
    half, axes = inertia_boxes(arrays["body_mass"], arrays["body_inertia"].reshape(-1, 3, 3))
    local = arrays["body_com"][:, None] + np.einsum("nij,ncj->nci", axes, half[:, None] * _CORNERS)
    corners = f32(body_q[:, None, :3] + rotate(body_q[:, None, 3:], f32(local)))
    starts, ends = (corners[:, _EDGES[:, k]].reshape(-1, 3) for k in range(2))
    return starts, ends
