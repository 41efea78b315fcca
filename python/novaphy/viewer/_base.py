"""The calls that every viewer has. Here they do nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from .._core import Contacts, Model, SimState

# DeviceArray, nova.Tensor, numpy.ndarray or nested sequences.
ArrayLike = Any


class Slider:
    """A number that the user may move; called, it gives its value."""

    def __init__(
        self,
        name: str,
        low: float,
        high: float,
        value: float,
        on_change: Callable[[float], object] | None = None,
    ) -> None:
        """Start at `value`. ValueError unless low <= value <= high and low < high."""
        if not low < high or not low <= value <= high:
            raise ValueError(f"add_slider, value: expected {low} <= {value} <= {high}, low < high")
        self.name, self.low, self.high = name, float(low), float(high)
        self.value, self.on_change = float(value), on_change

    def __call__(self) -> float:
        """Where it stands."""
        return self.value

    def set(self, value: float) -> None:
        """Move it, within its ends."""
        self.value = min(max(float(value), self.low), self.high)
        if self.on_change is not None:
            self.on_change(self.value)


class Viewer:
    """A viewer that shows nothing. Positions are in m, world frame; colors are RGB in 0..1."""

    def __init__(self) -> None:
        """Start without a model, running, not paused."""
        self.model: Model | None = None
        self.time = 0.0
        self._running = True
        self._paused = False

    def set_model(self, model: Model) -> None:
        """Show the shapes and particles of a model from now on."""
        self.model = model

    def set_model_arrays(self, arrays: Mapping[str, np.ndarray], up_axis: int) -> None:
        """Show a model of which only the arrays are there, by field, as in a recording."""

    def set_camera(
        self, pos: ArrayLike, pitch: float | None = None, yaw: float | None = None
    ) -> None:
        """Place the camera at `pos` (m), looking along pitch and yaw (degrees)."""

    def look_at(self, pos: ArrayLike, target: ArrayLike) -> None:
        """Place the camera at `pos`, looking at `target` (m)."""

    def follow(self, body: int | None) -> None:
        """Let the camera go along with a body of the model, on the level; None: let it stay."""

    def set_world_offsets(self, spacing: ArrayLike) -> None:
        """Show the worlds of a model apart by `spacing` (m)."""

    def begin_frame(self, t: float) -> None:
        """Start a frame at time `t` (s). The log_* calls that follow belong to it."""
        self.time = float(t)

    def end_frame(self) -> None:
        """Finish the frame."""

    def log_state(self, state: SimState) -> None:
        """Show a state of the model."""

    def log_state_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Show a state of which only the arrays are there, by field, as in a recording."""

    def log_contacts(self, contacts: Contacts, state: SimState) -> None:
        """Show the contacts of a state."""

    def set_shape_colors(self, shapes: ArrayLike, colors: ArrayLike) -> None:
        """Show shapes {n} of the model in colors {n, 3}, and all others in their own.

        Colors {n, 4} have as their fourth number the contrast of a checker (0 to 1, 0: none).
        """

    def log_mesh(
        self,
        name: str,
        points: ArrayLike,
        indices: ArrayLike,
        normals: ArrayLike | None = None,
        uvs: ArrayLike | None = None,
        texture: ArrayLike | None = None,
        hidden: bool = False,
        backface_culling: bool = True,
        color: Sequence[float] | None = None,
    ) -> None:
        """Show triangles: points {n, 3} (m), indices {m, 3}."""

    def log_instances(
        self,
        name: str,
        mesh: str,
        xforms: ArrayLike,
        scales: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        materials: ArrayLike | None = None,
        hidden: bool = False,
    ) -> None:
        """Show copies of a mesh at transforms {n, 7}."""

    def log_shapes(
        self,
        name: str,
        geo_type: int,
        geo_scale: ArrayLike,
        xforms: ArrayLike,
        colors: ArrayLike | None = None,
        materials: ArrayLike | None = None,
    ) -> None:
        """Show copies of a shape (GeoType and its scale) at transforms {n, 7}."""

    def log_lines(
        self,
        name: str,
        starts: ArrayLike | None,
        ends: ArrayLike | None,
        colors: ArrayLike | None,
        width: float = 0.01,
        hidden: bool = False,
    ) -> None:
        """Show line segments from starts {n, 3} to ends {n, 3} (m)."""

    def log_arrows(
        self,
        name: str,
        starts: ArrayLike | None,
        ends: ArrayLike | None,
        colors: ArrayLike | None,
        width: float = 0.01,
        hidden: bool = False,
    ) -> None:
        """Show arrows from starts {n, 3} to ends {n, 3} (m)."""

    def log_points(
        self,
        name: str,
        points: ArrayLike | None,
        radii: ArrayLike | float | None = None,
        colors: ArrayLike | None = None,
        hidden: bool = False,
    ) -> None:
        """Show points {n, 3} with radii {n} (m)."""

    def log_array(self, name: str, array: ArrayLike) -> None:
        """Show a plot of an array."""

    def log_scalar(self, name: str, value: float) -> None:
        """Add a value to a plot over time."""

    def log_image(self, name: str, image: ArrayLike) -> None:
        """Show an image {h, w, 3}, uint8."""

    def add_slider(
        self,
        name: str,
        low: float,
        high: float,
        value: float,
        on_change: Callable[[float], object] | None = None,
    ) -> Slider:
        """Let the user move a number between `low` and `high`; called, the slider gives its value.

        A viewer without a user leaves it at `value`. `on_change` is called with a new one.
        ValueError unless low <= value <= high and low < high.
        """
        return Slider(name, low, high, value, on_change)

    def apply_forces(self, state: SimState) -> None:
        """Add the forces of the user's pointer to a state."""

    def clear(self) -> None:
        """Take out the model and all that was drawn."""

    def is_running(self) -> bool:
        """Return False once the viewer was closed."""
        return self._running

    def is_paused(self) -> bool:
        """Whether the user paused the simulation."""
        return self._paused

    def should_step(self) -> bool:
        """Whether the simulation should advance in this frame."""
        return not self.is_paused()

    def is_key_down(self, key: str | int) -> bool:
        """Whether a key is held."""
        return False

    def get_frame(self) -> np.ndarray:
        """Return the picture {h, w, 3}, uint8. NotImplementedError for a viewer that draws none."""
        raise NotImplementedError(f"{type(self).__name__} draws no picture")

    def close(self) -> None:
        """End the viewer."""
        self._running = False

    def __enter__(self) -> Viewer:
        """Return itself; it is closed when the block ends."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the viewer."""
        self.close()
