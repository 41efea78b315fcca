"""Draws a scene with moderngl, with one draw call for all copies of a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import _shaders
from ._camera import FIELD_OF_VIEW, Camera
from ._overlay import BOX
from ._scene import Instances, Lines, Mesh, Part, Scene, f32

HAZE = (0.93, 0.945, 0.96)
LIGHT = (0.35, -0.45, 1.0)  # direction towards the light; the third number is along the up axis
SHADOW_SIZE = 2048
REACH = 9.0  # distance of full haze, in units of the camera's distance to its target


class Renderer:
    """Shader programs, and GPU buffers that follow the objects of a scene."""

    def __init__(self, context: Any, samples: int) -> None:
        """Compile the shader programs."""
        self.context = context
        self.samples = samples
        self.draw_calls = 0
        self._meshes: dict[str, _Buffers] = {}
        self._items: dict[str, _Drawable] = {}
        self._lines: dict[str, _Drawable] = {}
        header = _shaders.GL_HEADER
        program = context.program
        vertex = header + _shaders.MESH_VERTEX
        self.mesh_program = program(vertex, header + _shaders.MESH_FRAGMENT)
        self.depth_program = program(vertex, header + _shaders.DEPTH_FRAGMENT)
        self.line_program = program(header + _shaders.LINE_VERTEX, header + _shaders.LINE_FRAGMENT)
        self.overlay_program = program(
            header + _shaders.OVERLAY_VERTEX, header + _shaders.OVERLAY_FRAGMENT
        )
        quad = f32([(0, -1), (0, 1), (1, -1), (1, 1)])
        self.line_quad = context.buffer(quad.tobytes())
        square = context.buffer(f32([(0, 0), (1, 0), (0, 1), (1, 1)]).tobytes())
        self.overlay_array = context.vertex_array(self.overlay_program, square, "corner")
        self.overlay_texture: Any = None
        self.shadow = context.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self.shadow.compare_func, self.shadow.repeat_x, self.shadow.repeat_y = "<=", False, False
        self.shadow_target = context.framebuffer(depth_attachment=self.shadow)
        self.target: Any = None
        self.resolved: Any = None

    def resize(self, width: int, height: int) -> None:
        """Set the size of later images."""
        if self.target is not None and self.target.size == (width, height):
            return
        self._release_targets()
        make, size = self.context.renderbuffer, (width, height)
        self.target = self.context.framebuffer(
            [make(size, 4, samples=self.samples)],
            self.context.depth_renderbuffer(size, samples=self.samples),
        )
        self.resolved = self.context.framebuffer([make(size, 4)])

    def draw(self, scene: Scene, camera: Camera, box: np.ndarray | None) -> None:
        """Draw the scene into the framebuffer `resolved`, with a text box {h, w, 4} on top."""
        self.draw_calls = 0
        self._follow(scene)
        light = _light(camera.up_axis)
        shadow = _shadow_projection(camera, light)
        context = self.context
        context.enable(context.DEPTH_TEST)
        self.shadow_target.use()
        self.shadow_target.clear(depth=1.0)
        _set(self.depth_program, view_projection=_columns(shadow))
        for name, item in scene.instances.items():
            if _is_drawn(item) and item.mesh != "plane":
                self._render(self._items[name].shadow, item.count)
        self.target.use()
        self.target.clear(*HAZE, 1.0, depth=1.0)
        width, height = self.target.size
        view = _columns(camera.view_projection(width / height))
        self.shadow.use(0)
        _set(
            self.mesh_program,
            view_projection=view, light_projection=_columns(shadow),
            eye=camera.pos, target=camera.target, light=light, up=camera.up, haze=HAZE,
            cell=cell_size(camera.distance), reach=REACH * camera.distance, shadow_map=0,
        )  # fmt: skip
        for name, item in scene.instances.items():
            if _is_drawn(item):
                (context.enable if item.culled else context.disable)(context.CULL_FACE)
                self._render(self._items[name].array, item.count)
        context.disable(context.CULL_FACE)
        angle = 2.0 * np.tan(np.radians(FIELD_OF_VIEW / 2)) / height
        _set(self.line_program, view_projection=view, eye=camera.pos, pixel_angle=angle)
        for name, lines in scene.lines.items():
            if _is_drawn(lines):
                _set(self.line_program, width=lines.width)
                self._render(self._lines[name].array, lines.count)
        if box is not None:
            self._draw_overlay(box)
        context.copy_framebuffer(self.resolved, self.target)

    def read(self) -> np.ndarray:
        """Return the image {h, w, 3}, uint8, with the top row first."""
        width, height = self.resolved.size
        data = self.resolved.read(components=3, alignment=1)
        rows = np.frombuffer(data, np.uint8).reshape(height, width, 3)
        return np.ascontiguousarray(rows[::-1])

    def release(self) -> None:
        """Release the buffers."""
        for group in (self._items, self._lines, self._meshes):
            for drawable in group.values():
                drawable.release()
            group.clear()
        self._release_targets()
        self.shadow_target.release()
        self.shadow.release()

    def _release_targets(self) -> None:
        for old in (self.target, self.resolved):
            if old is not None:
                for attachment in (*old.color_attachments, old.depth_attachment):
                    if attachment is not None:
                        attachment.release()
                old.release()

    def _render(self, array: Any, count: int) -> None:
        array.render(self._mode(array), instances=count)
        self.draw_calls += 1

    def _mode(self, array: Any) -> int:
        lines = array.program is self.line_program
        return int(self.context.TRIANGLE_STRIP if lines else self.context.TRIANGLES)

    def _draw_overlay(self, box: np.ndarray) -> None:
        context, (height, width) = self.context, box.shape[:2]
        if self.overlay_texture is None or self.overlay_texture.size != (width, height):
            if self.overlay_texture is not None:
                self.overlay_texture.release()
            self.overlay_texture = context.texture((width, height), 4)
            self.overlay_texture.filter = (context.NEAREST, context.NEAREST)
        self.overlay_texture.write(box)
        self.overlay_texture.use(0)
        full_width, full_height = self.target.size
        w, h = 2.0 * width / full_width, 2.0 * height / full_height
        x, y = -1.0 + 2.0 * BOX / full_width, 1.0 - 2.0 * BOX / full_height - h
        _set(self.overlay_program, place=(x, y, w, h), image=0)
        context.disable(context.DEPTH_TEST)
        context.enable(context.BLEND)
        self.overlay_array.render(context.TRIANGLE_STRIP)
        context.disable(context.BLEND)
        self.draw_calls += 1

    def _follow(self, scene: Scene) -> None:
        """Upload the arrays of the scene whose revision changed."""
        for group, items in (
            (self._items, scene.instances),
            (self._lines, scene.lines),
            (self._meshes, scene.meshes),
        ):
            for name in [name for name in group if name not in items]:
                group.pop(name).release()
        for name, item in scene.instances.items():
            if _is_drawn(item):
                self._follow_instances(name, item, scene.meshes[item.mesh])
        for name, lines in scene.lines.items():
            if _is_drawn(lines):
                self._follow_lines(name, lines)

    def _follow_instances(self, name: str, item: Instances, mesh: Mesh) -> None:
        shape = self._meshes.setdefault(item.mesh, _Buffers(self.context, Mesh.fields))
        drawable = self._items.setdefault(name, _Drawable(self.context, Instances.fields))
        remade = shape.follow(mesh) | drawable.buffers.follow(item)
        if not remade and drawable.array is not None and drawable.of is shape:
            return
        drawable.forget_arrays()
        drawable.of = shape
        content = [
            (shape["points"], "3f", "position"),
            (shape["normals"], "3f", "normal"),
            (shape["shift"], "1f", "shift"),
            (drawable.buffers["poses"], "3f 4f/i", "body_p", "body_q"),
            (drawable.buffers["local"], "3f 4f/i", "local_p", "local_q"),
            (drawable.buffers["scales"], "4f/i", "scale"),
            (drawable.buffers["colors"], "4f/i", "color"),
        ]
        make = self.context.vertex_array
        drawable.array = make(self.mesh_program, content, shape["indices"], skip_errors=True)
        drawable.shadow = make(self.depth_program, content, shape["indices"], skip_errors=True)

    def _follow_lines(self, name: str, lines: Lines) -> None:
        drawable = self._lines.setdefault(name, _Drawable(self.context, Lines.fields))
        if not drawable.buffers.follow(lines) and drawable.array is not None:
            return
        drawable.forget_arrays()
        content = [
            (self.line_quad, "2f", "corner"),
            (drawable.buffers["starts"], "3f/i", "start"),
            (drawable.buffers["ends"], "3f/i", "end"),
            (drawable.buffers["colors"], "3f/i", "color"),
        ]
        drawable.array = self.context.vertex_array(self.line_program, content)


class _Buffers:
    """The arrays of an object on the GPU."""

    def __init__(self, context: Any, fields: tuple[str, ...]) -> None:
        self.context = context
        self.fields = fields
        self.buffers: dict[str, Any] = {}
        self.revisions: dict[str, int] = {}

    def __getitem__(self, field: str) -> Any:
        return self.buffers[field]

    def follow(self, item: object) -> bool:
        """Upload the changed arrays of an object; return whether a buffer was replaced."""
        remade = False
        for field in self.fields:
            part: Part = getattr(item, field)
            if self.revisions.get(field) == part.revision:
                continue
            self.revisions[field] = part.revision
            buffer = self.buffers.get(field)
            if buffer is None or buffer.size != part.values.nbytes:
                if buffer is not None:
                    buffer.release()
                self.buffers[field] = self.context.buffer(part.values)
                remade = True
            else:
                buffer.write(part.values)
        return remade

    def release(self) -> None:
        """Release the buffers."""
        for buffer in self.buffers.values():
            buffer.release()


class _Drawable:
    """Buffers, and the vertex arrays that draw from them."""

    def __init__(self, context: Any, fields: tuple[str, ...]) -> None:
        self.buffers = _Buffers(context, fields)
        self.of: _Buffers | None = None
        self.array: Any = None
        self.shadow: Any = None

    def forget_arrays(self) -> None:
        """Release the vertex arrays."""
        for array in (self.array, self.shadow):
            if array is not None:
                array.release()
        self.array = self.shadow = None

    def release(self) -> None:
        """Release all resources."""
        self.forget_arrays()
        self.buffers.release()


def cell_size(distance: float) -> float:
    """Return the size of the ground's checker squares (m), a power of ten, for a distance (m)."""
    return float(10.0 ** np.floor(np.log10(distance / 2.0)))


