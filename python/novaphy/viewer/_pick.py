"""Picking: finds the first shape that a ray hits, by tests of boxes and then of triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ._scene import Instances, Mesh, Scene, f32, rotate


def first_hit(
    scene: Scene, items: Sequence[tuple[Instances, int]], origin: np.ndarray, ray: np.ndarray
) -> tuple[int, int] | None:
    """Return the item and the row of the first instance that a ray hits; None: no hit.

    Args:
        scene: the scene with the meshes of the instances.
        items: pairs (instances, count); the first `count` rows of the instances are tested.
        origin: start of the ray {3} (m).
        ray: direction {3}.
    """
    near: list[tuple[float, int, int, np.ndarray, np.ndarray]] = []
    for k, (item, n) in enumerate(items):
        if not n:
            continue
        lower, upper = scene.meshes[item.mesh].box()
        scales = item.scales.values[:n]
        shift = np.zeros((n, 3), np.float32)
        shift[:, 2] = scales[:, 3]
        lower, upper = lower * scales[:, :3] - shift, upper * scales[:, :3] + shift
        world = item.world()[:n]
        inverse = world[:, 3:] * f32([-1, -1, -1, 1])
        start = rotate(inverse, f32(origin) - world[:, :3])
        along = rotate(inverse, np.broadcast_to(f32(ray), (n, 3)))
        along = np.where(np.abs(along) < 1e-12, 1e-12, along)
        a, b = (lower - start) / along, (upper - start) / along
        first, last = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        for hit in np.flatnonzero((first <= last) & (last >= 0.0)):
            near.append((float(first[hit]), k, int(hit), start[hit], along[hit]))
    best, found = np.inf, None
    for entry, k, row, start, along in sorted(near, key=lambda each: each[:3]):
        if entry > best:
            break
        item = items[k][0]
        way = _way(scene.meshes[item.mesh], item.scales.values[row], start, along)
        if way < best:
            best, found = way, (k, row)
    return found


def _way(mesh: Mesh, scale: np.ndarray, start: np.ndarray, along: np.ndarray) -> float:
    """Return the ray parameter of the first triangle of a mesh that is hit; infinity: no hit."""
    points = mesh.points.values * scale[:3]
    points[:, 2] += mesh.shift.values[:, 0] * scale[3]
    a, b, c = (points[mesh.indices.values[:, k]].astype(np.float64) for k in range(3))
    u, v = b - a, c - a
    across = np.cross(along, v)
    volume = (u * across).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (start - a) / volume[:, None]
        s = (away * across).sum(axis=1)
        turned = np.cross(away, u)
        t = turned @ along
        way = (turned * v).sum(axis=1)
    hit = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (way >= 0.0)
    return float(way[hit].min(initial=np.inf))
