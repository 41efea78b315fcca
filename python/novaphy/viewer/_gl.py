"""ViewerGL: images by OpenGL, in a window or without a display."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .._core import SimState
from ..io import atomic_path
from ._adjoint import check_record, log_arrows_between
from ._adjoint_axis import SIZE as AXIS_SIZE
from ._adjoint_axis import AdjointAxis
from ._base import Slider
from ._gl_renderer import Renderer
from ._needs import MissingPackageError, needs
from ._overlay import BOX, MARGIN, overlay
from ._png import write_png
from ._scene_viewer import SceneViewer
from ._video import Video

if TYPE_CHECKING:
    from ..nova import AdjointRecord

DISPLAY_RATE = 60.0  # largest number of images per second in a window
SHARE = 0.25  # largest part of the program's time for drawing in a window, unless `waits` is set
GRACE = 2e-3  # s: how long end_frame waits for an image, so that a fast one is shown at once


class ViewerGL(SceneViewer):
    """Draws the scene on the GPU, in a window, or without a display through EGL.

    Mouse: a drag rotates the camera, a drag with the right button moves the camera, and the wheel
    zooms. A drag with the control key pulls a body or particle (see apply_forces). The text names
    the shape and the body under the pointer. If imgui-bundle is installed, the window has a panel
    with switches and sliders.

    Keys: space pauses, N steps, R resets, F tracks a body, H hides the text, P saves an image,
    escape closes. J shows joints, I inertias, C contacts, E the energy. Tab selects a slider; the
    left and right arrow keys move it.

    Attributes:
        show_text: whether the box with time and scalars is drawn.
        curve: the scalar whose curve is drawn below the text.
        reset_requested: True after the key R, until the caller sets it to False.
        draw_calls: number of draw calls of the last image.
        waits: True: a window shows every frame, at most DISPLAY_RATE per second, and end_frame
            waits for it. False: frames are skipped while the last image is drawn, and if drawing
            takes more than a quarter of the program's time.
        sliders: the sliders of add_slider.
    """

    def __init__(
        self,
        width: int = 1280,
        height: int = 720,
        vsync: bool = False,
        headless: bool = False,
        paused: bool = False,
        title: str = "NovaPhy",
    ) -> None:
        """Open a window of width x height pixels. With `headless`, draw images without a window.

        ImportError: a package is missing; the message names it. RuntimeError: no OpenGL context is
        available; the message has the reason.
        """
        super().__init__()
        if width < 1 or height < 1:
            raise ValueError(f"ViewerGL, width and height: expected >= 1, got {width} x {height}")
        self.show_text = True
        self.curve = "loss"
        self.reset_requested = False
        self.waits = False
        self.sliders: list[Slider] = []
        self.slider: int | None = None  # index of the slider that the arrow keys move
        self._paused = paused
        self._axis: AdjointAxis | None = None
        self._window: Any = None
        self._video: Video | None = None
        self._due = self._frame_at = 0.0
        self._frame_ms: float | None = None
        self._drawn: tuple[Any, ...] | None = None  # the last image's inputs besides the scene
        if headless:
            self._context, samples = _headless_context(), 4
        else:
            from ._gl_window import Window

            self._window = Window(self, width, height, vsync, title)
            self._context, samples = self._window.context, 4
        self._renderer = Renderer(self._context, samples)
        self._renderer.resize(width, height)

    @property
    def draw_calls(self) -> int:
        """The number of draw calls of the last image."""
        return self._renderer.draw_calls

    @property
    def size(self) -> tuple[int, int]:
        """The width and height of the image in pixels."""
        width, height = self._renderer.target.size
        return int(width), int(height)

    def log_adjoint_record(self, record: AdjointRecord, length: float = 0.3) -> None:
        """Add a plot of a gradient over time above the text, and arrows of the recorded contacts.

        The plot shows the norm of the gradient, H, contact events and suspects. H is the gradient
        with respect to the state times the rate of the state. Smooth steps conserve H. Suspects
        are steps in which H changes. A click selects a step and pauses: see selected_step. The
        times of frames must be the times of the record (s).

        Args:
            record: the result of `tape.adjoint_record()`.
            length: the length (m) of the longest impulse arrow (blue) and of the longest adjoint
                arrow (red).

        Raises:
            TypeError: `record` is no AdjointRecord.
            ValueError: a record without steps; a length that is not positive and finite.
        """
        check_record(record, length)
        self._axis = AdjointAxis(record, length)

    @property
    def selected_step(self) -> int | None:
        """The step that a click on the time axis selected; None: none, or the run was resumed."""
        return None if self._axis is None else self._axis.selected

    def select_step_at(self, x: float, y: float) -> bool:
        """Select the step of the time axis at a point of the image, and pause.

        Args:
            x: pixels from the left.
            y: pixels from the top.

        Returns:
            Whether the point is on the time axis.
        """
        column, row = x - BOX - MARGIN, y - BOX - MARGIN
        inside = 0 <= row < AXIS_SIZE[0] and 0 <= column < AXIS_SIZE[1]
        if self._axis is None or not (self._running and self.show_text and inside):
            return False
        self._axis.select(column)
        self.pause()
        return True

    def end_frame(self) -> None:
        """Show the frame. Without a window every frame is drawn; a window may skip frames.

        In a window the program continues while the image is drawn, unless `waits` is set.
        """
        if self._axis is not None:
            shown = self._axis.times_shown(self.time)
            log_arrows_between(self, self._axis.record, *shown, self._axis.length)
        now = time.perf_counter()
        if self._frame_at:
            self._frame_ms = 1e3 * (now - self._frame_at)
        self._frame_at = now
        self._drawn = None
        if self._window is not None:
            self._show(now)
            if self._paused:
                time.sleep(1.0 / DISPLAY_RATE)
        if self._video is not None:
            self._video.add(self.get_frame())

    def _show(self, now: float) -> None:
        """Show the last image on the screen, and start the next one if it is due."""
        window = self._window
        window.show_finished(self._renderer)
        if self._running and not window.is_drawing:
            early = self._due - now
            if self.waits and early > 0.0:
                time.sleep(early)
            if self.waits or early <= 0.0:
                begin = time.perf_counter()
                self.draw()
                window.start()
                window.show_finished(self._renderer, self.waits, GRACE)
                self._due = begin + 1.0 / DISPLAY_RATE
                if not self.waits:
                    cost = time.perf_counter() - begin
                    self._due = max(self._due, begin + cost / SHARE)

    def draw(self) -> None:
        """Draw the scene into the image of get_frame."""
        self._place_camera()
        box = None
        if self.show_text:
            lines = self.texts(self._paused)
            if self._window is not None and self._frame_ms is not None:
                lines.insert(1, f"frame {self._frame_ms:7.1f} ms")
            if self._window is not None and (name := self._window.name_under_pointer()):
                lines.append(name)
            if self._window is None or self._window.panel is None:
                lines += [
                    f"{'>' if k == self.slider else ' '} {slider.name} {slider.value:.6g}"
                    for k, slider in enumerate(self.sliders)
                ]
            top = [] if self._axis is None else [self._axis.block(self.time)]
            box = overlay(self.scene, lines, self.curve, top)
        self._renderer.draw(self.scene, self.camera, box)
        self._drawn = self._look()

    def get_frame(self) -> np.ndarray:
        """Return the image {h, w, 3}, uint8."""
        if not self._running:
            raise RuntimeError("get_frame: the viewer is closed")
        if self._drawn != self._look():
            self.draw()
        return self._renderer.read()

    def _look(self) -> tuple[Any, ...]:
        camera = self.camera
        looks = (tuple(camera.pos), tuple(camera.target))
        return (self.show_text, self.curve, self.selected_step, *looks)

    def save_picture(self, path: str | os.PathLike[str]) -> None:
        """Write the image to a .png file, atomically."""
        with atomic_path(os.path.abspath(os.fspath(path))) as temporary:
            write_png(temporary, self.get_frame())

    def start_video(self, path: str | os.PathLike[str], fps: float = 60.0) -> None:
        """Write every later frame to a video (.mp4, .webm, .gif, .webp) by ffmpeg.

        RuntimeError: ffmpeg is missing.
        """
        self.stop_video()
        self._video = Video(path, *self.size, fps)

    def stop_video(self) -> None:
        """Finish the video. RuntimeError: ffmpeg failed."""
        video, self._video = self._video, None
        if video is not None:
            video.close()

    def pause(self, paused: bool = True) -> None:
        """Pause or resume."""
        self._paused = paused
        if not paused and self._axis is not None:
            self._axis.selected = None

    def is_key_down(self, key: str | int) -> bool:
        """Return whether a key is pressed; `key` is a name ("space", "a") or pyglet's number."""
        return self._window is not None and self._window.is_key_down(key)

    def add_slider(
        self,
        name: str,
        low: float,
        high: float,
        value: float,
        on_change: Callable[[float], object] | None = None,
    ) -> Slider:
        """Add a slider to the window; calling the slider returns its value.

        Args:
            name: label of the slider.
            low: smallest value.
            high: largest value. ValueError unless low < high and low <= value <= high.
            value: initial value.
            on_change: called in end_frame when the user moves the slider.
        """
        slider = super().add_slider(name, low, high, value, on_change)
        self.sliders.append(slider)
        return slider

    def apply_forces(self, state: SimState) -> None:
        """Add the force of a drag with the pointer to a state's particle_f or body_f."""
        if self._window is not None:
            self._window.drag.apply(state)

    def close(self) -> None:
        """Close the window and release the context."""
        if not self._running:
            return
        super().close()
        try:
            self.stop_video()
        finally:
            self._renderer.release()
            if self._window is not None:
                self._window.close()
            self._context.release()


def _headless_context() -> Any:
    moderngl = needs("moderngl", "gl", "ViewerGL")
    try:
        return moderngl.create_standalone_context(backend="egl", require=330)
    except Exception as error:
        raise MissingPackageError(
            "ViewerGL: there is no OpenGL 3.3 without a display. Install its libraries: "
            f"apt-get install libegl1 libgl1-mesa-dri ({error})"
        ) from error
