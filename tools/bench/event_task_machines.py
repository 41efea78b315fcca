"""The tasks of event_task_scenes.py with drives or forces over time, and the list of all tasks."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from event_task_cloths import ClothPenalty, ClothVbd, ClothVbdImplicit
from event_task_scenes import (
    SOLVERS,
    UPRIGHT,
    BallImpulse,
    BallParticle,
    BallPenalty,
    BilliardImpulse,
    BilliardPenalty,
    G,
    Impulse,
    Penalty,
    Task,
    TossImpulse,
    TossMean,
    TossPenalty,
    at,
    impulses,
    penalties,
    spread,
    squares,
    stretches,
)

import novaphy
from novaphy import diff, nova


class Push(Task):
    """A ball pushes a box over the ground. Forces drive the ball."""

    name = "push"
    start: ClassVar = [3.0, 0.2, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    sigma = 0.5
    knots = 4
    sink: ClassVar[float] = 0.0

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the box, and the ball, which touches only the box."""
        of = self.surface()
        body = builder.add_body(
            xform=at(0, 0, 0.1 - self.sink), mass=1.0, inertia=np.eye(3) * 0.0067
        )
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=of)
        ball = builder.add_body(xform=at(-0.2, 0.02, 0.1), mass=0.5, inertia=np.eye(3) * 0.002)
        shape = builder.add_shape_sphere(ball, radius=0.06, cfg=of)
        ground = builder.add_ground_plane(cfg=of)
        builder.add_shape_collision_filter_pair(shape, ground)

    def add_ground(self, builder: novaphy.ModelBuilder) -> None:
        """Add no shared shapes, because each world has a separate ground."""

    def forces(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the wrenches {steps, bodies, 6} on the ball, which also cancel gravity."""
        held = np.zeros((1, 12 * self.worlds), np.float32)
        held[0, 8::12] = 0.5 * G
        rows = self.rows(theta, spread([6, 7], 12)) + nova.tensor(held)
        return (stretches(self.steps, self.knots) @ rows).reshape(self.steps, 2 * self.worlds, 6)

    def away(self, place: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of positions {worlds, 2} of the box."""
        return squares(place - nova.tensor(np.float32([[0.8, 0.2]])))


class PushPenalty(Push, Penalty):
    """The push with penalty contacts of bodies."""

    sink = G / 4 / 4e3

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(4e3, 60.0, 60.0, 0.4)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {"friction_smoothing": 0.05}

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the forces theta drive the ball."""
        return self.away(self.places(self.roll(body_forces=self.forces(theta)))[:, 0, 0:2])


class PushImpulse(Push, Impulse):
    """The push with impulse contacts of articulations."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.4)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the forces theta drive the ball."""
        return self.away(self.coordinates(self.roll(body_forces=self.forces(theta)))[:, 0:2])


class Hopper(Impulse):
    """A robot of three links in a plane jumps forward by the targets of two drives."""

    name = "hopper"
    knots = 8
    start: ClassVar = list(
        np.tile([0.6, -1.2], 8)
        + np.array([0, 0, 0.3, -0.5, -0.4, 0.8, 0, 0, 0.3, -0.5, -0.4, 0.8, 0, 0, 0.3, -0.5])
    )
    sigma = 0.1

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return novaphy.ShapeConfig(mu=0.8, density=0, ke=2e4, kd=200, gap=0.05)

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the torso on two slides, the thigh and the shank."""
        of, inertia = self.surface(), np.eye(3) * 0.01
        cart = builder.add_link(mass=0.01, inertia=np.eye(3) * 1e-4)
        base = builder.add_link(mass=3.0, inertia=inertia)
        thigh = builder.add_link(mass=0.5, inertia=inertia * 0.3)
        shank = builder.add_link(mass=0.5, inertia=inertia * 0.3)
        drive = {"target_ke": 60.0, "target_kd": 2.0, "armature": 0.01, "actuator_mode": 1}
        low, up = at(0, 0, -0.15), at(0, 0, 0.15)
        joints = [
            builder.add_joint_prismatic(-1, cart, axis=(1, 0, 0)),
            builder.add_joint_prismatic(cart, base, axis=(0, 0, 1)),
            builder.add_joint_revolute(base, thigh, axis=(0, 1, 0), child_xform=up, **drive),
            builder.add_joint_revolute(
                thigh, shank, axis=(0, 1, 0), parent_xform=low, child_xform=up, **drive
            ),
        ]
        builder.add_shape_sphere(shank, xform=low, radius=0.04, cfg=of)
        builder.add_shape_box(base, hx=0.1, hy=0.1, hz=0.05, cfg=of)
        builder.add_articulation(joints)
        q = [0.0, 0.04 + 0.6 * np.cos(0.6), 0.6, -1.2]
        builder.joint_q = q
        builder.joint_target_q = q

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses, by the distance traveled, of the targets theta."""
        view = diff.control_joint_target_q_tensor
        way = self.coordinates(self.roll(self.controls(theta, view, [2, 3])))[:, 0:1]
        return squares(way - 0.5)


class HopperCompliant(Hopper):
    """The hopper with compliant contacts, which have no gradient of the motion."""

    solver_name = "Featherstone, compliant"
    modes = ("code",)

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver."""
        return SOLVERS.DiffFeatherstoneSolver(self.model, compliant_contacts=True)


class Strike(Task):
    """An arm of two links strikes a ball."""

    name = "strike"
    start: ClassVar = [-6.0, -2.0, -6.0, -2.0, 0.0, 0.0, 0.0, 0.0]
    sigma = 0.5
    knots = 4
    sink: ClassVar[float] = 0.0
    armature: ClassVar[float] = 0.01

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the arm and the ball."""
        of, inertia = self.surface(), np.eye(3) * 0.01
        upper = builder.add_link(mass=1.0, inertia=inertia, xform=at(0, 0, 0.8))
        lower = builder.add_link(mass=0.7, inertia=inertia * 0.7, xform=at(0, 0, 0.45))
        more = {"damping": 0.1, "armature": self.armature, "child_xform": at(0, 0, 0.2)}
        joints = [
            builder.add_joint_revolute(
                -1, upper, axis=(0, 1, 0), parent_xform=at(0, 0, 1.04), **more
            ),
            builder.add_joint_revolute(
                upper, lower, axis=(0, 1, 0), parent_xform=at(0, 0, -0.2), **more
            ),
        ]
        builder.add_shape_box(lower, xform=at(0, 0, -0.3), hx=0.03, hy=0.08, hz=0.1, cfg=of)
        builder.add_articulation(joints)
        ball = builder.add_body(
            xform=at(0.25, 0, 0.1 - self.sink), mass=0.2, inertia=np.eye(3) * 8e-4
        )
        builder.add_shape_sphere(ball, radius=0.1, cfg=of)
        builder.joint_q[0] = 0.9
        builder.joint_q[1] = 0.3

    def end(self, theta: nova.Tensor) -> novaphy.SimState:
        """Return the last state under the torques theta."""
        first = self.path[0]
        with nova.no_grad():
            novaphy.eval_fk(self.model, first.joint_q, first.joint_qd, first)
        return self.roll(self.controls(theta, diff.control_joint_f_tensor, [0, 1]))


class StrikeImpulse(Strike, Impulse):
    """The strike with impulse contacts of articulations."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.3, 0.5)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of the ball's distance."""
        return squares(self.coordinates(self.end(theta))[:, 2:3] - 1.2)


class StrikePenalty(Strike, Penalty):
    """The strike with penalty contacts, and joints as springs."""

    solver_name = "semi-implicit, joints"
    steps = 1920
    rate = 1920
    sink = 0.2 * G / 4e3
    armature = 0.0

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(4e3, 10.0, 20.0, 0.3)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {"joint_attach_ke": 2e4, "joint_attach_kd": 50.0}

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of the ball's distance."""
        return squares(self.places(self.end(theta))[:, 2, 0:1] - 1.2)


class Tilt(Task):
    """A board on two hinges tilts, so that a ball on it rolls to a target."""

    name = "tilt"
    start: ClassVar = [0.1, 0.05, 0.1, 0.0, 0.0, 0.0, -0.1, 0.0]
    sigma = 0.03
    knots = 4
    sink: ClassVar[float] = 0.0

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the board and the ball."""
        of = self.surface()
        frame = builder.add_link(mass=0.5, inertia=np.eye(3) * 0.01)
        board = builder.add_link(mass=2.0, inertia=np.diag([0.1, 0.1, 0.2]))
        drive = {"target_ke": 200.0, "target_kd": 10.0, "actuator_mode": 1}
        joints = [
            builder.add_joint_revolute(-1, frame, axis=(0, 1, 0), **drive),
            builder.add_joint_revolute(frame, board, axis=(1, 0, 0), **drive),
        ]
        builder.add_articulation(joints)
        builder.add_shape_box(board, hx=0.6, hy=0.6, hz=0.02, cfg=of)
        ball = builder.add_body(
            xform=((0, 0, 0.12 - self.sink), UPRIGHT), mass=0.3, inertia=np.eye(3) * 1.2e-3
        )
        builder.add_shape_sphere(ball, radius=0.1, cfg=of)

    def add_ground(self, builder: novaphy.ModelBuilder) -> None:
        """Add no shared shapes."""

    def end(self, theta: nova.Tensor) -> novaphy.SimState:
        """Return the last state under the drive targets theta."""
        return self.roll(self.controls(theta, diff.control_joint_target_q_tensor, [0, 1]))

    def away(self, place: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of positions {worlds, 2} of the ball."""
        return squares(place - nova.tensor(np.float32([[0.3, -0.2]])))


class TiltImpulse(Tilt, Impulse):
    """The board with impulse contacts of articulations."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.6)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} under the drive targets theta."""
        return self.away(self.coordinates(self.end(theta))[:, 2:4])


class TiltPenalty(Tilt, Penalty):
    """The board with penalty contacts, and joints as springs."""

    solver_name = "semi-implicit, joints"
    steps = 1920
    rate = 1920
    sink = 0.3 * G / 4e3

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(4e3, 20.0, 40.0, 0.6)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {"joint_attach_ke": 2e4, "joint_attach_kd": 50.0}

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} under the drive targets theta."""
        return self.away(self.places(self.end(theta))[:, 2, 0:2])


TASKS: list[type[Task]] = [
    BallParticle, BallPenalty, BallImpulse, BilliardPenalty, BilliardImpulse, TossPenalty,
    TossMean, TossImpulse, PushPenalty, PushImpulse, Hopper, HopperCompliant, ClothVbd,
    ClothVbdImplicit, ClothPenalty, StrikePenalty, StrikeImpulse, TiltPenalty, TiltImpulse,
]  # fmt: skip
