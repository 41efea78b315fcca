"""Converts a model and its states to a scene. Other modules of the viewers use no model.

The input is arrays, so that a recording can be shown without the model.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .._core import Contacts, GeoType, JointType, Model, ParticleFlags, ShapeFlags, SimState
from ._base import Viewer
from ._inertia import inertia_edges
from ._pick import first_hit
from ._primitives import add_primitive
from ._scene import CHECKER, IDENTITY, Instances, Scene, compose, f32, rotate

MODEL_FIELDS = (
    "particle_radius",
    "particle_mass",
    "particle_inv_mass",
    "particle_flags",
    "particle_world",
    "spring_indices",
    "tri_indices",
    "tet_indices",
    "body_mass",
    "body_com",
    "body_inertia",
    "body_world",
    "joint_type",
    "joint_parent",
    "joint_child",
    "joint_X_p",
    "joint_X_c",
    "joint_qd_start",
    "joint_axis",
    "gravity",
    "shape_type",
    "shape_scale",
    "shape_transform",
    "shape_body",
    "shape_flags",
    "shape_color",
    "shape_mesh_range",
    "mesh_vertices",
    "mesh_indices",
)
PALETTE = f32(
    [
        (0.16, 0.44, 0.72),
        (0.90, 0.45, 0.13),
        (0.30, 0.60, 0.30),
        (0.76, 0.27, 0.35),
        (0.52, 0.40, 0.72),
        (0.10, 0.62, 0.64),
        (0.85, 0.65, 0.13),
        (0.55, 0.42, 0.35),
    ]
)
STATIC_COLOR, GROUND_COLOR = (0.70, 0.72, 0.75), (0.83, 0.84, 0.85)
PARTICLE_COLOR, SURFACE_COLOR = (0.86, 0.33, 0.18), (0.27, 0.53, 0.78)
SPRING_COLOR, CONTACT_COLOR = (0.45, 0.48, 0.52), (0.80, 0.10, 0.30)
JOINT_COLOR, JOINT_SIZE, JOINT_WIDTH = (0.95, 0.75, 0.10), 0.12, 0.012  # m
INERTIA_COLOR, INERTIA_WIDTH = (0.55, 0.15, 0.60), 0.003  # m
INFINITE = 400.0  # m: drawn size of an infinite plane
CONTACT_POINT, CONTACT_WIDTH = 0.012, 0.006  # m: radius of a contact's point, width of its arrow
NORMAL_LENGTH = 0.1  # m: length of the normal of a contact without a force
FORCE_SCALE = 1.0e-3  # m/N: length of a force arrow

_FLOATS = ("particle_radius", "particle_inv_mass", "joint_axis")
_SHAPES = {
    GeoType.PLANE: "plane",
    GeoType.SPHERE: "sphere",
    GeoType.CAPSULE: "capsule",
    GeoType.ELLIPSOID: "sphere",
    GeoType.CYLINDER: "cylinder",
    GeoType.BOX: "box",
    GeoType.CONE: "cone",
}


def model_arrays(model: Model) -> dict[str, np.ndarray]:
    """Return the visible fields of a model."""
    arrays = {name: getattr(model, name).numpy() for name in MODEL_FIELDS}
    return {name: values for name, values in arrays.items() if values.size}


def shape_name(geo_type: int) -> str:
    """Return the mesh name of a shape type. NotImplementedError: the type is not drawn."""
    if geo_type not in _SHAPES:
        kind = GeoType(geo_type).name if geo_type in set(GeoType) else geo_type
        raise NotImplementedError(f"viewer: shapes of the type {kind} are not drawn")
    return _SHAPES[GeoType(geo_type)]


def shape_scales(geo_type: int, scale: np.ndarray) -> np.ndarray:
    """Return scales {n, 4} of instances for the shape_scale {n, 3} of a type (core/sim/enums.h)."""
    out = np.zeros((len(scale), 4), np.float32)
    a, b = scale[:, 0], scale[:, 1]
    if geo_type == GeoType.PLANE:
        finite = (a > 0.0) & (b > 0.0)
        out[:, 0], out[:, 1], out[:, 2] = (
            np.where(finite, a, INFINITE),
            np.where(finite, b, INFINITE),
            1,
        )
    elif geo_type in (GeoType.SPHERE, GeoType.CAPSULE):
        out[:, :3] = a[:, None]
        out[:, 3] = b if geo_type == GeoType.CAPSULE else 0.0
    elif geo_type in (GeoType.CYLINDER, GeoType.CONE):
        out[:, 0], out[:, 1], out[:, 2] = a, a, b
    else:
        out[:, :3] = scale
    return out


def boundary_triangles(tets: np.ndarray) -> np.ndarray:
    """Return the faces {m, 3} that belong to one tetrahedron only, oriented outwards."""
    faces = np.concatenate([tets[:, f] for f in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))])
    key = np.sort(faces, axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    return np.ascontiguousarray(faces[np.sort(first[count == 1])])


class ModelScene:
    """Updates the objects named model/... of a scene from states."""

    def __init__(self, scene: Scene, arrays: Mapping[str, np.ndarray]) -> None:
        """Add the shapes, particles, surfaces and springs of a model to a scene."""
        for name in [n for n in scene.instances if n.startswith("model/")]:
            scene.remove(name)
        self.scene = scene
        self.arrays = arrays
        self.offsets = np.zeros(3, np.float32)
        self.show_joints = self.show_inertia = False
        self._bodies: list[tuple[Instances, np.ndarray]] = []  # bodies of the first rows
        self._rows: list[tuple[Instances, np.ndarray, np.ndarray]] = []  # shape, color of a row
        self._add_shapes()
        self._add_particles()

    def get(self, name: str, width: int) -> np.ndarray:
        """Return a field of the model; a missing field is empty."""
        dtype = np.float32 if name in _FLOATS else np.int32
        return self.arrays.get(name, np.zeros((0, width) if width else 0, dtype))

    def _put_mesh(self, name: str, shape: int) -> None:
        """Add the mesh or hull of a shape to the scene, with a separate normal per face."""
        vertex, vertices, triangle, triangles = self.arrays["shape_mesh_range"][shape]
        faces = self.arrays["mesh_indices"][triangle : triangle + triangles]
        points = self.arrays["mesh_vertices"][vertex : vertex + vertices][faces]
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        self.scene.put_mesh(
            name,
            np.ascontiguousarray(points.reshape(-1, 3)),
            np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3),
            np.repeat(normals, 3, axis=0),
        )

    def _add_shapes(self) -> None:
        if "shape_type" not in self.arrays:
            return
        types, bodies = self.arrays["shape_type"], self.arrays["shape_body"]
        visible = (self.arrays["shape_flags"] & int(ShapeFlags.VISIBLE)) != 0
        first = (
            self.get("shape_mesh_range", 4)[:, 0] if "mesh_vertices" in self.arrays else 0 * types
        )
        for geo_type, vertex in np.unique(np.stack([types, first], axis=1)[visible], axis=0):
            rows = np.flatnonzero(visible & (types == geo_type) & (first == vertex))
            rows = rows[np.argsort(bodies[rows] < 0, kind="stable")]  # shapes of bodies come first
            name = f"model/{GeoType(geo_type).name.lower()}"
            if geo_type in (GeoType.MESH, GeoType.CONVEX_MESH):
                mesh = name = f"{name}_{vertex}"
                self._put_mesh(mesh, rows[0])
            else:
                mesh = shape_name(int(geo_type))
                add_primitive(self.scene, mesh)
            item = Instances(mesh, len(rows))
            item.local.set(np.ascontiguousarray(self.arrays["shape_transform"][rows]))
            item.scales.set(shape_scales(int(geo_type), self.arrays["shape_scale"][rows]))
            colors = _shape_colors(bodies[rows], geo_type == GeoType.PLANE)
            if "shape_color" in self.arrays:  # missing in older recordings
                given = self.arrays["shape_color"][rows]
                colors[:, :3] = np.where(given < 0.0, colors[:, :3], given)
            item.colors.set(colors)
            self.scene.instances[name] = item
            moving = bodies[rows]
            self._rows.append((item, rows, item.colors.values))
            # numpy.take uses indices of the type intp without a copy.
            self._bodies.append((item, moving[moving >= 0].astype(np.intp)))

    def color_shapes(self, shapes: np.ndarray, colors: np.ndarray) -> None:
        """Set the colors {n, 4} of shapes {n}; all other shapes get their default colors."""
        count = len(self.get("shape_type", 0))
        if len(shapes) and not 0 <= shapes.min() <= shapes.max() < count:
            raise ValueError(f"set_shape_colors, shapes: expected numbers of {count} shapes")
        given = np.full((count, 4), np.nan, np.float32)
        given[shapes] = colors
        for item, rows, own in self._rows:
            item.colors.set(np.where(np.isnan(given[rows]), own, given[rows]))

    def shape_at(self, origin: np.ndarray, ray: np.ndarray) -> int | None:
        """Return the first shape of a body that a ray hits; None: no hit."""
        items = [(item, len(bodies)) for item, bodies in self._bodies]
        found = first_hit(self.scene, items, origin, ray)
        return None if found is None else int(self._rows[found[0]][1][found[1]])

    def owner(self, name: str, row: int, point: np.ndarray) -> tuple[str, int] | None:
        """Return the body or particle that a row of instances shows; None: neither.

        A surface gives its particle nearest to `point` (m).
        """
        item = self.scene.instances.get(name)
        for instances, bodies in self._bodies:
            if instances is item:
                return ("body", int(bodies[row])) if row < len(bodies) else None
        if name == "model/particles":
            return "particle", int(self.shown[row])
        if name == "model/surface":
            away = np.linalg.norm(self.scene.meshes[name].points.values - point, axis=1)
            return "particle", int(away.argmin())
        return None

    def _add_particles(self) -> None:
        radius = self.get("particle_radius", 0)
        triangles, tets = self.get("tri_indices", 3), self.get("tet_indices", 4)
        if len(tets):
            inside = np.isin(np.sort(triangles, axis=1), np.unique(tets)).all(axis=1)
            triangles = np.concatenate([boundary_triangles(tets), triangles[~inside]])
        self.triangles = np.ascontiguousarray(triangles, np.int32)
        active = (self.get("particle_flags", 0) & int(ParticleFlags.ACTIVE)) != 0
        used = np.union1d(triangles, tets).astype(np.int64)
        active[used] = False
        self.shown = np.flatnonzero(active)
        if len(self.shown):
            add_primitive(self.scene, "sphere")
            item = Instances("sphere", len(self.shown))
            scales = np.zeros((len(self.shown), 4), np.float32)
            scales[:, :3] = radius[self.shown, None]
            item.scales.set(scales)
            held = self.get("particle_inv_mass", 0)[self.shown, None] == 0.0
            colors = np.where(held, f32(STATIC_COLOR), f32(PARTICLE_COLOR))
            item.colors.set(np.pad(colors, ((0, 0), (0, 1))))
            self.scene.instances["model/particles"] = item

    def update(self, state: Mapping[str, np.ndarray]) -> None:
        """Show a state: its body_q {n, 7} and particle_q {n, 3}."""
        if "body_q" in state:
            body_q = state["body_q"]
            for item, bodies in self._bodies:
                if len(bodies):
                    poses = item.poses.values[: len(bodies)]
                    np.take(body_q, bodies, axis=0, out=poses, mode="clip")
                    if self.offsets.any():
                        poses[:, :3] += self._shift("body_world", bodies)
                    item.poses.touch()
            if "joint_type" in self.arrays:
                self._update_joints(body_q)
            self._update_inertia(body_q)
        if "particle_q" in state:
            self._update_particles(state["particle_q"])

    def _update_joints(self, body_q: np.ndarray) -> None:
        """Show every joint axis as a segment through the joint; free joints have none."""
        name = "model/joints"
        if not self.show_joints:
            self.scene.remove(name)
            return
        kinds, starts = self.arrays["joint_type"], self.arrays["joint_qd_start"]
        joint = np.repeat(np.arange(len(kinds)), np.diff(starts))
        axes = self.get("joint_axis", 3)
        bound = ~np.isin(kinds[joint], (int(JointType.FREE), int(JointType.DISTANCE)))
        joint, axes = joint[bound], axes[bound]
        if not len(joint):
            return
        parent, child = self.arrays["joint_parent"][joint], self.arrays["joint_child"][joint]
        poses = np.concatenate([body_q, IDENTITY[None]])  # index -1: the world
        frame = compose(poses[parent], self.arrays["joint_X_p"][joint])
        at = compose(poses[child], self.arrays["joint_X_c"][joint])[:, :3]
        half = (0.5 * JOINT_SIZE) * rotate(frame[:, 3:], axes)
        if self.offsets.any():
            at = at + self._shift("body_world", child)
        colors = np.tile(f32(JOINT_COLOR), (len(at), 1))
        ends = f32(at + half)
        self.scene.put_lines(name, f32(at - half), ends, colors, JOINT_WIDTH)

    def _update_inertia(self, body_q: np.ndarray) -> None:
        """Show a box of equal mass and inertia around the center of mass of every body."""
        name = "model/inertia"
        if not self.show_inertia:
            self.scene.remove(name)
            return
        if self.offsets.any():
            body_q = body_q.copy()
            body_q[:, :3] += self._shift("body_world", slice(None))
        starts, ends = inertia_edges(self.arrays, body_q)
        colors = np.tile(f32(INERTIA_COLOR), (len(starts), 1))
        self.scene.put_lines(name, starts, ends, colors, INERTIA_WIDTH)

    def _update_particles(self, q: np.ndarray) -> None:
        if self.offsets.any():
            q = q + self._shift("particle_world", slice(None))
        if len(self.shown):
            item = self.scene.instances["model/particles"]
            np.take(q, self.shown, axis=0, out=item.poses.values[:, :3], mode="clip")
            item.poses.touch()
        if len(self.triangles):
            self.scene.put_mesh("model/surface", q.copy(), self.triangles)
            if "model/surface" not in self.scene.instances:
                color = f32([[*SURFACE_COLOR, 0]])
                item = self.scene.put_instances(
                    "model/surface", "model/surface", IDENTITY[None], None, color
                )
                item.culled = False
        springs = self.get("spring_indices", 2).reshape(-1, 2)
        if len(springs):
            colors = np.tile(f32(SPRING_COLOR), (len(springs), 1))
            width = 0.004 * float(np.ptp(q, axis=0).max())
            self.scene.put_lines("model/springs", q[springs[:, 0]], q[springs[:, 1]], colors, width)

    def _shift(self, field: str, rows: np.ndarray | slice) -> np.ndarray:
        world = np.maximum(self.get(field, 0)[rows], 0)
        return world[:, None] * self.offsets


def energy(arrays: Mapping[str, np.ndarray], state: Mapping[str, np.ndarray]) -> float:
    """Return kinetic plus gravitational energy (J) of bodies and particles, no elastic energy."""
    total = 0.0
    if "particle_qd" in state:
        mass, q, v = arrays["particle_mass"], state["particle_q"], state["particle_qd"]
        total += _energy_of_points(arrays, "particle_world", mass, q, v)
    if "body_qd" in state:
        pose, twist = state["body_q"], state["body_qd"]
        center = pose[:, :3] + rotate(pose[:, 3:], arrays["body_com"])
        mass = arrays["body_mass"]
        total += _energy_of_points(arrays, "body_world", mass, center, twist[:, :3])
        inverse = pose[:, 3:] * f32([-1, -1, -1, 1])
        spin = rotate(inverse, twist[:, 3:])
        inertia = arrays["body_inertia"].reshape(-1, 3, 3)
        total += 0.5 * float(np.einsum("ni,nij,nj", spin, inertia, spin, dtype=np.float64))
    return total


def _energy_of_points(
    arrays: Mapping[str, np.ndarray], worlds: str, mass: np.ndarray, q: np.ndarray, v: np.ndarray
) -> float:
    gravity = arrays["gravity"].reshape(-1, 3)[arrays[worlds]]
    each = 0.5 * (v * v).sum(axis=1, dtype=np.float64) - (gravity * q).sum(axis=1, dtype=np.float64)
    return float(mass @ each)


def draw_contacts(
    viewer: Viewer, arrays: Mapping[str, np.ndarray], contacts: Contacts, state: SimState
) -> None:
    """Draw each contact of a state as a point and an arrow: the force, or else the normal."""
    q, p = state.body_q.numpy(), state.particle_q.numpy()
    starts, ends = contact_segments(arrays, contacts, q, p)
    viewer.log_points("contacts/points", starts, CONTACT_POINT, CONTACT_COLOR)
    viewer.log_arrows("contacts/arrows", starts, ends, CONTACT_COLOR, CONTACT_WIDTH)


def contact_segments(
    arrays: Mapping[str, np.ndarray],
    contacts: Contacts,
    body_q: np.ndarray,
    particle_q: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return contact points {n, 3} (m) and ends {n, 3} of arrows: the force, or else the normal."""
    points, arrows = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.float32)]
    count = min(contacts.active_rigid_contact_count, contacts.rigid_contact_max)
    if count:
        body = arrays["shape_body"][contacts.rigid_contact_shape0.numpy()[:count]]
        pose = np.tile(IDENTITY, (count, 1))
        pose[body >= 0] = body_q[body[body >= 0]]
        local = np.tile(IDENTITY, (count, 1))
        local[:, :3] = contacts.rigid_contact_point0.numpy()[:count]
        local[:, :3] += contacts.rigid_contact_offset0.numpy()[:count]
        points.append(compose(pose, local)[:, :3])
        normal = contacts.rigid_contact_normal.numpy()[:count] * f32(NORMAL_LENGTH)
        force = contacts.rigid_contact_force.numpy()
        if len(force) >= count and np.any(force[:count]):
            normal = force[:count, :3] * f32(FORCE_SCALE)
        arrows.append(normal)
    count = min(contacts.active_soft_contact_count, contacts.soft_contact_max)
    if count:
        particle = contacts.soft_contact_particle.numpy()[:count]
        points.append(particle_q[particle])
        arrows.append(contacts.soft_contact_normal.numpy()[:count] * f32(NORMAL_LENGTH))
    starts = np.concatenate(points)
    return starts, starts + np.concatenate(arrows)


def _shape_colors(bodies: np.ndarray, is_plane: bool) -> np.ndarray:
    colors = np.zeros((len(bodies), 4), np.float32)
    colors[:, :3] = PALETTE[np.maximum(bodies, 0) % len(PALETTE)]
    colors[bodies < 0, :3] = GROUND_COLOR if is_plane else STATIC_COLOR
    colors[:, 3] = CHECKER if is_plane else 0.0
    return colors