def _is_drawn(item: Instances | Lines) -> bool:
    return not item.hidden and item.count > 0


def _set(program: Any, **values: Any) -> None:
    """Set uniforms, except those that the compiler removed."""
    for name, value in values.items():
        if name in program:
            if isinstance(value, bytes):
                program[name].write(value)
            else:
                program[name].value = (
                    value if np.isscalar(value) else tuple(float(v) for v in value)
                )


def _columns(matrix: np.ndarray) -> bytes:
    return np.ascontiguousarray(matrix.T, np.float32).tobytes()


def _light(up_axis: int) -> np.ndarray:
    light = np.zeros(3)
    light[(up_axis + 1) % 3], light[(up_axis + 2) % 3], light[up_axis] = LIGHT
    return light / np.linalg.norm(light)


def _shadow_projection(camera: Camera, light: np.ndarray) -> np.ndarray:
    """Return the matrix {4, 4} from world to the clip coordinates of the shadow map.

    The map is centered at the camera's target.
    """
    side = np.cross(camera.up, light)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(light, side), light])
    reach = camera.distance
    # The center is rounded to whole texels, so that shadows do not flicker as the camera moves.
    texel = 2.0 * reach / SHADOW_SIZE
    center = np.round(axes @ camera.target / texel) * texel
    matrix = np.eye(4)
    matrix[:3, :3] = axes / reach
    matrix[:3, 3] = -center / reach
    matrix[2] *= -0.25  # the map is four times as deep as wide; depth grows away from the light
    return matrix
