"""The window of ViewerGL: pyglet opens it and reports keys and the pointer."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

from ._drag import Drag
from ._gl_panel import Panel, imgui_module
from ._needs import MissingPackageError, needs

if TYPE_CHECKING:
    from ._gl import ViewerGL
    from ._gl_renderer import Renderer

NAME_RATE = 10.0  # searches per second for the object under the pointer
SLIDER_STEPS = 100.0  # number of arrow key presses that move a slider from end to end


class Window:
    """A window with an OpenGL context and its event handlers."""

    def __init__(self, viewer: ViewerGL, width: int, height: int, vsync: bool, title: str) -> None:
        """Open the window. MissingPackageError: the display or a package is missing."""
        moderngl = needs("moderngl", "gl", "ViewerGL")
        pyglet = needs("pyglet", "gl", "a window of ViewerGL")
        if os.name == "posix" and not os.environ.get("DISPLAY"):
            raise MissingPackageError(
                "ViewerGL: there is no display to open a window on (DISPLAY is not set); "
                "headless=True draws without one"
            )
        pyglet.options["shadow_window"] = False
        pyglet.options["debug_gl"] = False  # True: check for OpenGL errors after every call
        try:
            config = pyglet.gl.Config(double_buffer=True, major_version=3, minor_version=3)
            self.window = pyglet.window.Window(
                width, height, title, resizable=True, vsync=vsync, config=config
            )
            self.context = moderngl.create_context(require=330)
        except Exception as error:
            # pyglet raises ImportError or AttributeError if it does not find a library.
            missing = isinstance(error, (ImportError, AttributeError))
            hint = ": apt-get install libgl1 libgl1-mesa-dri libxrender1" if missing else ""
            raise MissingPackageError(
                f"ViewerGL: the display {os.environ.get('DISPLAY')} opens no window with "
                f"OpenGL 3.3 ({error}){hint}"
            ) from error
        self.viewer = viewer
        self.key = pyglet.window.key
        self.mouse = pyglet.window.mouse
        self.drag = Drag(viewer)
        self.followed: int | None = None
        self._pointer: tuple[int, int] | None = None
        self._name: str | None = None  # name of the object under the pointer
        self._looked_at = 0.0
        self._held: set[int] = set()
        self._gl = pyglet.gl
        self._shown = False
        self._fence: Any = None  # OpenGL fence, signaled when the submitted image is drawn
        self.window.push_handlers(
            self.on_key_press, self.on_key_release, self.on_mouse_press, self.on_mouse_release,
            self.on_mouse_drag, self.on_mouse_scroll, self.on_mouse_motion, self.on_mouse_leave,
            self.on_close,
        )  # fmt: skip
        imgui = imgui_module()
        self.panel = None if imgui is None else Panel(viewer, self.window, self.context, imgui)

    @property
    def is_drawing(self) -> bool:
        """Whether a submitted image is not on the screen yet."""
        return self._fence is not None

    def start(self) -> None:
        """Insert a fence after the commands of an image, which the GPU draws in the background."""
        self._fence = self._gl.glFenceSync(self._gl.GL_SYNC_GPU_COMMANDS_COMPLETE, 0)
        self._gl.glFlush()

    def show_finished(self, renderer: Renderer, wait: bool = False, grace: float = 0.0) -> None:
        """Show the submitted image on the screen, and handle events.

        If the image is not ready after `grace` (s), the call returns. With `wait` it waits.
        """
        if self._fence is None:
            return
        gl = self._gl
        passed = (gl.GL_ALREADY_SIGNALED, gl.GL_CONDITION_SATISFIED)
        wait = wait or not self._shown
        timeout = 10**9 if wait else int(1e9 * grace)  # ns
        while gl.glClientWaitSync(self._fence, 0, timeout) not in passed:
            if not wait:
                return
        gl.glDeleteSync(self._fence)
        self._fence, self._shown = None, True
        self._show(renderer)

    def _show(self, renderer: Renderer) -> None:
        self.window.switch_to()
        self.context.screen.use()
        screen = self.context.detect_framebuffer()  # the user may have changed the window's size
        self.context.copy_framebuffer(screen, renderer.resolved)
        if self.panel is not None:
            screen.use()
            self.panel.draw()
        self.window.flip()
        self.window.dispatch_events()
        if not self.viewer.is_running():
            return
        renderer.resize(*self.window.get_framebuffer_size())
        if self.followed is not None:
            self.drag.look_at(self.followed)

    def close(self) -> None:
        """Close the window."""
        if self._fence is not None:
            self._gl.glDeleteSync(self._fence)
            self._fence = None
        if self.panel is not None:
            self.panel.close()
        self.window.close()

    def is_key_down(self, key: str | int) -> bool:
        """Return whether a key is pressed."""
        number = getattr(self.key, key.upper(), None) if isinstance(key, str) else key
        return number in self._held

    def name_under_pointer(self) -> str | None:
        """Return the names of the shape and the body under the pointer."""
        now = time.perf_counter()
        if self._pointer is None:
            self._name = None
        elif now - self._looked_at > 1.0 / NAME_RATE:
            camera = self.viewer.camera
            ray = camera.ray(*self._pointer, *self.window.get_size())
            self._name, self._looked_at = self.viewer.name_at(camera.pos, ray), now
        return self._name

    def on_mouse_motion(self, x: int, y: int, dx: int, dy: int) -> None:
        """Store the position of the pointer."""
        self._pointer = x, self.window.height - y

    def on_mouse_leave(self, x: int, y: int) -> None:
        """Clear the position of the pointer."""
        self._pointer = None

    def on_close(self) -> bool:
        """Stop the viewer; the context stays until close()."""
        self.viewer._running = False
        return True

    def on_key_press(self, symbol: int, modifiers: int) -> bool:
        """Run the action of a key."""
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
        elif symbol == key.I:
            viewer.show_inertia = not viewer.show_inertia
        elif symbol == key.C:
            viewer.show_contacts = not viewer.show_contacts
        elif symbol == key.E:
            viewer.show_energy = not viewer.show_energy
        elif symbol == key.P:
            viewer.save_picture(_free_name("novaphy", ".png"))
        elif symbol == key.F:
            follows = self.followed is not None or viewer.follows
            self.followed = None if follows else self.drag.nearest_to_middle()
            viewer.follow(None)
        elif symbol == key.TAB and viewer.sliders:
            viewer.slider = (
                0 if viewer.slider is None else (viewer.slider + 1) % len(viewer.sliders)
            )
        elif symbol in (key.LEFT, key.RIGHT) and viewer.sliders:
            slider = viewer.sliders[viewer.slider or 0]
            step = (slider.high - slider.low) / SLIDER_STEPS
            slider.set(slider.value + (step if symbol == key.RIGHT else -step))
        elif symbol == key.ESCAPE:
            return self.on_close()
        return True

    def on_key_release(self, symbol: int, modifiers: int) -> None:
        """Mark the key as released."""
        self._held.discard(symbol)

    def on_mouse_press(self, x: int, y: int, button: int, modifiers: int) -> None:
        """Select a step of the time axis; with control, start dragging an object."""
        scale = self.window.get_framebuffer_size()[0] / max(self.window.width, 1)
        if button == self.mouse.LEFT and self.viewer.select_step_at(
            scale * x, scale * (self.window.height - y)
        ):
            return
        if button == self.mouse.LEFT and modifiers & self.key.MOD_CTRL:
            self.drag.start(x, self.window.height - y, self.window.get_size())

    def on_mouse_release(self, x: int, y: int, button: int, modifiers: int) -> None:
        """Stop dragging."""
        self.drag.stop()

    def on_mouse_drag(self, x: int, y: int, dx: int, dy: int, buttons: int, modifiers: int) -> None:
        """Pull the dragged object, or rotate or move the camera."""
        camera, height = self.viewer.camera, self.window.height
        if self.drag.item is not None:
            self.drag.move(x, height - y, self.window.get_size())
        elif buttons & self.mouse.LEFT and not modifiers & self.key.MOD_SHIFT:
            camera.orbit(0.3 * dx, 0.3 * dy)
        else:
            camera.pan(dx / height, dy / height)

    def on_mouse_scroll(self, x: int, y: int, scroll_x: float, scroll_y: float) -> None:
        """Zoom the camera."""
        self.viewer.camera.zoom(0.9**scroll_y)


def _free_name(stem: str, ending: str) -> str:
    number = 1
    while os.path.exists(f"{stem}-{number}{ending}"):
        number += 1
    return f"{stem}-{number}{ending}"
