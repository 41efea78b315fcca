"""Meshes of primitives with unit size; the scale of an instance gives the actual size."""

from __future__ import annotations

import numpy as np

from ._scene import Scene

SEGMENTS, RINGS = 24, 12  # subdivisions of a sphere and a capsule
SIDES = 48  # number of sides of a cylinder and a cone
AXIS = np.array([0.0, 0.0, 1.0])


def add_primitive(scene: Scene, name: str) -> None:
    """Add the mesh of a primitive to a scene, unless the scene has it."""
    if name in scene.meshes:
        return
    points, normals, indices, shift = _MAKERS[name]()
    mesh = scene.put_mesh(name, points, indices, normals)
    mesh.shift.set(shift)


def _finish(points, normals, indices, shift=None):
    points = np.asarray(points, np.float32).reshape(-1, 3)
    if shift is None:
        shift = np.zeros((len(points), 1))
    return (
        points,
        np.asarray(normals, np.float32).reshape(-1, 3),
        np.asarray(indices, np.int32).reshape(-1, 3),
        np.asarray(shift, np.float32).reshape(-1, 1),
    )


def _quads(rows: int, columns: int) -> np.ndarray:
    """Return the triangles of a grid of rows x columns points, counter-clockwise from outside."""
    k = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    low = np.stack([k, k + columns + 1, k + columns], axis=-1)
    high = np.stack([k, k + 1, k + columns + 1], axis=-1)
    return np.concatenate([low.reshape(-1, 3), high.reshape(-1, 3)])


def _circle(count: int = SEGMENTS) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def _plane():
    points = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]
    return _finish(points, [(0, 0, 1)] * 4, [(0, 1, 2), (0, 2, 3)])


def _box():
    points, normals, indices = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v, n = np.zeros((3, 3))
            n[axis], u[(axis + 1) % 3], v[(axis + 2) % 3] = sign, sign, 1.0
            first = len(points)
            points += [n - u - v, n + u - v, n + u + v, n - u + v]
            normals += [n] * 4
            indices += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return _finish(points, normals, indices)


def _sphere():
    polar = np.linspace(np.pi, 0.0, RINGS + 1)[:, None]
    around = _circle()[None, :, :] * np.sin(polar)[..., None]
    points = around + np.cos(polar)[..., None] * AXIS
    return _finish(points, points, _quads(RINGS + 1, SEGMENTS + 1))


def _capsule():
    half = RINGS // 2
    polar = np.concatenate([np.linspace(np.pi, np.pi / 2, half), np.linspace(np.pi / 2, 0.0, half)])
    around = _circle()[None, :, :] * np.sin(polar)[:, None, None]
    points = around + np.cos(polar)[:, None, None] * AXIS
    shift = np.repeat(np.repeat([-1.0, 1.0], half), SEGMENTS + 1)
    return _finish(points, points, _quads(2 * half, SEGMENTS + 1), shift)


def _disc(height: float, up: float, first: int):
    rim = _circle(SIDES) + np.array([0.0, 0.0, height])
    points = np.concatenate([[[0.0, 0.0, height]], rim])
    k = first + 1 + np.arange(SIDES)
    a, b = (k, k + 1) if up > 0 else (k + 1, k)
    indices = np.stack([np.full(SIDES, first), a, b], axis=-1)
    return points, np.tile([0.0, 0.0, up], (len(points), 1)), indices


def _cylinder():
    rim = _circle(SIDES)
    side = np.stack([rim - AXIS, rim + AXIS]).reshape(-1, 3)
    top = _disc(1.0, 1.0, len(side))
    bottom = _disc(-1.0, -1.0, len(side) + len(top[0]))
    return _finish(
        np.concatenate([side, top[0], bottom[0]]),
        np.concatenate([np.tile(rim, (2, 1)), top[1], bottom[1]]),
        np.concatenate([_quads(2, SIDES + 1), top[2], bottom[2]]),
    )


def _cone():
    rim = _circle(SIDES)
    side = np.stack([rim - AXIS, 0.0 * rim + AXIS]).reshape(-1, 3)
    slope = np.tile((rim + 0.5 * AXIS) / np.sqrt(1.25), (2, 1))
    bottom = _disc(-1.0, -1.0, len(side))
    return _finish(
        np.concatenate([side, bottom[0]]),
        np.concatenate([slope, bottom[1]]),
        np.concatenate([_quads(2, SIDES + 1), bottom[2]]),
    )


_MAKERS = {
    "plane": _plane,
    "box": _box,
    "sphere": _sphere,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "cone": _cone,
}
