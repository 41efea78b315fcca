"""ViewerViser: the scene in the browser, on the package viser."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._core import SimState
from ._base import Slider
from ._camera import FIELD_OF_VIEW
from ._drag import Drag
from ._model_scene import INFINITE
from ._needs import needs
from ._overlay import curve_picture
from ._scene import Instances, Lines, Mesh, compose, f32
from ._scene_viewer import SceneViewer

SEND_RATE = 30.0  # frames per second that are sent at most
PORTS_TRIED = 10
DARKER = 1.7
STRONG = 0.5  # a checker of this contrast has fields, not lines
FIELDS, PIXELS = 32, 32  # how far it goes (m), and pixels of 1 m
LOCAL = ("127.0.0.1", "localhost", "::1")


class ViewerViser(SceneViewer):
    """Serves a page at which any number of browsers look.

    The page pauses, steps, resets, goes through the last frames by a slider, and has a slider for
    every parameter that add_slider registers. Control and drag pulls a body or particle.

    Attributes:
        port: the port that is used.
        url: the address of the page.
        reset_requested: set by the page's button, until the caller sets it to False.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8080,
        history: int = 600,
        verbose: bool = True,
    ) -> None:
        """Start the server, on this machine only unless `host` says otherwise.

        Args:
            host: the address to listen at.
            port: the first port that is tried, of ten; 0 takes any that is free.
            history: frames that the page can go back to.
            verbose: say where the page is.

        Raises:
            ImportError: the package viser is missing.
            OSError: all ten ports are taken.
            ValueError: a number that makes no sense.
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
        self._handles: dict[str, tuple[Any, Any]] = {}
        self._pictures: dict[str, tuple[Any, np.ndarray]] = {}
        self._drawn_curves: dict[str, tuple[bytes, np.ndarray]] = {}
        self._past: list[dict[str, Any]] = []
        self._shown_past: int | None = None
        self._drag = Drag(self)
        self._lock = threading.RLock()  # handlers of the page run in threads of viser
        self._make_panel()

    def _make_panel(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="small")  # it lies over the scene
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
        """Give the page a slider; called, it gives its value.

        Args:
            name: beside the slider.
            low: the smallest value.
            high: the largest value. ValueError unless low < high and value is between.
            value: to begin with.
            on_change: called in a thread of the server when somebody moves it.
        """
        slider = _PageSlider(name, low, high, value, on_change)
        slider.show_on(self._server.gui)
        return slider

    @property
    def client_count(self) -> int:
        """Browsers that look at the page."""
        return len(self._server.get_clients())

    def pause(self, paused: bool = True) -> None:
        """Pause, or go on, at the latest frame."""
        with self._lock:
            self._paused = paused
            if self._pause_box.value != paused:
                self._pause_box.value = paused
            if not paused and self._shown_past is not None:
                self._shown_past = None
                self._scrubber.value = self.history - 1

    def end_frame(self) -> None:
        """Send the frame, at most SEND_RATE times per second; keep it for the slider."""
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
        """Show the past frame that the slider stands at."""
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
        """Bring the page up to the scene."""
        if not self.camera.is_set:
            self._place_camera()
        self._send_camera()
        lines = self.texts() if at is None else [f"time {at:.3f} s"]
        self._text.content = "  \n".join(lines)
        self._send_pictures()
        wanted = {"", *(f"/{name}" for name in (*self.scene.instances, *self.scene.lines))}
        for name in [name for name in self._handles if name not in wanted]:
            self._handles.pop(name)[0].remove()
        with self._server.atomic():
            for name, item in self.scene.instances.items():
                self._send_instances(f"/{name}", item)
            for name, lines_item in self.scene.lines.items():
                self._send_lines(f"/{name}", lines_item)

    def _send_pictures(self) -> None:
        """Show images, and curves as images, in the panel."""
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
        seen = (tuple(camera.pos), tuple(camera.target))
        if self._handles.get("", (None, None))[1] == seen:
            return
        self._handles[""] = (_Group(), seen)
        self._server.scene.set_up_direction("+" + "xyz"[camera.up_axis])
        initial = self._server.initial_camera
        initial.position, initial.look_at = tuple(camera.pos), tuple(camera.target)
        initial.up, initial.fov = tuple(camera.up), float(np.radians(FIELD_OF_VIEW))
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = tuple(camera.pos), tuple(camera.target)

    def _send_instances(self, name: str, item: Instances) -> None:
        mesh = self.scene.meshes[item.mesh]
        fixed = (
            len(mesh.points.values), mesh.indices.revision, item.local.revision, item.culled,
            item.scales.revision, item.colors.revision, item.hidden or not item.count,
        )  # fmt: skip
        now = (fixed, mesh.points.revision, item.poses.revision)
        handle, seen = self._handles.get(name, (None, (None, None, None)))
        if seen == now:
            return
        poses = compose(item.poses.values, item.local.values)
        if handle is None or seen[0] != fixed:
            if handle is not None:
                handle.remove()
            handle = self._add(name, item, poses)
        else:
            if seen[1] != now[1]:
                handle.reshape(mesh)
            if seen[2] != now[2]:
                handle.move(poses)
        self._handles[name] = (handle, now)

    def _add(self, name: str, item: Instances, poses: np.ndarray) -> Any:
        """Put instances on the page."""
        scene, mesh = self._server.scene, self.scene.meshes[item.mesh]
        group = _Group()
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
        # The shift of a capsule is no scale: those of one proportion share a mesh.
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
            self._let_pull(handle, name.removeprefix("/"), rows)
            group.parts.append((handle, rows))
            group.ratios.append(ratio)
        return group

    def _add_checker(self, name: str, contrast: float, color: np.ndarray, pose: np.ndarray) -> Any:
        """A checker of squares of 1 m: a picture, which no light of the page makes pale."""
        field = np.arange(2 * FIELDS)
        dark = (field[:, None] + field) % 2 == 1
        dark = dark.repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)[..., None]
        pixels = np.round(255.0 * color * np.where(dark, 1.0 - contrast, 1.0)).astype(np.uint8)
        return self._server.scene.add_image(
            _node(name), pixels, 2.0 * FIELDS, 2.0 * FIELDS, format="png",
            position=pose[:3], wxyz=_wxyz(pose[None])[0], cast_shadow=False,
        )  # fmt: skip

    def _let_pull(self, handle: Any, name: str, rows: np.ndarray) -> None:
        """Let the pointer, with control, pull what a handle shows of the model."""
        if not name.startswith("model/"):
            return

        def pull(event: Any) -> None:
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

        handle.on_drag("left", modifier="cmd/ctrl")(pull)

    def apply_forces(self, state: SimState) -> None:
        """Add the pull of a pointer to a state's particle_f or body_f."""
        with self._lock:
            self._drag.apply(state)

    def is_key_down(self, key: str | int) -> bool:
        """NotImplementedError: a page tells of no keys."""
        raise NotImplementedError("is_key_down: the page of ViewerViser tells of no keys")

    def _send_lines(self, name: str, item: Lines) -> None:
        seen = (
            item.starts.revision, item.ends.revision, item.colors.revision, item.hidden, item.width
        )  # fmt: skip
        handle, known = self._handles.get(name, (None, None))
        if known == seen:
            return
        if handle is not None:
            handle.remove()
        group = _Group()
        if item.count and not item.hidden:
            points = np.stack([item.starts.values, item.ends.values], axis=1)
            colors = _shades(item.colors.values)
            lines = self._server.scene.add_line_segments(
                _node(name), points, np.repeat(colors[:, None], 2, axis=1), thickness=item.width
            )
            group.parts.append((lines, None))
        self._handles[name] = (group, seen)

    def close(self) -> None:
        """Stop the server, and free the port."""
        if self._running:
            super().close()
            with _silence():
                self._server.stop()


