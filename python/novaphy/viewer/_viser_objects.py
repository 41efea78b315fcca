"""The objects of a scene on the page of ViewerViser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ._model_scene import INFINITE
from ._scene import Instances, Lines, Mesh, Scene, compose, f32

DARKER = 1.7
STRONG = 0.5  # a plane of this contrast or more is drawn as checker squares, else as grid lines
FIELDS, PIXELS = 32, 32  # half extent of the checker (m), and pixels per m


class PageObjects:
    """Updates the page from a scene, and sends only what changed.

    Attributes:
        handles: by name, the viser handles of every object and the revisions that were sent.
    """

    def __init__(self, server: Any, pull: Callable[[str, np.ndarray, Any], None]) -> None:
        """Start with an empty page.

        Args:
            server: the viser server.
            pull: a callback for dragging. Its arguments are the name of an object of the model, the
                rows of the object that the dragged mesh shows, and the event of the pointer.
        """
        self.server, self.pull = server, pull
        self.handles: dict[str, tuple[Any, Any]] = {}

    def send(self, scene: Scene) -> None:
        """Update the page so that it shows a scene."""
        wanted = {f"/{name}" for name in (*scene.instances, *scene.lines)}
        for name in [name for name in self.handles if name not in wanted]:
            self.handles.pop(name)[0].remove()
        with self.server.atomic():
            for name, item in scene.instances.items():
                self._send_instances(f"/{name}", item, scene.meshes[item.mesh])
            for name, lines in scene.lines.items():
                self._send_lines(f"/{name}", lines)

    def _send_instances(self, name: str, item: Instances, mesh: Mesh) -> None:
        fixed = (
            len(mesh.points.values), mesh.indices.revision, item.local.revision, item.culled,
            item.scales.revision, item.colors.revision, item.hidden or not item.count,
        )  # fmt: skip
        now = (fixed, mesh.points.revision, item.poses.revision)
        handle, seen = self.handles.get(name, (None, (None, None, None)))
        if seen == now:
            return
        poses = compose(item.poses.values, item.local.values)
        if handle is None or seen[0] != fixed:
            if handle is not None:
                handle.remove()
            handle = self._add(name, item, mesh, poses)
        else:
            if seen[1] != now[1]:
                handle.reshape(mesh)
            if seen[2] != now[2]:
                handle.move(poses)
        self.handles[name] = (handle, now)

    def _add(self, name: str, item: Instances, mesh: Mesh, poses: np.ndarray) -> Any:
        """Add instances to the page."""
        scene = self.server.scene
        group = _Object()
        if item.hidden or not item.count:
            return group
        colors = _shades(item.colors.values[:, :3])
        contrast = float(item.colors.values[0, 3])
        if item.mesh == "plane" and contrast >= STRONG:
            bright = item.colors.values[0, :3]
            group.parts.append((self._add_checker(name, contrast, bright, poses[0]), None))
            return group
        if item.mesh == "plane" and contrast > 0.0:
            size = float(item.scales.values[0, 0])
            grid = scene.add_grid(
                _node(name), size, size, plane="xy", cell_size=1.0, section_size=10.0,
                infinite_grid=size >= INFINITE, plane_color=tuple(colors[0]), plane_opacity=1.0,
                shadow_opacity=0.3, position=poses[0, :3], wxyz=_wxyz(poses)[0],
            )  # fmt: skip
            group.parts.append((grid, None))
            return group
        # viser cannot shift the halves of a capsule. Capsules of equal proportions share a mesh.
        shift, scales = mesh.shift.values, item.scales.values
        ratios = scales[:, 3] / scales[:, 0] if shift.any() else np.zeros(item.count)
        for number, ratio in enumerate(np.unique(ratios)):
            rows = np.flatnonzero(ratios == ratio)
            handle = scene.add_batched_meshes_simple(
                f"{_node(name)}/{number}", _stretched(mesh, ratio),
                mesh.indices.values, _wxyz(poses[rows]), poses[rows, :3],
                batched_scales=scales[rows, :3] * _hairs(rows), batched_colors=colors[rows],
                side="front" if item.culled else "double",
            )  # fmt: skip
            if name.startswith("/model/"):  # a drag with control pulls the body
                pull = partial(self.pull, name.removeprefix("/"), rows)
                handle.on_drag("left", modifier="cmd/ctrl")(pull)
            group.parts.append((handle, rows))
            group.ratios.append(ratio)
        return group

    def _add_checker(self, name: str, contrast: float, color: np.ndarray, pose: np.ndarray) -> Any:
        """Add a checker of squares of 1 m as an image, which the page's light does not brighten."""
        field = np.arange(2 * FIELDS)
        dark = (field[:, None] + field) % 2 == 1
        dark = dark.repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)[..., None]
        pixels = np.round(255.0 * color * np.where(dark, 1.0 - contrast, 1.0)).astype(np.uint8)
        return self.server.scene.add_image(
            _node(name), pixels, 2.0 * FIELDS, 2.0 * FIELDS, format="png",
            position=pose[:3], wxyz=_wxyz(pose[None])[0], cast_shadow=False,
        )  # fmt: skip

    def _send_lines(self, name: str, item: Lines) -> None:
        seen = (
            item.starts.revision, item.ends.revision, item.colors.revision, item.hidden, item.width
        )  # fmt: skip
        handle, known = self.handles.get(name, (None, None))
        if known == seen:
            return
        if handle is not None:
            handle.remove()
        group = _Object()
        if item.count and not item.hidden:
            points = np.stack([item.starts.values, item.ends.values], axis=1)
            colors = _shades(item.colors.values)
            lines = self.server.scene.add_line_segments(
                _node(name), points, np.repeat(colors[:, None], 2, axis=1), thickness=item.width
            )
            group.parts.append((lines, None))
        self.handles[name] = (group, seen)


