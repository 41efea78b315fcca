"""The window of `novaphy view`: a mesh, or a robot with sliders for its joints and controls."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from . import _core, io
from .viewer import Stage
from .viewer._base import Slider
from .viewer._model_scene import SURFACE_COLOR, boundary_triangles
from .viewer._scene import f32

FPS = 60.0
STEPS = 8  # solver steps per frame
OVERLAP = 0.01  # least reported overlap, as a part of the radius of the smaller shape
UNLIMITED = 1e6  # rad or m: a joint limit above this value counts as no limit
REACH = {"rad": math.pi, "m": 1.0}  # range (+-) of the slider of a joint without limits


class Puppet:
    """A robot that the user poses with joint sliders, or simulates with control sliders.

    Moving a control slider starts the simulation. Moving a joint slider stops the simulation and
    sets the pose.
    """

    def __init__(self, model: _core.Model, add_slider: Callable[..., Slider]) -> None:
        """Make a slider for every joint and then for every control (see Viewer.add_slider)."""
        self.model, self.control = model, model.control()
        self.state, self._after = model.state(), model.state()
        self._q, ctrl = model.joint_q.numpy(), model.ctrl.numpy()
        model.shape_gap.fill_(0.0)  # report contacts of touching shapes only
        plain = _core.ShapeConfig()  # the solver supports no torsional and rolling friction
        model.shape_material_mu_torsional.fill_(plain.mu_torsional)
        model.shape_material_mu_rolling.fill_(plain.mu_rolling)
        self._pipeline = _core.CollisionPipeline(model)
        self.contacts = self._pipeline.contacts()
        self._solver: _core.solvers.SolverFeatherstone | None = None

        def slider(name: str, low: float, high: float, value: float) -> Slider:
            return add_slider(name, low, high, min(max(float(value), low), high))

        self.joints = {
            row: slider(name, low, high, self._q[row])
            for row, name, low, high in joint_ranges(model)
        }
        # The row of each BALL joint's quaternion in joint_q, with sliders for its rotation vector.
        self.balls = {
            row: [slider(f"{name} {axis} (rad)", -most, most, x) for axis, x in zip("xyz", at)]
            for row, name, most, at in ball_ranges(model)
        }
        self.controls = [
            slider(name, low, high, value)
            for value, (name, low, high) in zip(ctrl, control_ranges(model), strict=True)
        ]
        self._start = [each.value for each in self._sliders()]
        self._seen: list[float] = []
        self.moves = False

    def _sliders(self) -> list[Slider]:
        return [*self.joints.values(), *itertools.chain(*self.balls.values()), *self.controls]

    def reset(self) -> None:
        """Reset the robot to the pose of its file."""
        for slider, value in zip(self._sliders(), self._start, strict=True):
            slider.set(value)
        self._seen = []

    def turn(self) -> None:
        """Update the robot from the sliders: set its pose, or simulate 1 / FPS seconds."""
        before, self._seen = self._seen, [each.value for each in self._sliders()]
        count = len(self._seen) - len(self.controls)
        if self.controls:
            self.control.ctrl.assign(f32(self._seen[count:]))
        if not before or before[:count] != self._seen[:count]:
            self.moves = False
            self._pose()
        elif before != self._seen:
            self.moves = True
        if self.moves:
            self._move()

    def _pose(self) -> None:
        model, state = self.model, self.state
        if len(self._q):
            for row, slider in self.joints.items():
                self._q[row] = slider.value
            for row, sliders in self.balls.items():
                self._q[row : row + 4] = quaternion([each.value for each in sliders])
            state.joint_q.assign(self._q)
            state.joint_qd.zero_()
            _core.eval_fk(model, state.joint_q, state.joint_qd, state)
        state.act.assign(model.act)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # overlaps() reports overlaps with the shapes' names
            self._pipeline.collide(state, self.contacts)

    def _move(self) -> None:
        try:
            if self._solver is None:
                self._solver = _core.solvers.SolverFeatherstone(self.model)
            for _ in range(STEPS):
                self.state.clear_forces()
                self._pipeline.collide(self.state, self.contacts)
                step = 1.0 / (FPS * STEPS)
                self._solver.step(self.state, self._after, self.control, self.contacts, step)
                self.state, self._after = self._after, self.state
        except (NotImplementedError, _core.Error) as error:
            print(f"it cannot move: {error}", file=sys.stderr)
            self.moves = False

    def overlaps(self) -> list[tuple[str, str, float]]:
        """Return the pairs of overlapping shapes, deepest first.

        A pair has a text "shape" of "body" for each shape, and the depth of the overlap (m).
        """
        names, radius = shape_names(self.model), self.model.shape_collision_radius.numpy()
        deepest: dict[tuple[int, int], float] = {}
        for row in self.contacts.rigid_contacts(self.model, self.state):
            pair = int(row["shape0"]), int(row["shape1"])
            depth = float(row["penetration"])
            if depth > OVERLAP * min(radius[list(pair)]):
                deepest[pair] = max(depth, deepest.get(pair, 0.0))
        ordered = sorted(deepest.items(), key=lambda each: -each[1])
        return [(names[a], names[b], depth) for (a, b), depth in ordered]


def shape_names(model: _core.Model) -> list[str]:
    """Return a text for every shape: "shape label" of "body label"."""
    bodies = [*model.body_label, "the world"]  # body -1 is the last entry
    labels = zip(model.shape_label, model.shape_body.numpy(), strict=True)
    return [f'"{label}" of "{bodies[body]}"' for label, body in labels]


def show_robot(args: argparse.Namespace) -> str:
    """Show the robot of a .urdf or .xml (MJCF) file until the window is closed.

    Return a text with the counts of bodies, shapes and joints.
    """
    builder = _core.ModelBuilder()
    is_urdf = Path(args.file).suffix.lower() == ".urdf"
    add = builder.add_urdf if is_urdf else builder.add_mjcf
    robot = add(args.file, package_dirs=args.packages, unsupported="warn")
    model = builder.finalize()
    look = None if args.camera is None else camera_look(model, robot, args.camera)
    with Stage(args, model, fps=FPS, look=look) as stage:
        for viewer in stage.viewers:
            for what in args.show:
                setattr(viewer, f"show_{what}", True)
        puppet = Puppet(model, stage.add_slider)
        for turn in stage.turns():
            if turn == 0:  # the first pass, and the first pass after a reset
                puppet.reset()
            puppet.turn()
            if turn == 0:
                for first, second, depth in puppet.overlaps():
                    print(f"overlap: {first} and {second} by {depth:.3g} m")
            stage.show(turn / FPS, puppet.state, puppet.contacts)
    counts = f"{model.body_count} bodies, {model.shape_count} shapes"
    joints = len(puppet.joints) + len(puppet.balls)
    return f"{counts}, {joints} joints to move, {len(puppet.controls)} controls"


def camera_look(
    model: _core.Model, robot: _core.io.RobotImport, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the initial position of a camera in a robot's file, and a point in front of it (m)."""
    if name not in robot.cameras:
        names = ", ".join(robot.cameras) or "none"
        raise ValueError(f"--camera: expected a camera of the file ({names}), got {name}")
    body, pose, _ = robot.cameras[name]
    state = model.state()
    _core.eval_fk(model, state.joint_q, state.joint_qd, state)
    place = state.body_q.numpy()[body] if body >= 0 else np.array([0, 0, 0, 0, 0, 0, 1], np.float32)

    def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return v + 2.0 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)

    inside = np.asarray(pose)
    pos = place[:3] + turned(place[3:], inside[:3])
    return pos, pos + turned(place[3:], turned(inside[3:], np.array([0.0, 0.0, -1.0])))


