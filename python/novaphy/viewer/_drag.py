"""Dragging: picks a body or particle with the pointer, and pulls it by a spring."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._core import SimState

if TYPE_CHECKING:
    from ._scene_viewer import SceneViewer

DRAG_RATE = 6.0  # rad/s, angular frequency of the critically damped spring of a drag
PICK_PIXELS = 40.0


class Drag:
    """A spring between a body or particle and a point that the pointer moves."""

    def __init__(self, viewer: SceneViewer) -> None:
        """Start without a dragged object."""
        self.viewer = viewer
        self.item: tuple[str, int] | None = None  # ("body" or "particle", its index)
        self.goal = np.zeros(3)
        self.grip = np.zeros(3)  # vector (m) from the grabbed point to the position of the item
        self.depth = 0.0

    def candidates(self) -> list[tuple[str, int, np.ndarray]]:
        """Return (kind, index, position {3} (m)) of the bodies and particles of the last state."""
        latest = self.viewer.latest_state
        out = [("body", k, row[:3]) for k, row in enumerate(latest.get("body_q", ()))]
        return out + [("particle", k, row) for k, row in enumerate(latest.get("particle_q", ()))]

    def place(self, item: tuple[str, int]) -> np.ndarray:
        """Return the position {3} (m) of a body or particle in the last state."""
        rows = self.viewer.latest_state[f"{item[0]}_q"]
        return np.asarray(rows[item[1]][:3], np.float64)

    def pick(self, x: float, y: float, size: tuple[int, int]) -> tuple[str, int, np.ndarray] | None:
        """Return the first body at a pixel, else the nearest candidate within PICK_PIXELS."""
        found = self.candidates()
        if not found:
            return None
        camera = self.viewer.camera
        body = self.viewer.body_at(camera.pos, camera.ray(x, y, *size))
        if body is not None:
            return found[body]
        pixels = camera.project(np.array([place for _, _, place in found]), *size)
        away = np.linalg.norm(pixels - (x, y), axis=1)
        nearest = int(np.argmin(away))
        return found[nearest] if away[nearest] < PICK_PIXELS else None

    def start(self, x: float, y: float, size: tuple[int, int]) -> None:
        """Start dragging the object under a pixel."""
        found = self.pick(x, y, size)
        if found is not None:
            camera = self.viewer.camera
            self.depth = float((found[2] - camera.pos) @ camera.forward)
            self.hold(found[:2], self._point(x, y, size))

    def hold(self, item: tuple[str, int], point: np.ndarray) -> None:
        """Start dragging a body or particle at a point {3} (m)."""
        self.grip = self.place(item) - point
        self.item = item
        self.pull(point)

    def move(self, x: float, y: float, size: tuple[int, int]) -> None:
        """Move the target to a pixel, at the same depth as the dragged point."""
        self.pull(self._point(x, y, size))

    def pull(self, point: np.ndarray) -> None:
        """Set the goal of the spring so that the grabbed point moves to `point` {3} (m)."""
        self.goal = point + self.grip

    def stop(self) -> None:
        """Stop dragging."""
        self.item = None

    def _point(self, x: float, y: float, size: tuple[int, int]) -> np.ndarray:
        camera = self.viewer.camera
        ray = camera.ray(x, y, *size)
        return np.asarray(camera.pos + ray * (self.depth / (ray @ camera.forward)))

    def nearest_to_middle(self) -> int | None:
        """Return the index of the candidate nearest to the image's center; None: no candidate."""
        found = self.candidates()
        if not found:
            return None
        target = self.viewer.camera.target
        return int(np.argmin([np.linalg.norm(place - target) for _, _, place in found]))

    def look_at(self, number: int) -> None:
        """Set the camera's target to the candidate with this index."""
        found = self.candidates()
        if number < len(found):
            self.viewer.camera.target = np.asarray(found[number][2], np.float64)

    def apply(self, state: SimState) -> None:
        """Add the force of a critically damped spring to the forces of the dragged item.

        The force is m (w² (goal - x) - 2 w v), with the item's mass m, position x and velocity v,
        and w = DRAG_RATE.
        """
        model, item = self.viewer.model, self.item
        if item is None or model is None:
            return
        kind, k = item
        place, velocity, force, mass = (
            (state.body_q, state.body_qd, state.body_f, model.body_mass)
            if kind == "body"
            else (state.particle_q, state.particle_qd, state.particle_f, model.particle_mass)
        )
        x, v = place.numpy()[k, :3], velocity.numpy()[k, :3]
        pull = DRAG_RATE**2 * (self.goal - x) - 2.0 * DRAG_RATE * v
        rows = force.numpy()
        rows[k, :3] += float(mass.numpy()[k]) * pull
        force.assign(rows)