class _Object:
    """An object on the page: viser handles, each with the rows of the instances that it shows."""

    def __init__(self, parts: Sequence[tuple[Any, np.ndarray | None]] = ()) -> None:
        self.parts = list(parts)
        self.ratios: list[float] = []  # of each part: shift of the capsule halves

    def reshape(self, mesh: Mesh) -> None:
        """Update the points of a mesh."""
        for (handle, _), ratio in zip(self.parts, self.ratios, strict=False):
            handle.vertices = _stretched(mesh, ratio)

    def move(self, poses: np.ndarray) -> None:
        """Set new poses of the instances."""
        for handle, rows in self.parts:
            if rows is None:
                handle.position, handle.wxyz = poses[0, :3], _wxyz(poses)[0]
            else:
                handle.batched_positions = poses[rows, :3]
                handle.batched_wxyzs = _wxyz(poses[rows])

    def remove(self) -> None:
        """Remove the object from the page."""
        for handle, _ in self.parts:
            handle.remove()


def _node(name: str) -> str:
    """Return the name of an object's node, with "|" for "/".

    Without "/" the nodes have no children, which viser would remove with their parent.
    """
    return "/" + name.removeprefix("/").replace("/", "|")


def _stretched(mesh: Mesh, ratio: float) -> np.ndarray:
    """Return the points of a mesh with its halves shifted along z."""
    return mesh.points.values + mesh.shift.values * f32([0.0, 0.0, ratio])


def _hairs(rows: np.ndarray) -> np.ndarray:
    """Return scale factors {n, 1} slightly below 1, so that coinciding surfaces do not flicker."""
    return f32(1.0 - 1e-3 * (rows[:, None] % 8))


def _shades(colors: np.ndarray) -> np.ndarray:
    """Return colors as uint8, darkened, because the page's ambient light makes colors pale."""
    return np.round(255.0 * colors**DARKER).astype(np.uint8)


def _wxyz(poses: np.ndarray) -> np.ndarray:
    return poses[:, [6, 3, 4, 5]]
