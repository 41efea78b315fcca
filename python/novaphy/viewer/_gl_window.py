"""The window of ViewerGL: pyglet opens it and tells of keys and the pointer."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from .._core import SimState
from ._needs import MissingPackageError, needs

if TYPE_CHECKING:
    from ._gl import ViewerGL
    from ._gl_renderer import Renderer

DRAG_RATE = 6.0  # 1/s: the pull is that of a critically damped spring of this frequency
PICK_PIXELS = 40.0


class Window:
    """A window with an OpenGL context, and what its events do."""

    def __init__(self, viewer: ViewerGL, width: int, height: int, vsync: bool, title: str) -> None:
        """Open it. MissingPackageError without a display or without a package."""
        moderngl = needs("moderngl", "gl", "ViewerGL")
        pyglet = needs("pyglet", "gl", "a window of ViewerGL")
        if os.name == "posix" and not os.environ.get("DISPLAY"):
            raise MissingPackageError(
                "ViewerGL: there is no display to open a window on (DISPLAY is not set); "
                "headless=True draws without one"
            )
        pyglet.options["shadow_window"] = False
        try:
            config = pyglet.gl.Config(double_buffer=True, major_version=3, minor_version=3)
            self.window = pyglet.window.Window(
                width, height, title, resizable=True, vsync=vsync, config=config
            )
            self.context = moderngl.create_context(require=330)
        except Exception as error:
            raise MissingPackageError(
                f"ViewerGL: the display {os.environ.get('DISPLAY')} opens no window with "
                f"OpenGL 3.3 ({error})"
            ) from error
        self.viewer = viewer
        self.key = pyglet.window.key
        self.mouse = pyglet.window.mouse
        self.drag = Drag(viewer)
        self.followed: int | None = None
        self._held: set[int] = set()
        self.window.push_handlers(
            self.on_key_press, self.on_key_release, self.on_mouse_press, self.on_mouse_release,
            self.on_mouse_drag, self.on_mouse_scroll, self.on_close,
        )  # fmt: skip

    def show(self, renderer: Renderer) -> None:
        """Bring the picture to the screen and handle what happened since the last one."""
        self.window.switch_to()
        self.context.screen.use()
        screen = self.context.detect_framebuffer()  # its size now, which the user may have changed
        self.context.copy_framebuffer(screen, renderer.resolved)
        self.window.flip()
        self.window.dispatch_events()
        if not self.viewer.is_running():
            return
        renderer.resize(*self.window.get_framebuffer_size())
        if self.followed is not None:
            self.drag.look_at(self.followed)

    def close(self) -> None:
        """Close the window."""
        self.window.close()

    def is_key_down(self, key: str | int) -> bool:
        """Whether a key is held."""
        number = getattr(self.key, key.upper(), None) if isinstance(key, str) else key
        return number in self._held

    def on_close(self) -> bool:
        """End the viewer; the context stays until close()."""
        self.viewer._running = False
        return True

    def on_key_press(self, symbol: int, modifiers: int) -> bool:
        """Do what the key stands for."""
        self._held.add(symbol)
        viewer, key = self.viewer, self.key
        if symbol == key.SPACE:
            viewer.pause(not viewer.is_paused())
        elif symbol == key.N:
            viewer.pause()
            viewer.step_once()
        elif symbol == key.R:
            viewer.reset_requested = True
        elif symbol == key.H:
            viewer.show_text = not viewer.show_text
        elif symbol == key.J:
            viewer.show_joints = not viewer.show_joints
        elif symbol == key.E:
            viewer.show_energy = not viewer.show_energy
        elif symbol == key.P:
            viewer.save_picture(_free_name("novaphy", ".png"))
        elif symbol == key.F:
            self.followed = None if self.followed is not None else self.drag.nearest_to_middle()
        elif symbol == key.ESCAPE:
            return self.on_close()
        return True

    def on_key_release(self, symbol: int, modifiers: int) -> None:
        """Forget that the key is held."""
        self._held.discard(symbol)

    def on_mouse_press(self, x: int, y: int, button: int, modifiers: int) -> None:
        """With control, take hold of what is under the pointer."""
        if button == self.mouse.LEFT and modifiers & self.key.MOD_CTRL:
            self.drag.start(x, self.window.height - y, self.window.get_size())

    def on_mouse_release(self, x: int, y: int, button: int, modifiers: int) -> None:
        """Let go."""
        self.drag.stop()

    def on_mouse_drag(self, x: int, y: int, dx: int, dy: int, buttons: int, modifiers: int) -> None:
        """Pull what is held, or turn or move the camera."""
        camera, height = self.viewer.camera, self.window.height
        if self.drag.item is not None:
            self.drag.move(x, height - y, self.window.get_size())
        elif buttons & self.mouse.LEFT and not modifiers & self.key.MOD_SHIFT:
            camera.orbit(0.3 * dx, 0.3 * dy)
        else:
            camera.pan(dx / height, dy / height)

    def on_mouse_scroll(self, x: int, y: int, scroll_x: float, scroll_y: float) -> None:
        """Zoom."""
        self.viewer.camera.zoom(0.9**scroll_y)


class Drag:
    """A body or particle on a spring to the pointer."""

    def __init__(self, viewer: ViewerGL) -> None:
        """Hold nothing."""
        self.viewer = viewer
        self.item: tuple[str, int] | None = None
        self.goal = np.zeros(3)
        self.depth = 0.0

    def candidates(self) -> list[tuple[str, int, np.ndarray]]:
        """The bodies and particles of the last state: kind, number, place."""
        latest = self.viewer.latest_state
        out = [("body", k, row[:3]) for k, row in enumerate(latest.get("body_q", ()))]
        return out + [("particle", k, row) for k, row in enumerate(latest.get("particle_q", ()))]

    def pick(self, x: float, y: float, size: tuple[int, int]) -> tuple[str, int, np.ndarray] | None:
        """What is nearest to a pixel, within PICK_PIXELS."""
        found = self.candidates()
        if not found:
            return None
        camera = self.viewer.camera
        pixels = camera.project(np.array([place for _, _, place in found]), *size)
        away = np.linalg.norm(pixels - (x, y), axis=1)
        nearest = int(np.argmin(away))
        return found[nearest] if away[nearest] < PICK_PIXELS else None

    def start(self, x: float, y: float, size: tuple[int, int]) -> None:
        """Take hold of what is under a pixel."""
        found = self.pick(x, y, size)
        if found is not None:
            camera = self.viewer.camera
            self.item = found[:2]
            self.depth = float((found[2] - camera.pos) @ camera.forward)
            self.move(x, y, size)

    def move(self, x: float, y: float, size: tuple[int, int]) -> None:
        """Pull towards a pixel, as far away as what is held was."""
        camera = self.viewer.camera
        ray = camera.ray(x, y, *size)
        self.goal = camera.pos + ray * (self.depth / (ray @ camera.forward))

    def stop(self) -> None:
        """Let go."""
        self.item = None

    def nearest_to_middle(self) -> int | None:
        """The candidate nearest to the middle of the picture."""
        found = self.candidates()
        if not found:
            return None
        target = self.viewer.camera.target
        return int(np.argmin([np.linalg.norm(place - target) for _, _, place in found]))

    def look_at(self, number: int) -> None:
        """Keep a candidate in the middle."""
        found = self.candidates()
        if number < len(found):
            self.viewer.camera.target = np.asarray(found[number][2], np.float64)

    def apply(self, state: SimState) -> None:
        """Add m (w² (goal - x) - 2 w v) to the forces of what is held, w = DRAG_RATE."""
        model = self.viewer.model
        if self.item is None or model is None:
            return
        kind, k = self.item
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


def _free_name(stem: str, ending: str) -> str:
    number = 1
    while os.path.exists(f"{stem}-{number}{ending}"):
        number += 1
    return f"{stem}-{number}{ending}"
