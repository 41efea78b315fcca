"""The scene of a viewer: named objects that stay until they are replaced or removed.

This module depends neither on physics nor on a graphics library. Every array of an object has a
revision, so that a viewer uploads, sends or writes only what has changed.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

IDENTITY = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)
GRAY = (0.62, 0.64, 0.67)
CHECKER = 0.12  # contrast of a checker: how much darker every other square is (0 to 1)


def f32(values: Any) -> np.ndarray:
    """Return the values as a float32 array."""
    return np.array(values, np.float32)


def as_array(value: Any, width: int, name: str, dtype: Any = np.float32) -> np.ndarray:
    """Return a DeviceArray, Tensor, array or sequence as rows {n, width}.

    ValueError: the shape does not fit; the message has `name`.
    """
    numbers = value.numpy() if hasattr(value, "numpy") else np.asarray(value)
    rows = np.ascontiguousarray(numbers, dtype)
    if rows.size == 0:
        return np.zeros((0, width), dtype)
    if rows.ndim == 1 and rows.size % width == 0:
        rows = rows.reshape(-1, width)
    if rows.ndim != 2 or rows.shape[1] != width:
        raise ValueError(f"{name}: expected rows of {width}, got the shape {np.shape(numbers)}")
    return rows


def per_row(value: Any, rows: int, width: int, default: Any, name: str) -> np.ndarray:
    """Return a value {width} for all rows, or values {rows, width}, as {rows, width}."""
    if value is None:
        value = default
    numbers = np.atleast_1d(value.numpy() if hasattr(value, "numpy") else np.asarray(value))
    numbers = numbers.astype(np.float32)
    if width == 1 and numbers.ndim == 1 and numbers.size == rows:
        numbers = numbers[:, None]
    if numbers.shape[-1] != width or numbers.size not in (width, rows * width):
        raise ValueError(
            f"{name}: expected {width} numbers or the shape ({rows}, {width}), "
            f"got the shape {numbers.shape}"
        )
    return np.ascontiguousarray(np.broadcast_to(numbers.reshape(-1, width), (rows, width)))


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotate vectors {..., 3} by quaternions {..., 4}, xyzw."""
    t = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * t + np.cross(q[..., :3], t)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the transforms a b {n, 7}: a point is transformed by b first, then by a."""
    ax, ay, az, aw = a[:, 3], a[:, 4], a[:, 5], a[:, 6]
    bx, by, bz, bw = b[:, 3], b[:, 4], b[:, 5], b[:, 6]
    out = np.empty((len(a), 7), np.float32)
    out[:, :3] = a[:, :3] + rotate(a[:, 3:], b[:, :3])
    out[:, 3] = aw * bx + bw * ax + ay * bz - by * az
    out[:, 4] = aw * by + bw * ay + az * bx - bz * ax
    out[:, 5] = aw * bz + bw * az + ax * by - bx * ay
    out[:, 6] = aw * bw - ax * bx - ay * by - az * bz
    return out


def turns_of_z(axis: np.ndarray) -> np.ndarray:
    """Return quaternions {n, 4} that rotate z to unit vectors {n, 3}."""
    q = np.concatenate([-axis[:, 1:2], axis[:, :1], 0.0 * axis[:, :1], 1.0 + axis[:, 2:]], axis=1)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    down = length[:, 0] < 1e-6
    q[down] = (1.0, 0.0, 0.0, 0.0)
    length[down] = 1.0
    return q / length


def smooth_normals(points: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return vertex normals {n, 3}: the mean normal of a vertex's triangles, weighted by area."""
    a, b, c = (points[indices[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    corners = indices.ravel()
    normals = np.empty((len(points), 3), np.float32)
    for axis in range(3):
        weights = np.repeat(faces[:, axis], 3)
        normals[:, axis] = np.bincount(corners, weights, len(points))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)


_REVISIONS = itertools.count(1)


class Part:
    """An array with a revision number, which changes with every change of the content."""

    def __init__(self, values: np.ndarray) -> None:
        """Set the first values."""
        self.values = values
        self.revision = next(_REVISIONS)

    def set(self, values: np.ndarray) -> None:
        """Set new values and a new revision, unless the values are equal."""
        same = values.shape == self.values.shape and np.array_equal(values, self.values)
        if not same:
            self.values = values
            self.touch()

    def touch(self) -> None:
        """Set a new revision after the values were written in place."""
        self.revision = next(_REVISIONS)


class Mesh:
    """A triangle mesh, whose vertices an instance can shift along local z.

    A vertex moves by its `shift` times the fourth scale of the instance. The halves of the capsule
    mesh have the shifts +1 and -1, so one mesh draws capsules of all proportions.
    """

    fields = ("points", "normals", "shift", "indices")

    def __init__(self, points: np.ndarray, indices: np.ndarray) -> None:
        """Make a mesh from points {n, 3} and indices {m, 3}."""
        self.points = Part(points)
        self.indices = Part(indices)
        self.shift = Part(np.zeros((len(points), 1), np.float32))
        self.normals = Part(np.zeros((0, 3), np.float32))

    def update(self, points: np.ndarray, indices: np.ndarray, normals: np.ndarray | None) -> None:
        """Set new points {n, 3} and triangles {m, 3}. None: compute smooth normals."""
        if len(points) != len(self.shift.values):
            self.shift.set(np.zeros((len(points), 1), np.float32))
        before = self.points.revision, self.indices.revision
        self.points.set(points)
        self.indices.set(indices)
        if normals is not None:
            self.normals.set(normals)
        elif before != (self.points.revision, self.indices.revision) or not len(
            self.normals.values
        ):
            self.normals.set(smooth_normals(points, indices))

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper corner of the points."""
        points = self.points.values
        return points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)


class Instances:
    """Copies of a mesh that are fixed to bodies.

    Each copy has the pose {7} of its body, a local pose {7} in the frame of the body, a scale and
    a color {4}. A color is red, green, blue and the contrast of a checker pattern on the surface
    (0: none).
    """

    fields = ("poses", "local", "scales", "colors")

    def __init__(self, mesh: str, count: int) -> None:
        """Make `count` gray copies at the origin."""
        self.mesh = mesh
        self.hidden = False
        self.culled = True
        self.poses = Part(np.tile(IDENTITY, (count, 1)))
        self.local = Part(np.tile(IDENTITY, (count, 1)))
        self.scales = Part(np.tile(f32([1, 1, 1, 0]), (count, 1)))
        self.colors = Part(np.tile(f32([*GRAY, 0]), (count, 1)))

    @property
    def count(self) -> int:
        """The number of copies."""
        return len(self.poses.values)

    def world(self) -> np.ndarray:
        """Return the poses {n, 7} in the world."""
        return compose(self.poses.values, self.local.values)


class Lines:
    """Segments from {n, 3} to {n, 3} with colors {n, 3} and a common width (m)."""

    fields = ("starts", "ends", "colors")

    def __init__(self) -> None:
        """Start without a segment."""
        empty = np.zeros((0, 3), np.float32)
        self.starts, self.ends, self.colors = Part(empty), Part(empty), Part(empty)
        self.width = 0.01
        self.hidden = False

    @property
    def count(self) -> int:
        """The number of segments."""
        return len(self.starts.values)


class Scene:
    """All objects by name, scalars and their curves, images, and the time."""

    def __init__(self) -> None:
        """Start with an empty scene, z up."""
        self.meshes: dict[str, Mesh] = {}
        self.instances: dict[str, Instances] = {}
        self.lines: dict[str, Lines] = {}
        self.scalars: dict[str, list[float]] = {}
        self.curves: dict[str, np.ndarray] = {}
        self.images: dict[str, np.ndarray] = {}
        self.time = 0.0
        self.up_axis = 2

    def put_mesh(
        self, name: str, points: np.ndarray, indices: np.ndarray, normals: np.ndarray | None = None
    ) -> Mesh:
        """Add or replace a mesh. ValueError: an index is out of range."""
        if indices.size and (indices.min() < 0 or indices.max() >= len(points)):
            raise ValueError(f"log_mesh, indices: expected numbers of {len(points)} points")
        mesh = self.meshes.get(name)
        if mesh is None:
            mesh = self.meshes[name] = Mesh(points, indices)
        mesh.update(points, indices, normals)
        return mesh

    def put_instances(
        self,
        name: str,
        mesh: str,
        poses: np.ndarray,
        scales: np.ndarray | None = None,
        colors: np.ndarray | None = None,
        hidden: bool = False,
    ) -> Instances:
        """Add or replace copies of a mesh."""
        item = self.instances.get(name)
        if item is None or item.mesh != mesh or item.count != len(poses):
            item = self.instances[name] = Instances(mesh, len(poses))
        item.poses.set(poses)
        if scales is not None:
            item.scales.set(scales)
        if colors is not None:
            item.colors.set(np.pad(colors, ((0, 0), (0, 4 - colors.shape[1]))))
        item.hidden = hidden
        return item

    def put_lines(
        self,
        name: str,
        starts: np.ndarray,
        ends: np.ndarray,
        colors: np.ndarray,
        width: float,
        hidden: bool = False,
    ) -> None:
        """Add or replace segments."""
        item = self.lines.setdefault(name, Lines())
        item.starts.set(starts)
        item.ends.set(ends)
        item.colors.set(colors)
        item.width, item.hidden = float(width), hidden

    def remove(self, name: str) -> None:
        """Remove the objects with this name."""
        for kind in (self.meshes, self.instances, self.lines):
            kind.pop(name, None)

    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the lower and upper corner {3} (m) of all visible objects except planes.

        None: no object is visible.
        """
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        for item in self.instances.values():
            if item.hidden or not item.count or item.mesh == "plane":
                continue
            corner = np.abs(self.meshes[item.mesh].points.values).max(axis=0, initial=0.0)
            half = np.abs(item.scales.values[:, :3]) * corner
            half[:, 2] += item.scales.values[:, 3]
            world = item.world()
            axes = rotate(world[:, None, 3:], np.eye(3, dtype=np.float32))
            size = (np.abs(axes) * half[:, :, None]).sum(axis=1)
            lower = np.minimum(lower, (world[:, :3] - size).min(axis=0))
            upper = np.maximum(upper, (world[:, :3] + size).max(axis=0))
        for lines in self.lines.values():
            if not lines.hidden and lines.count:
                ends = np.concatenate([lines.starts.values, lines.ends.values])
                lower, upper = (
                    np.minimum(lower, ends.min(axis=0)),
                    np.maximum(upper, ends.max(axis=0)),
                )
        return (lower, upper) if np.isfinite([lower, upper]).all() else None
