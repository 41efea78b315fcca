"""Eight tasks whose motions have contact events, in batches of worlds.

A task maps parameters {worlds, size} to losses {worlds}, and to gradients {worlds, size} with
contact_gradient="code" or "motion". `event_tasks.py` measures these gradients.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

import novaphy
from novaphy import diff, nova

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
G = 9.81
SOLVERS = novaphy.solvers


def penalties(ke: float, kd: float, kf: float = 0.0, mu: float = 0.0) -> novaphy.ShapeConfig:
    """Return the shape configuration of a surface with penalty contacts."""
    return novaphy.ShapeConfig(ke=ke, kd=kd, kf=kf, mu=mu, density=0)


def impulses(mu: float, restitution: float = 0.0) -> novaphy.ShapeConfig:
    """Return a surface with impulse contacts, which the search finds two steps ahead."""
    return novaphy.ShapeConfig(mu=mu, restitution=restitution, density=0, gap=0.05)


def at(x: float, y: float, z: float) -> tuple:
    """Return an upright pose at a position (m)."""
    return ((x, y, z), UPRIGHT)


def squares(difference: nova.Tensor) -> nova.Tensor:
    """Return the squared length of each row."""
    return nova.sum(difference * difference, axis=-1)


def spread(columns: list[int], width: int, by: float = 1.0) -> np.ndarray:
    """Return the matrix that writes parameters to the given columns of a row, times `by`."""
    matrix = np.zeros((len(columns), width), np.float32)
    matrix[np.arange(len(columns)), columns] = by
    return matrix


def stretches(steps: int, knots: int) -> nova.Tensor:
    """Return the weights {steps, knots} of a function that is constant for each knot's steps."""
    basis = np.zeros((steps, knots), np.float32)
    basis[np.arange(steps), np.arange(steps) * knots // steps] = 1
    return nova.tensor(basis)


class Task:
    """A scene in several worlds, its solver, and the loss of a motion."""

    name: ClassVar[str]
    solver_name: ClassVar[str]
    start: ClassVar[list[float]]
    sigma: ClassVar[float]
    steps: ClassVar[int] = 480
    rate: ClassVar[int] = 480  # steps per second
    gravity: ClassVar[float] = G
    knots: ClassVar[int] = 0
    modes: ClassVar[tuple[str, ...]] = ("code", "motion")

    def __init__(self, worlds: int, mode: str = "code") -> None:
        """Build the model of all worlds. `mode`: contact_gradient."""
        self.worlds, self.mode = worlds, mode
        one = novaphy.ModelBuilder(gravity=-self.gravity)
        self.add_world(one)
        builder = novaphy.ModelBuilder(gravity=-self.gravity)
        builder.replicate(one, worlds)
        self.add_ground(builder)
        self.model = self.finish(builder)
        self.solver = self.make_solver()
        self.pipeline = novaphy.CollisionPipeline(self.model, soft_contact_margin=0.05)

    @property
    def dt(self) -> float:
        """Return the length of a step (s)."""
        return 1 / self.rate

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the bodies of one world."""
        raise NotImplementedError

    def add_ground(self, builder: novaphy.ModelBuilder) -> None:
        """Add the shapes that all worlds share."""
        builder.add_ground_plane(cfg=self.surface())

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        raise NotImplementedError

    def finish(self, builder: novaphy.ModelBuilder) -> novaphy.Model:
        """Make the model."""
        return builder.finalize(requires_grad=True)

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver with the task's contact_gradient."""
        raise NotImplementedError

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of parameters {worlds, size}."""
        raise NotImplementedError

    def roll(self, controls: object = None, **more: object) -> novaphy.SimState:
        """Return the last state of a rollout."""
        self.solver.rollout(self.path, controls, None, self.dt, pipeline=self.pipeline, **more)
        return self.path[self.steps]

    def losses(self, theta: np.ndarray) -> np.ndarray:
        """Return the losses {worlds} of parameters {worlds, size}, without a gradient."""
        self.path = diff.Trajectory(self.model, self.steps)
        return self.run(nova.tensor(np.float32(theta))).numpy().astype(np.float64)

    def gradients(self, theta: np.ndarray) -> tuple[np.ndarray, novaphy.solvers.GradientInfo]:
        """Return the gradients {worlds, size} and their label."""
        self.path = diff.Trajectory(self.model, self.steps)
        leaf = nova.tensor(np.float32(theta), requires_grad=True)
        with nova.Tape() as tape:
            loss = self.run(leaf)
            tape.backward(loss, nova.ones((self.worlds,)))
        return leaf.grad.numpy().astype(np.float64), tape.gradient_info()

    def rows(self, theta: nova.Tensor, matrix: np.ndarray) -> nova.Tensor:
        """Return {knots, worlds * width}: theta of each knot and world, times the matrix."""
        width = matrix.shape[1]
        flat = theta.reshape(self.worlds * self.knots, matrix.shape[0]) @ nova.tensor(matrix)
        flat = flat.reshape(self.worlds, self.knots * width)
        return nova.concat(
            [
                flat[:, width * k : width * (k + 1)].reshape(1, self.worlds * width)
                for k in range(self.knots)
            ],
            axis=0,
        )

    def controls(self, theta: nova.Tensor, view: object, columns: list[int]) -> list:
        """Return a control for each knot, with parameters in the given columns of each world."""
        controls = [self.model.control() for _ in range(self.knots)]
        width = view(controls[0]).size // self.worlds
        rows = self.rows(theta, spread(columns, width))
        for k, control in enumerate(controls):
            view(control).copy_(rows[k])
        return controls

    def twists(self, theta: nova.Tensor, more: int) -> nova.Tensor:
        """Return the initial rates of each world and `more` zeros {worlds, size + more}."""
        return nova.concat([theta, nova.zeros((self.worlds, more))], axis=1) if more else theta


class Penalty(Task):
    """A task whose bodies have penalty contacts (semi-implicit solver)."""

    solver_name = "semi-implicit"

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver with the task's contact_gradient."""
        return SOLVERS.DiffSemiImplicitSolver(
            self.model,
            SOLVERS.DiffSolverConfig(
                friction_law="huber", contact_gradient=self.mode, **self.settings()
            ),
        )

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {}

    def places(self, state: novaphy.SimState) -> nova.Tensor:
        """Return the poses {worlds, bodies, 7}."""
        return diff.state_body_q_tensor(state).reshape(self.worlds, -1, 7)


class Impulse(Task):
    """A task whose articulations have impulse contacts (Featherstone solver)."""

    solver_name = "Featherstone"

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver with the task's contact_gradient."""
        return SOLVERS.DiffFeatherstoneSolver(
            self.model, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=self.mode
        )

    def coordinates(self, state: novaphy.SimState) -> nova.Tensor:
        """Return the coordinates {worlds, coordinates}."""
        return diff.state_joint_q_tensor(state).reshape(self.worlds, -1)

    def push_off(self, rates: nova.Tensor) -> None:
        """Set the initial joint rates {worlds, dofs}."""
        diff.state_joint_qd_tensor(self.path[0]).copy_(rates.reshape(rates.size))


class Ball(Task):
    """A ball bounces off the ground and a wall towards a target."""

    name = "ball"
    start: ClassVar = [0.0, 5.0, -5.0]
    sigma = 0.3
    steps = 288
    target: ClassVar = [[0.0, -2.0, 1.5]]

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the ball."""
        body = builder.add_body(xform=at(0, -0.5, 1), mass=1.0, inertia=np.eye(3) * 0.004)
        builder.add_shape_sphere(body, radius=0.1, cfg=self.surface())

    def add_ground(self, builder: novaphy.ModelBuilder) -> None:
        """Add the ground and the wall."""
        builder.add_ground_plane(cfg=self.surface())
        builder.add_shape_plane((0.0, -1.0, 0.0, 1.75), width=0, length=0, cfg=self.surface())

    def away(self, place: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of positions {worlds, 3}."""
        return squares(place - nova.tensor(np.float32(self.target)))


class BallParticle(Ball):
    """The ball as a particle with penalty contacts."""

    solver_name = "semi-implicit, particle"

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the particle."""
        builder.add_particle((0, -0.5, 1), (0, 5, -5), 1.0)

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(1e4, 10.0, 0.0, 0.2)

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver with the task's contact_gradient."""
        self.model.soft_contact_ke, self.model.soft_contact_kd = 1e4, 10.0
        self.model.soft_contact_kf, self.model.soft_contact_mu = 0.0, 0.2
        return SOLVERS.DiffSemiImplicitSolver(
            self.model, SOLVERS.DiffSolverConfig(contact_gradient=self.mode)
        )

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the particle starts with the velocity theta."""
        diff.state_particle_qd_tensor(self.path[0]).copy_(theta)
        return self.away(diff.state_particle_q_tensor(self.roll()))


class BallPenalty(Ball, Penalty):
    """The ball as a body with penalty contacts."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(1e4, 10.0, 100.0, 0.2)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the ball starts with the velocity theta."""
        diff.state_body_qd_tensor(self.path[0]).copy_(self.twists(theta, 3))
        return self.away(self.places(self.roll())[:, 0, 0:3])


class BallImpulse(Ball, Impulse):
    """The ball as an articulation with impulse contacts."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.2, 0.8)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the ball starts with the velocity theta."""
        self.push_off(self.twists(theta, 3))
        return self.away(self.coordinates(self.roll())[:, 0:3])


class Billiard(Task):
    """A ball hits a second ball, which hits a third ball, without a table and its friction."""

    name = "billiard"
    start: ClassVar = [2.0, 0.1]
    sigma: ClassVar = [0.1, 0.05]
    steps = 400
    rate = 400
    gravity = 0.0

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add three balls."""
        for x, y in ((0.0, 0.0), (0.6, 0.04), (1.0, 0.12)):
            body = builder.add_body(xform=at(x, y, 0), mass=1.0, inertia=np.eye(3) * 0.004)
            builder.add_shape_sphere(body, radius=0.1, cfg=self.surface())

    def add_ground(self, builder: novaphy.ModelBuilder) -> None:
        """Add no shared shapes."""

    def away(self, place: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of positions {worlds, 2} of the third ball."""
        return squares(place - nova.tensor(np.float32([[1.3, 0.35]])))


class BilliardPenalty(Billiard, Penalty):
    """The balls as bodies with penalty contacts."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(2e4, 5.0, 20.0, 0.1)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {"angular_damping": 0.0}

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the first ball starts with the velocity theta."""
        diff.state_body_qd_tensor(self.path[0]).copy_(
            self.twists(theta, 16).reshape(3 * self.worlds, 6)
        )
        return self.away(self.places(self.roll())[:, 2, 0:2])


class BilliardImpulse(Billiard, Impulse):
    """The balls as articulations with impulse contacts."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.1, 0.9)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the first ball starts with the velocity theta."""
        self.push_off(self.twists(theta, 16))
        return self.away(self.coordinates(self.roll())[:, 14:16])


class Toss(Task):
    """A box is tossed, falls on its corners and slides."""

    name = "toss"
    start: ClassVar = [1.0, 0.0, 0.5, 1.0, 3.0, 1.0]
    sigma: ClassVar = [0.1, 0.1, 0.1, 0.3, 0.3, 0.3]

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the box."""
        body = builder.add_body(xform=at(0, 0, 0.4), mass=1.0, inertia=np.eye(3) * 0.0067)
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=self.surface())

    def away(self, place: nova.Tensor) -> nova.Tensor:
        """Return the losses {worlds} of positions {worlds, 2}."""
        return squares(place - nova.tensor(np.float32([[1.0, 0.2]])))


class TossPenalty(Toss, Penalty):
    """The box as a body with penalty contacts."""

    steps = 960
    rate = 960

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(4e3, 30.0, 50.0, 0.4)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {"friction_smoothing": 0.1}

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the box starts with the twist theta."""
        diff.state_body_qd_tensor(self.path[0]).copy_(theta)
        return self.away(self.places(self.roll())[:, 0, 0:2])


class TossMean(TossPenalty):
    """The box with the mean force of penalty contacts, whose gradient is exact of the motion."""

    solver_name = "semi-implicit, mean"
    modes = ("code",)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {**super().settings(), "penalty_law": "mean"}


class TossImpulse(Toss, Impulse):
    """The box as an articulation with impulse contacts."""

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return impulses(0.4, 0.2)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the box starts with the twist theta."""
        self.push_off(theta)
        return self.away(self.coordinates(self.roll())[:, 0:2])
