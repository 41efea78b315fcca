"""The panel of ViewerGL with switches and sliders, by imgui-bundle and drawn with moderngl."""

from __future__ import annotations

import ctypes
import importlib
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._gl import ViewerGL

WIDTH, MARGIN = 250.0, 10.0  # pixels

_VERTEX = """
#version 330
in vec2 place; in vec2 uv; in vec4 color;
uniform vec2 size;
out vec2 at; out vec4 tint;
void main() {
  at = uv; tint = color;
  gl_Position = vec4(2.0 * place.x / size.x - 1.0, 1.0 - 2.0 * place.y / size.y, 0.0, 1.0);
}
"""
_FRAGMENT = """
#version 330
in vec2 at; in vec4 tint;
uniform sampler2D image;
out vec4 pixel;
void main() { pixel = tint * texture(image, at); }
"""


def imgui_module() -> Any:
    """Return the module imgui, or None if imgui-bundle is not installed."""
    try:
        return importlib.import_module("imgui_bundle").imgui
    except ImportError:
        return None


class Panel:
    """A panel with pause, step, reset, visibility switches, and the sliders of add_slider."""

    def __init__(self, viewer: ViewerGL, window: Any, context: Any, imgui: Any) -> None:
        """Attach the panel to a pyglet window with a moderngl context."""
        self.viewer, self.window, self.context, self.imgui = viewer, window, context, imgui
        self._mine = imgui.create_context()
        imgui.set_current_context(self._mine)
        self.io = imgui.get_io()
        self.io.set_ini_filename("")
        self.io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        imgui.style_colors_light()
        self._program = context.program(_VERTEX, _FRAGMENT)
        self._vertices = context.buffer(reserve=1 << 16, dynamic=True)
        self._indices = context.buffer(reserve=1 << 16, dynamic=True)
        self._array: Any = None
        self._textures: dict[int, Any] = {}
        self._drawn_at = time.perf_counter()
        window.push_handlers(
            self.on_mouse_motion, self.on_mouse_press, self.on_mouse_release,
            self.on_mouse_drag, self.on_mouse_scroll,
        )  # fmt: skip

    def on_mouse_motion(self, x: int, y: int, dx: int, dy: int) -> bool:
        """Pass the pointer's position to imgui; return whether the panel uses it."""
        self.imgui.set_current_context(self._mine)
        self.io.add_mouse_pos_event(float(x), float(self.window.height - y))
        return bool(self.io.want_capture_mouse)

    def on_mouse_press(self, x: int, y: int, button: int, modifiers: int) -> bool:
        """Pass a button press to imgui; return whether the panel uses it."""
        captured = self.on_mouse_motion(x, y, 0, 0)
        self.io.add_mouse_button_event({1: 0, 4: 1, 2: 2}.get(button, 0), True)
        return captured

    def on_mouse_release(self, x: int, y: int, button: int, modifiers: int) -> bool:
        """Pass a button release to imgui; return whether the panel uses it."""
        captured = self.on_mouse_motion(x, y, 0, 0)
        self.io.add_mouse_button_event({1: 0, 4: 1, 2: 2}.get(button, 0), False)
        return captured

    def on_mouse_drag(self, x: int, y: int, dx: int, dy: int, buttons: int, modifiers: int) -> bool:
        """Pass a drag to imgui; return whether the panel uses it."""
        return self.on_mouse_motion(x, y, dx, dy)

    def on_mouse_scroll(self, x: int, y: int, scroll_x: float, scroll_y: float) -> bool:
        """Pass a scroll to imgui; return whether the panel uses it."""
        captured = self.on_mouse_motion(x, y, 0, 0)
        self.io.add_mouse_wheel_event(float(scroll_x), float(scroll_y))
        return captured

    def draw(self) -> None:
        """Draw the panel and apply the user's input."""
        imgui, io = self.imgui, self.io
        imgui.set_current_context(self._mine)
        now = time.perf_counter()
        io.delta_time, self._drawn_at = max(now - self._drawn_at, 1e-4), now
        io.display_size = self.window.get_size()
        imgui.new_frame()
        self._build()
        imgui.render()
        self._render(imgui.get_draw_data())

    def _build(self) -> None:
        imgui, viewer = self.imgui, self.viewer
        width = self.window.width
        corner, first = (width - MARGIN, MARGIN), imgui.Cond_.first_use_ever
        imgui.set_next_window_pos(corner, first, (1.0, 0.0))  # pivot: the upper right corner
        imgui.set_next_window_size((WIDTH, 0.0), first)
        # A panel that is higher than the window gets a scroll bar.
        most = (float(width), max(self.window.height - 2.0 * MARGIN, MARGIN))
        imgui.set_next_window_size_constraints((WIDTH, 0.0), most)
        imgui.begin("NovaPhy", None, imgui.WindowFlags_.always_auto_resize)
        changed, paused = imgui.checkbox("pause", viewer.is_paused())
        if changed:
            viewer.pause(paused)
        imgui.same_line()
        if imgui.button("step"):
            viewer.pause()
            viewer.step_once()
        imgui.same_line()
        if imgui.button("reset"):
            viewer.reset_requested = True
        for k, what in enumerate(("text", "energy", "joints", "inertia", "contacts")):
            if k % 3:
                imgui.same_line(0.34 * WIDTH * (k % 3))
            changed, on = imgui.checkbox(what, getattr(viewer, f"show_{what}"))
            if changed:
                setattr(viewer, f"show_{what}", on)
        for slider in viewer.sliders:
            imgui.set_next_item_width(0.55 * WIDTH)
            moved, value = imgui.slider_float(slider.name, slider.value, slider.low, slider.high)
            if moved:
                slider.set(value)
        imgui.end()

    def _render(self, data: Any) -> None:
        imgui, context = self.imgui, self.context
        for texture in imgui.get_platform_io().textures:
            self._follow(texture)
        scale = self.window.get_framebuffer_size()[0] / max(self.window.width, 1)
        height = self.window.get_framebuffer_size()[1]
        context.disable(context.DEPTH_TEST | context.CULL_FACE)
        context.enable(context.BLEND)
        self._program["size"].value = tuple(map(float, self.window.get_size()))
        for commands in data.cmd_lists:
            self._upload("_vertices", commands.vtx_buffer, imgui.VERTEX_SIZE)
            self._upload("_indices", commands.idx_buffer, imgui.INDEX_SIZE)
            if self._array is None:
                self._array = context.vertex_array(
                    self._program, [(self._vertices, "2f 2f 4f1", "place", "uv", "color")],
                    self._indices, index_element_size=imgui.INDEX_SIZE,
                )  # fmt: skip
            for command in commands.cmd_buffer:
                x, y, right, bottom = (scale * v for v in command.clip_rect)
                context.scissor = int(x), int(height - bottom), int(right - x), int(bottom - y)
                self._textures[command.tex_ref.get_tex_id()].use(0)
                self._array.render(
                    context.TRIANGLES, vertices=command.elem_count, first=command.idx_offset
                )
        context.scissor = None
        context.disable(context.BLEND)

    def _upload(self, name: str, source: Any, width: int) -> None:
        """Write vertices or indices into the buffer of this name. A small buffer is replaced."""
        size = source.size() * width
        buffer = getattr(self, name)
        if size > buffer.size:
            if self._array is not None:
                self._array.release()
                self._array = None
            buffer.release()
            buffer = self.context.buffer(reserve=2 * size, dynamic=True)
            setattr(self, name, buffer)
        if size:
            buffer.orphan()
            buffer.write(ctypes.string_at(source.data_address(), size))

    def _follow(self, texture: Any) -> None:
        """Create, update or destroy a texture as imgui requests."""
        status = self.imgui.ImTextureStatus
        if texture.status in (status.want_create, status.want_updates):
            made = self._textures.get(texture.tex_id)
            if made is None:
                made = self.context.texture((texture.width, texture.height), 4)
                self._textures[made.glo] = made
                texture.set_tex_id(made.glo)
            made.write(texture.get_pixels_array().tobytes())
            texture.status = status.ok
        elif texture.status == status.want_destroy:
            self._textures.pop(texture.tex_id).release()
            texture.set_tex_id(0)
            texture.status = status.destroyed

    def close(self) -> None:
        """Release all resources."""
        self.imgui.set_current_context(self._mine)
        for texture in self.imgui.get_platform_io().textures:
            texture.status = self.imgui.ImTextureStatus.destroyed
            texture.set_tex_id(0)
        for texture in self._textures.values():
            texture.release()
        if self._array is not None:
            self._array.release()
        self._vertices.release()
        self._indices.release()
        self._program.release()
        self.imgui.destroy_context(self._mine)