def control_ranges(model: _core.Model) -> Iterator[tuple[str, float, float]]:
    """Yield the name, lowest and highest value of every control."""
    labels, ranges = model.actuator_label, model.actuator_ctrl_range.numpy()
    for label, (low, high) in zip(labels, ranges.tolist(), strict=True):
        is_limited = -UNLIMITED < low < high < UNLIMITED
        yield f"{label} (control)", *((low, high) if is_limited else (-1.0, 1.0))


def joint_ranges(model: _core.Model) -> Iterator[tuple[int, str, float, float]]:
    """Yield the row of joint_q, name and range (rad, m) of every coordinate with a slider.

    Coordinates of quaternions have no slider of this kind (see ball_ranges).
    """
    labels, axes = model.joint_label, model.joint_dof_dim.numpy()
    rows, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    for joint, (linear, angular) in enumerate(axes):
        count = linear + angular
        if rows[joint + 1] - rows[joint] != count:
            continue  # coordinates that include a quaternion have no slider here
        for k in range(count):
            unit = "m" if k < linear else "rad"
            low, high = float(lower[dofs[joint] + k]), float(upper[dofs[joint] + k])
            if not -UNLIMITED < low < high < UNLIMITED:
                low, high = -REACH[unit], REACH[unit]
            axis = f" {k + 1}" if count > 1 else ""
            yield int(rows[joint] + k), f"{labels[joint]}{axis} ({unit})", low, high


def ball_ranges(model: _core.Model) -> Iterator[tuple[int, str, float, list[float]]]:
    """Yield row in joint_q, name, largest angle and rotation vector (rad) of every BALL joint."""
    rows, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
    upper, q = model.joint_limit_upper.numpy(), model.joint_q.numpy().astype(float)
    for joint in range(model.joint_count):
        if rows[joint + 1] - rows[joint] != 4:  # the coordinates are not one quaternion
            continue
        *v, w = q[rows[joint] : rows[joint] + 4] * (-1.0 if q[rows[joint] + 3] < 0 else 1.0)
        sine = math.hypot(*v)
        per_sine = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0
        most = min(float(upper[dofs[joint]]), REACH["rad"])
        yield int(rows[joint]), model.joint_label[joint], most, [x * per_sine for x in v]


def quaternion(turn: list[float]) -> list[float]:
    """Return the quaternion xyzw of a rotation vector (rad)."""
    angle = math.hypot(*turn)
    per_angle = math.sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    return [*(x * per_angle for x in turn), math.cos(0.5 * angle)]


def show_mesh(args: argparse.Namespace) -> str:
    """Show the surface of a .msh, .obj, .stl, .ply, .dae or .glb file; return a description."""
    if Path(args.file).suffix.lower() == ".msh":
        tets = io.load_tet_mesh(args.file)
        points, triangles = tets.vertices, boundary_triangles(np.asarray(tets.indices))
        what = f"{len(tets.indices)} tetrahedra"
    else:
        mesh = io.load_mesh(args.file)
        points, triangles = mesh.vertices, np.asarray(mesh.indices)
        what = f"{len(triangles)} triangles"
    with Stage(args, None) as stage:
        for viewer in stage.viewers:
            viewer.begin_frame(0.0)
            viewer.log_mesh("mesh", points, triangles, color=SURFACE_COLOR, backface_culling=False)
            viewer.end_frame()
    lower, upper = np.min(points, axis=0), np.max(points, axis=0)
    return f"{len(points)} points, {what}, from {lower} to {upper}"
