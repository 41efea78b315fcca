"""Wireframe boxes that show the inertia of bodies: each box has the body's mass and inertia."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ._scene import f32, rotate

# The 8 corners of a box, and for each of its 12 edges the two corners at its ends.
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_EDGES = np.array([(a, a | b) for b in (1, 2, 4) for a in range(8) if not a & b])


def inertia_boxes(mass: np.ndarray, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return solid boxes of given mass {n} (kg) and inertia {n, 3, 3} (kg m²).

    The first result has half extents {n, 3} (m). The second has axes {n, 3, 3}, as columns in the
    frame of the body. A body without mass gets the half extents 0.
    """
    moments, axes = np.linalg.eigh(inertia.astype(np.float64))
    others = moments.sum(axis=1, keepdims=True) - 2.0 * moments  # mass / 6 * (edge length)²
    heavy = np.where(mass > 0.0, mass, np.inf)[:, None]
    return np.sqrt(1.5 * np.maximum(others, 0.0) / heavy), axes


def inertia_edges(
    arrays: Mapping[str, np.ndarray], body_q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the start and end points {12 n, 3} (m) of the edges of all inertia boxes of a model.

    A box is centered at the center of mass of its body.
    """
    half, axes = inertia_boxes(arrays["body_mass"], arrays["body_inertia"].reshape(-1, 3, 3))
    local = arrays["body_com"][:, None] + np.einsum("nij,ncj->nci", axes, half[:, None] * _CORNERS)
    corners = f32(body_q[:, None, :3] + rotate(body_q[:, None, 3:], f32(local)))
    starts, ends = (corners[:, _EDGES[:, k]].reshape(-1, 3) for k in range(2))
    return starts, ends
