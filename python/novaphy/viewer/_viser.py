"""ViewerViser: shows the scene in web browsers, through the package viser."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from .._core import SimState
from ._base import Slider
from ._camera import FIELD_OF_VIEW
from ._drag import Drag
from ._needs import needs
from ._overlay import curve_picture
from ._scene_viewer import SceneViewer
from ._viser_objects import PageObjects

SEND_RATE = 30.0  # largest number of frames per second that are sent
PORTS_TRIED = 10
LOCAL = ("127.0.0.1", "localhost", "::1")


class ViewerViser(SceneViewer):
    """Serves a web page for any number of browsers.

    The page has buttons to pause, step and reset, a slider over the last frames, and the sliders of
    add_slider. A drag with the control key pulls a body or particle.

    Attributes:
        port: the port in use.
        url: the address of the page.
        reset_requested: True after a click on reset, until the caller sets it to False.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8080,
        history: int = 600,
        verbose: bool = True,
    ) -> None:
        """Start the server, which by default is reachable from this machine only.

        Args:
            host: the address to listen on.
            port: the first of ten ports to try; 0: any free port.
            history: number of past frames that the page can show.
            verbose: print the address of the page.

        Raises:
            ImportError: the package viser is missing.
            OSError: all ten ports are in use.
            ValueError: a number is out of range.
        """
        super().__init__()
        if not 0 <= port <= 65535:
            raise ValueError(f"ViewerViser, port: expected 0 to 65535, got {port}")
        if history < 1:
            raise ValueError(f"ViewerViser, history: expected >= 1, got {history}")
        viser = needs("viser", "web", "ViewerViser")
        self.port = _free_port(host, port)
        with _silence():
            self._server = viser.ViserServer(host=host, port=self.port, verbose=False)
        self.url = f"http://{'localhost' if host in LOCAL else host}:{self.port}"
        if verbose:
            reach = "this machine only" if host in LOCAL else f"everybody who reaches {host}"
            print(f"ViewerViser: {self.url} (for {reach})")
        self.history = history
        self.reset_requested = False
        self._sent_at = 0.0
        self._page = PageObjects(self._server, self._pull)
        self._sent_camera: Any = None
        self._pictures: dict[str, tuple[Any, np.ndarray]] = {}
        self._drawn_curves: dict[str, tuple[bytes, np.ndarray]] = {}
        self._past: list[dict[str, Any]] = []
        self._shown_past: int | None = None
        self._drag = Drag(self)
        self._lock = threading.RLock()  # handlers of the page run in threads of viser
        self._make_panel()

    def _make_panel(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="small")  # so that the panel covers less of the scene
        self._text = gui.add_markdown("")
        self._pause_box = gui.add_checkbox("pause", False)
        step, reset = gui.add_button("step"), gui.add_button("reset")
        self._scrubber = gui.add_slider("past frame", 0, self.history - 1, 1, self.history - 1)
        self._pause_box.on_update(lambda _: self.pause(bool(self._pause_box.value)))
        step.on_click(lambda _: self.step_once())
        reset.on_click(lambda _: setattr(self, "reset_requested", True))
        self._scrubber.on_update(lambda event: self._scrub() if event.client else None)

    def add_slider(
        self,
        name: str,
        low: float,
        high: float,
        value: float,
        on_change: Callable[[float], object] | None = None,
    ) -> Slider:
        """Add a slider to the page; calling the slider returns its value.

        Args:
            name: label of the slider.
            low: smallest value.
            high: largest value. ValueError unless low < high and low <= value <= high.
            value: initial value.
            on_change: called in a thread of the server when a user moves the slider.
        """
        slider = _PageSlider(name, low, high, value, on_change)
        slider.show_on(self._server.gui)
        return slider

    @property
    def client_count(self) -> int:
        """The number of connected browsers."""
        return len(self._server.get_clients())

    def pause(self, paused: bool = True) -> None:
        """Pause, or resume at the latest frame."""
        with self._lock:
            self._paused = paused
            if self._pause_box.value != paused:
                self._pause_box.value = paused
            if not paused and self._shown_past is not None:
                self._shown_past = None
                self._scrubber.value = self.history - 1

    def end_frame(self) -> None:
        """Send the frame, at most SEND_RATE times per second, and store it for the slider."""
        now = time.perf_counter()
        if now - self._sent_at < 1.0 / SEND_RATE and not self._paused:
            return
        self._sent_at = now
        with self._lock:
            self._past.append(self._snapshot())
            del self._past[: -self.history]
            if self._shown_past is None:
                self._send()
        if self._paused:
            time.sleep(1.0 / SEND_RATE)

    def _snapshot(self) -> dict[str, Any]:
        poses = {name: item.poses.values.copy() for name, item in self.scene.instances.items()}
        points = {name: mesh.points.values for name, mesh in self.scene.meshes.items()}
        return {"time": self.time, "poses": poses, "points": points}

    def _scrub(self) -> None:
        """Show the past frame that the slider selects."""
        with self._lock:
            if not self._past:
                return
            back = self.history - 1 - int(self._scrubber.value)
            k = max(len(self._past) - 1 - back, 0)
            self._shown_past = None if back == 0 else k
            if self._shown_past is not None and not self._paused:
                self.pause()
            past = self._past[k]
            for name, poses in past["poses"].items():
                if name in self.scene.instances:
                    self.scene.instances[name].poses.set(poses.copy())
            for name, points in past["points"].items():
                if name in self.scene.meshes:
                    self.scene.meshes[name].points.set(points)
            self._send(past["time"])

    def _send(self, at: float | None = None) -> None:
        """Update the page from the scene."""
        if not self.camera.is_set:
            self._place_camera()
        self._send_camera()
        lines = self.texts() if at is None else [f"time {at:.3f} s"]
        self._text.content = "  \n".join(lines)
        self._send_pictures()
        self._page.send(self.scene)

    def _send_pictures(self) -> None:
        """Show images and curves in the panel. A curve is sent as an image."""
        pictures = dict(self.scene.images)
        curves: dict[str, Any] = dict(self.scene.curves)
        if len(self.scene.scalars.get("loss", ())) > 1:
            curves["loss"] = np.array(self.scene.scalars["loss"])
        for name, values in curves.items():
            key = values.tobytes()
            if self._drawn_curves.get(name, ("", None))[0] != key:
                self._drawn_curves[name] = (key, curve_picture(values))
            pictures[name] = self._drawn_curves[name][1]
        for name, pixels in pictures.items():
            panel = self._pictures.get(name)
            if panel is None:
                self._pictures[name] = (self._server.gui.add_image(pixels, label=name), pixels)
            elif panel[1] is not pixels:
                panel[0].image = pixels
                self._pictures[name] = (panel[0], pixels)

    def _send_camera(self) -> None:
        camera = self.camera
        seen = (camera.pos, camera.target.copy())
        before, self._sent_camera = self._sent_camera, seen
        if before is not None and np.array_equal(before, seen):
            return
        self._server.scene.set_up_direction("+" + "xyz"[camera.up_axis])
        initial = self._server.initial_camera
        initial.position, initial.look_at = tuple(camera.pos), tuple(camera.target)
        initial.up, initial.fov = tuple(camera.up), float(np.radians(FIELD_OF_VIEW))
        for client in self._server.get_clients().values():
            eye = seen[0]
            if before is not None and self.follows:  # keep the user's distance and direction
                eye = seen[1] + (client.camera.position - client.camera.look_at)
            client.camera.position, client.camera.look_at = tuple(eye), tuple(seen[1])

    def _pull(self, name: str, rows: np.ndarray, event: Any) -> None:
        """Drag the body or particle that a row of an object shows, as the pointer moves."""
        with self._lock:
            start = np.array(event.start_position)
            if event.phase == "start" and self._model_scene is not None:
                row = int(rows[event.instance_index or 0])
                item = self._model_scene.owner(name, row, start)
                if item is not None:
                    self._drag.hold(item, start)
            if event.phase == "end":
                self._drag.stop()
            elif self._drag.item is not None:
                self._drag.pull(np.array(event.end_position))

    def apply_forces(self, state: SimState) -> None:
        """Add the force of a drag with the pointer to a state's particle_f or body_f."""
        with self._lock:
            self._drag.apply(state)

    def is_key_down(self, key: str | int) -> bool:
        """Raise NotImplementedError: keyboard input is not available on a page."""
        raise NotImplementedError("is_key_down: the page of ViewerViser tells of no keys")

    def close(self) -> None:
        """Stop the server and free the port."""
        if self._running:
            super().close()
            with _silence():
                self._server.stop()


class _PageSlider(Slider):
    """A slider on the page."""

    def show_on(self, gui: Any) -> None:
        """Add the slider to the panel."""
        step = (self.high - self.low) / 1000.0
        self.handle = gui.add_slider(self.name, self.low, self.high, step, self.value)
        self.handle.on_update(
            lambda event: Slider.set(self, self.handle.value) if event.client else None
        )

    def set(self, value: float) -> None:
        """Set the value, on the page too."""
        super().set(value)
        self.handle.value = self.value


def _silence() -> contextlib.AbstractContextManager[Any]:
    """Suppress the messages that viser prints at its start and end."""
    return contextlib.redirect_stdout(io.StringIO())


def _free_port(host: str, first: int) -> int:
    """Return the first free port from `first` on."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in range(first, min(first + PORTS_TRIED, 65536)):
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise OSError(
        f"ViewerViser, port: {first} to {first + PORTS_TRIED - 1} are taken, or {host} is no "
        "address of this machine"
    )
