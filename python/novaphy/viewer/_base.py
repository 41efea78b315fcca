"""The common interface of all viewers, as a base class whose methods do nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from .._core import Contacts, Model, SimState

# A DeviceArray, nova.Tensor, numpy.ndarray or nested sequence of numbers.
ArrayLike = Any


class Slider:
    """A number that the user can change; calling the slider returns the number."""

    def __init__(
        self,
        name: str,
        low: float,
        high: float,
        value: float,
        on_change: Callable[[float], object] | None = None,
    ) -> None:
        """Set the initial value. ValueError unless low <= value <= high and low < high."""
        if not low < high or not low <= value <= high:
            raise ValueError(f"add_slider, value: expected {low} <= {value} <= {high}, low < high")
        self.name, self.low, self.high = name, float(low), float(high)
        self.value, self.on_change = float(value), on_change

    def __call__(self) -> float:
        """Return the present value."""
        return self.value

    def set(self, value: float) -> None:
        """Set the value, limited to the range of the slider."""
        self.value = min(max(float(value), self.low), self.high)
        if self.on_change is not None:
            self.on_change(self.value)


class Viewer:
    """A viewer that shows nothing.

    Positions are in m in the world frame. Colors are RGB from 0 to 1.
    """

    def __init__(self) -> None:
        """Start the viewer without a model. The viewer is running and not paused."""
        self.model: Model | None = None
        self.time = 0.0
        self._running = True
        self._paused = False

    def set_model(self, model: Model) -> None:
        """Show the shapes and particles of a model."""
        self.model = model

    def set_model_arrays(self, arrays: Mapping[str, np.ndarray], up_axis: int) -> None:
        """Show a model given by its arrays, keyed by field, as in a recording."""

    def set_camera(
        self, pos: ArrayLike, pitch: float | None = None, yaw: float | None = None
    ) -> None:
        """Place the camera at `pos` (m), looking along pitch and yaw (degrees)."""

    def look_at(self, pos: ArrayLike, target: ArrayLike) -> None:
        """Place the camera at `pos`, looking at `target` (m)."""

    def follow(self, body: int | None) -> None:
        """Make the camera track a body of the model horizontally; None: stop tracking."""

    def set_world_offsets(self, spacing: ArrayLike) -> None:
        """Show world k of a model displaced by k times `spacing` {3} (m)."""

    def begin_frame(self, t: float) -> None:
        """Start a frame at time `t` (s). The log_* calls up to end_frame belong to the frame."""
        self.time = float(t)

    def end_frame(self) -> None:
        """Finish the frame."""

    def log_state(self, state: SimState) -> None:
        """Show a state of the model."""

    def log_state_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Show a state given by its arrays, keyed by field, as in a recording."""

    def log_contacts(self, contacts: Contacts, state: SimState) -> None:
        """Show the contacts of a state."""

    def set_shape_colors(self, shapes: ArrayLike, colors: ArrayLike) -> None:
        """Set the colors {n, 3} of shapes {n} (indices); all other shapes get their default colors.

        In colors {n, 4} the fourth number is the contrast of a checker pattern (0 to 1; 0: no
        pattern).
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
        """Show a triangle mesh with points {n, 3} (m) and indices {m, 3}."""

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
        """Show copies of the mesh named `mesh` at transforms {n, 7} (m, quaternion xyzw)."""

    def log_shapes(
        self,
        name: str,
        geo_type: int,
        geo_scale: ArrayLike,
        xforms: ArrayLike,
        colors: ArrayLike | None = None,
        materials: ArrayLike | None = None,
    ) -> None:
        """Show copies of a primitive at transforms {n, 7} (m, quaternion xyzw).

        `geo_type` is a GeoType, and `geo_scale` {3} or {n, 3} its shape_scale (m).
        """

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
        """Plot the values of an array as a curve."""

    def log_scalar(self, name: str, value: float) -> None:
        """Add the value of this frame to a plot over time."""

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
        """Add a slider for a number between `low` and `high`; calling the slider returns the
        number.

        In a viewer without input the number stays at `value`. `on_change` gets each new value.
        ValueError unless low <= value <= high and low < high.
        """
        return Slider(name, low, high, value, on_change)

    def apply_forces(self, state: SimState) -> None:
        """Add the force of a drag with the pointer to the particle_f or body_f of a state."""

    def clear(self) -> None:
        """Remove the model and all drawings."""

    def is_running(self) -> bool:
        """Return False after the viewer was closed."""
        return self._running

    def is_paused(self) -> bool:
        """Return whether the user has paused the simulation."""
        return self._paused

    def should_step(self) -> bool:
        """Return whether the simulation should advance in this frame."""
        return not self.is_paused()

    def is_key_down(self, key: str | int) -> bool:
        """Return whether a key is pressed."""
        return False

    def get_frame(self) -> np.ndarray:
        """Return the image {h, w, 3}, uint8. NotImplementedError: the viewer draws no image."""
        raise NotImplementedError(f"{type(self).__name__} draws no picture")

    def close(self) -> None:
        """Close the viewer."""
        self._running = False

    def __enter__(self) -> Viewer:
        """Return the viewer, which is closed at the end of the block."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the viewer."""
        self.close()
