"""The base class of viewers that draw: log_* calls become objects of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .._core import Contacts, Model, SimState
from ._base import ArrayLike, Viewer
from ._camera import Camera
from ._model_scene import (
    ModelScene,
    draw_contacts,
    energy,
    model_arrays,
    shape_name,
    shape_scales,
)
from ._primitives import add_primitive
from ._scene import GRAY, IDENTITY, Scene, as_array, f32, per_row, turns_of_z

HISTORY = 2000  # number of last values of a scalar that its curve shows
SHOWN_SCALARS = 6
ARROW_HEAD = 4.0  # size of an arrow's head in line widths


class SceneViewer(Viewer):
    """Keeps a scene and a camera; a derived viewer shows them in end_frame.

    Attributes:
        show_joints: whether the axes of joints are drawn.
        show_inertia: whether a box of equal mass and inertia is drawn for each body.
        show_energy: whether the energy is computed and shown.
        show_contacts: whether the contacts of log_contacts are drawn.
    """

    def __init__(self) -> None:
        """Start with an empty scene."""
        super().__init__()
        self.scene = Scene()
        self.camera = Camera()
        self._model_scene: ModelScene | None = None
        self._offsets = np.zeros(3, np.float32)
        self.latest_state: Mapping[str, np.ndarray] = {}
        self.show_joints = self.show_inertia = self.show_energy = False
        self.show_contacts = True
        self._energy: float | None = None
        self._steps_wanted = 0
        self._followed: int | None = None
        self._followed_at: np.ndarray | None = None

    def step_once(self) -> None:
        """Allow one more step while the simulation is paused."""
        self._steps_wanted += 1

    def should_step(self) -> bool:
        """Return whether the simulation should advance: not paused, or a step was requested."""
        if not self._paused:
            return True
        if self._steps_wanted:
            self._steps_wanted -= 1
            return True
        return False

    def set_model(self, model: Model) -> None:
        """Show the shapes, particles, surfaces and springs of a model."""
        super().set_model(model)
        self.set_model_arrays(model_arrays(model), model.up_axis)
        self.log_state_arrays(
            {"body_q": model.body_q.numpy(), "particle_q": model.particle_q.numpy()}
        )

    def set_model_arrays(self, arrays: Mapping[str, np.ndarray], up_axis: int) -> None:
        """Show a model given by its arrays, keyed by field, as in a recording."""
        self.scene.up_axis = self.camera.up_axis = int(up_axis)
        self._model_scene = ModelScene(self.scene, arrays)
        self._model_scene.offsets = self._offsets

    def set_camera(
        self, pos: ArrayLike, pitch: float | None = None, yaw: float | None = None
    ) -> None:
        """Place the camera at `pos` (m), looking along pitch and yaw (degrees).

        Without angles the camera keeps its target.
        """
        self.camera.place(np.asarray(pos, np.float64), pitch, yaw)

    def look_at(self, pos: ArrayLike, target: ArrayLike) -> None:
        """Place the camera at `pos`, looking at `target` (m)."""
        self.camera.target = np.asarray(target, np.float64)
        self.camera.place(np.asarray(pos, np.float64), None, None)

    def follow(self, body: int | None) -> None:
        """Make the camera track a body of the model horizontally; None: stop tracking.

        The camera moves with the body from the next state on. The user may rotate it meanwhile.
        """
        self._followed, self._followed_at = body, None

    @property
    def follows(self) -> bool:
        """Whether the camera tracks a body."""
        return self._followed is not None

    def _go_along(self) -> None:
        rows = self.latest_state.get("body_q", ())
        if self._followed is None or not 0 <= self._followed < len(rows):
            return
        place = np.asarray(rows[self._followed][:3], np.float64) * (1.0 - self.camera.up)
        if not np.isfinite(place).all():
            return
        if self._followed_at is not None:
            self.camera.target = self.camera.target + (place - self._followed_at)
        self._followed_at = place

    def set_world_offsets(self, spacing: ArrayLike) -> None:
        """Show world k of a model displaced by k times `spacing` (m)."""
        self._offsets = as_array(spacing, 3, "set_world_offsets, spacing")[0]
        if self._model_scene is not None:
            self._model_scene.offsets = self._offsets

    def set_shape_colors(self, shapes: ArrayLike, colors: ArrayLike) -> None:
        """Set the colors {n, 3} of shapes {n} (indices); all other shapes get their default colors.

        In colors {n, 4} the fourth number is the contrast of a checker pattern (0 to 1; 0: no
        pattern). ValueError: a shape does not exist, or no model is set.
        """
        if self._model_scene is None:
            raise ValueError("set_shape_colors: expected a model before, got none: call set_model")
        numbers = as_array(shapes, 1, "set_shape_colors, shapes", np.int32).ravel()
        width = 4 if np.shape(colors)[-1:] == (4,) else 3
        rows = per_row(colors, len(numbers), width, GRAY, "set_shape_colors, colors")
        self._model_scene.color_shapes(numbers, np.pad(rows, ((0, 0), (0, 4 - width))))

    def begin_frame(self, t: float) -> None:
        """Start a frame at time `t` (s)."""
        super().begin_frame(t)
        self.scene.time = self.time

    def log_state(self, state: SimState) -> None:
        """Show a state of the model. ValueError: no model is set."""
        names = ["body_q", "particle_q"]
        if self.show_energy:
            names += ["body_qd", "particle_qd"]
        # NumPy reads arrays of the CPU in place. Arrays of devices are copied.
        fields = {name: getattr(state, name) for name in names}
        self.log_state_arrays({k: a.numpy(copy=not a.device.is_cpu) for k, a in fields.items()})

    def log_state_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Show a state given by its arrays, keyed by field, as in a recording."""
        if self._model_scene is None:
            raise ValueError("log_state: expected a model before, got none: call set_model")
        self.latest_state = {name: rows for name, rows in arrays.items() if len(rows)}
        self._model_scene.show_joints = self.show_joints
        self._model_scene.show_inertia = self.show_inertia
        self._model_scene.update(self.latest_state)
        self._go_along()
        self._energy = None
        if self.show_energy and {"body_qd", "particle_qd"} & self.latest_state.keys():
            self._energy = energy(self._model_scene.arrays, self.latest_state)

    def texts(self, paused: bool = False) -> list[str]:
        """Return the lines of text: the time, the energy and the latest scalars."""
        lines = [f"time {self.scene.time:.3f} s" + ("   paused" if paused else "")]
        if self._energy is not None:
            lines.append(f"energy {self._energy:.6g} J")
        scalars = list(self.scene.scalars.items())[:SHOWN_SCALARS]
        return lines + [f"{name} {values[-1]:.6g}" for name, values in scalars if values]

    def log_contacts(self, contacts: Contacts, state: SimState) -> None:
        """Show each contact of a state as a point and an arrow: the force, or else the normal."""
        if self._model_scene is None:
            raise ValueError("log_contacts: expected a model before, got none: call set_model")
        if not self.show_contacts:
            self.log_points("contacts/points", None)
            self.log_arrows("contacts/arrows", None, None, None)
            return
        draw_contacts(self, self._model_scene.arrays, contacts, state)

    def body_at(self, origin: ArrayLike, ray: ArrayLike) -> int | None:
        """Return the first body whose shapes a ray hits; None: no hit.

        Args:
            origin: start of the ray {3} (m).
            ray: direction {3}.
        """
        shape = self._shape_at(origin, ray)
        if shape is None or self._model_scene is None:
            return None
        return int(self._model_scene.arrays["shape_body"][shape])

    def name_at(self, origin: ArrayLike, ray: ArrayLike) -> str | None:
        """Return the labels of the first shape on a ray and of its body; None without a model."""
        shape = self._shape_at(origin, ray)
        if shape is None or self.model is None:
            return None
        body = self.model.body_label[self.model.shape_body.numpy()[shape]]
        return f"{self.model.shape_label[shape]} of {body}"

    def _shape_at(self, origin: ArrayLike, ray: ArrayLike) -> int | None:
        scene = self._model_scene
        return None if scene is None else scene.shape_at(np.asarray(origin), np.asarray(ray))

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
        """Show a triangle mesh with points {n, 3} (m) and indices {m, 3}.

        Without normals, smooth ones are computed. NotImplementedError: a texture is given.
        """
        if texture is not None:
            raise NotImplementedError("log_mesh: textures are not drawn")
        mesh = self.scene.put_mesh(
            name,
            as_array(points, 3, "log_mesh, points"),
            as_array(indices, 3, "log_mesh, indices", np.int32),
            None if normals is None else as_array(normals, 3, "log_mesh, normals"),
        )
        if len(mesh.normals.values) != len(mesh.points.values):
            raise ValueError("log_mesh, normals: expected one for each point")
        colors = per_row(color, 1, 3, GRAY, "log_mesh, color")
        item = self.scene.put_instances(name, name, IDENTITY[None], None, colors, hidden)
        item.culled = backface_culling

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
        """Show copies of a mesh at transforms {n, 7}; scales and colors are {3} or {n, 3}.

        ValueError: no mesh has this name. NotImplementedError: materials are given.
        """
        if mesh not in self.scene.meshes:
            known = ", ".join(sorted(self.scene.meshes)) or "none"
            raise ValueError(f"log_instances, mesh: there is no {mesh!r}; there are: {known}")
        if materials is not None:
            raise NotImplementedError("log_instances: materials are not drawn")
        poses = as_array(xforms, 7, "log_instances, xforms")
        n = len(poses)
        sizes = per_row(scales, n, 3, (1, 1, 1), "log_instances, scales")
        sizes = np.pad(sizes, ((0, 0), (0, 1)))
        shades = per_row(colors, n, 3, GRAY, "log_instances, colors")
        self.scene.put_instances(name, mesh, poses, sizes, shades, hidden)

    def log_shapes(
        self,
        name: str,
        geo_type: int,
        geo_scale: ArrayLike,
        xforms: ArrayLike,
        colors: ArrayLike | None = None,
        materials: ArrayLike | None = None,
    ) -> None:
        """Show copies of a shape (GeoType and its scale {3} or {n, 3}) at transforms {n, 7}."""
        if materials is not None:
            raise NotImplementedError("log_shapes: materials are not drawn")
        mesh = shape_name(int(geo_type))
        add_primitive(self.scene, mesh)
        poses = as_array(xforms, 7, "log_shapes, xforms")
        n = len(poses)
        sizes = per_row(geo_scale, n, 3, (1, 1, 1), "log_shapes, geo_scale")
        shades = per_row(colors, n, 3, GRAY, "log_shapes, colors")
        self.scene.put_instances(name, mesh, poses, shape_scales(int(geo_type), sizes), shades)

    def log_lines(
        self,
        name: str,
        starts: ArrayLike | None,
        ends: ArrayLike | None,
        colors: ArrayLike | None,
        width: float = 0.01,
        hidden: bool = False,
    ) -> None:
        """Show segments from starts to ends {n, 3} (m) with a width in m; None: remove them."""
        self._put_lines("log_lines", name, starts, ends, colors, width, hidden)

    def log_arrows(
        self,
        name: str,
        starts: ArrayLike | None,
        ends: ArrayLike | None,
        colors: ArrayLike | None,
        width: float = 0.01,
        hidden: bool = False,
    ) -> None:
        """Show arrows from starts to ends {n, 3} (m); None: remove them."""
        drawn = self._put_lines("log_arrows", name, starts, ends, colors, width, hidden)
        heads = f"{name}/heads"
        if drawn is None:
            self.scene.remove(heads)
            return
        first, last, shades = drawn
        axis = last - first
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        size = np.minimum(0.5 * ARROW_HEAD * width, 0.25 * length)
        axis = axis / np.where(length > 0.0, length, 1.0)
        poses = np.concatenate([last - axis * size, turns_of_z(axis)], axis=1)
        add_primitive(self.scene, "cone")
        scales = np.concatenate([0.5 * size, 0.5 * size, size, 0.0 * size], axis=1)
        self.scene.put_instances(heads, "cone", f32(poses), scales, shades, hidden)

    def _put_lines(
        self,
        call: str,
        name: str,
        starts: ArrayLike | None,
        ends: ArrayLike | None,
        colors: ArrayLike | None,
        width: float,
        hidden: bool,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        if starts is None or ends is None:
            self.scene.remove(name)
            return None
        first, last = as_array(starts, 3, f"{call}, starts"), as_array(ends, 3, f"{call}, ends")
        if len(first) != len(last):
            raise ValueError(f"{call}, ends: expected {len(first)} rows as starts, got {len(last)}")
        shades = per_row(colors, len(first), 3, GRAY, f"{call}, colors")
        self.scene.put_lines(name, first.copy(), last.copy(), shades, width, hidden)
        return first, last, shades

    def log_points(
        self,
        name: str,
        points: ArrayLike | None,
        radii: ArrayLike | float | None = None,
        colors: ArrayLike | None = None,
        hidden: bool = False,
    ) -> None:
        """Show points {n, 3} as spheres with radii {n} (m, default 0.01); None: remove them."""
        if points is None:
            self.scene.remove(name)
            return
        centers = as_array(points, 3, "log_points, points")
        n = len(centers)
        poses = np.tile(IDENTITY, (n, 1))
        poses[:, :3] = centers
        sizes = np.zeros((n, 4), np.float32)
        sizes[:, :3] = per_row(radii, n, 1, 0.01, "log_points, radii")
        shades = per_row(colors, n, 3, GRAY, "log_points, colors")
        add_primitive(self.scene, "sphere")
        self.scene.put_instances(name, "sphere", poses, sizes, shades, hidden)

    def log_array(self, name: str, array: ArrayLike) -> None:
        """Show the curve of an array. ValueError: a number is not finite."""
        values = np.array(array.numpy() if hasattr(array, "numpy") else array, np.float64).ravel()
        if not values.size or not np.isfinite(values).all():
            raise ValueError("log_array, array: expected finite numbers, at least one")
        self.scene.curves[name] = values

    def log_scalar(self, name: str, value: float) -> None:
        """Show a number as text, and add it to the curve of this name."""
        values = self.scene.scalars.setdefault(name, [])
        values.append(float(value))
        del values[:-HISTORY]

    def log_image(self, name: str, image: ArrayLike) -> None:
        """Show an image {h, w, 3}, uint8, below the text."""
        pixels = np.array(image.numpy() if hasattr(image, "numpy") else image)
        if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3:
            raise ValueError(
                f"log_image, image: expected uint8 of the shape (h, w, 3), got {pixels.dtype} of "
                f"the shape {pixels.shape}"
            )
        self.scene.images[name] = pixels

    def clear(self) -> None:
        """Remove the model and all drawings."""
        self._model_scene = None
        self.latest_state = {}
        scene = self.scene
        for objects in (scene.meshes, scene.instances, scene.lines):
            objects.clear()
        for numbers in (scene.scalars, scene.curves, scene.images):
            numbers.clear()

    def _place_camera(self) -> None:
        """Place the camera so that the whole scene is visible, unless it was placed before."""
        if self.camera.is_set:
            return
        bounds = self.scene.bounds()
        if bounds is not None:
            self.camera.frame(*bounds)
            self.camera.is_set = True