class _PageSlider(Slider):
    """A slider of the page."""

    def show_on(self, gui: Any) -> None:
        """Put it into the panel."""
        step = (self.high - self.low) / 1000.0
        self.handle = gui.add_slider(self.name, self.low, self.high, step, self.value)
        self.handle.on_update(
            lambda event: Slider.set(self, self.handle.value) if event.client else None
        )

    def set(self, value: float) -> None:
        """Move it, on the page too."""
        super().set(value)
        self.handle.value = self.value


class _Group:
    """What an object is on the page: handles, each with the instances that it shows."""

    def __init__(self, parts: Sequence[tuple[Any, np.ndarray | None]] = ()) -> None:
        self.parts = list(parts)
        self.ratios: list[float] = []  # of the meshes of a part

    def reshape(self, mesh: Mesh) -> None:
        """Give the points of a mesh new places."""
        for (handle, _), ratio in zip(self.parts, self.ratios, strict=False):
            handle.vertices = _stretched(mesh, ratio)

    def move(self, poses: np.ndarray) -> None:
        """Give instances new poses."""
        for handle, rows in self.parts:
            if rows is None:
                handle.position, handle.wxyz = poses[0, :3], _wxyz(poses)[0]
            else:
                handle.batched_positions = poses[rows, :3]
                handle.batched_wxyzs = _wxyz(poses[rows])

    def remove(self) -> None:
        """Take them from the page."""
        for handle, _ in self.parts:
            handle.remove()


def _silence() -> contextlib.AbstractContextManager[Any]:
    """Keep viser from printing its own banner, and that it stopped."""
    return contextlib.redirect_stdout(io.StringIO())


def _node(name: str) -> str:
    """The name of an object's node: none is below another, which viser removes with it."""
    return "/" + name.removeprefix("/").replace("/", "|")


def _stretched(mesh: Mesh, ratio: float) -> np.ndarray:
    """The points of a mesh, its halves shifted along z."""
    return mesh.points.values + mesh.shift.values * f32([0.0, 0.0, ratio])


def _hairs(rows: np.ndarray) -> np.ndarray:
    """Factors {n, 1} of scales a hair below 1: surfaces of shapes that coincide do not fight."""
    return f32(1.0 - 1e-3 * (rows[:, None] % 8))


def _shades(colors: np.ndarray) -> np.ndarray:
    """Colours as uint8, darker, because the page's light from all sides makes them pale."""
    return np.round(255.0 * colors**DARKER).astype(np.uint8)


def _wxyz(poses: np.ndarray) -> np.ndarray:
    return poses[:, [6, 3, 4, 5]]


def _free_port(host: str, first: int) -> int:
    """The first port of some that nobody listens at."""
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
