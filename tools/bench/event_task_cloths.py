"""The task of event_task_scenes.py in which a cloth is pulled, with three solvers."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from event_task_scenes import SOLVERS, Task, penalties, squares, stretches

import novaphy
from novaphy import diff, nova


class Cloth(Task):
    """A cloth is pulled over the ground at one edge."""

    name = "cloth"
    knots = 3
    stiffness: ClassVar[tuple[float, float]] = (2e2, 1e-3)
    holds: ClassVar[bool] = True

    def add_world(self, builder: novaphy.ModelBuilder) -> None:
        """Add the cloth to a world."""
        ke, kd = self.stiffness
        builder.add_cloth_grid(
            dim_x=5, dim_y=5, cell_x=0.1, cell_y=0.1, mass=0.02, tri_ke=ke, tri_ka=ke, tri_kd=kd,
            edge_ke=1e-3, edge_kd=1e-5, pos=(0, -0.25, 0.02), fix_right=self.holds,
            particle_radius=0.02,
        )  # fmt: skip

    def mean_of_left(self, state: novaphy.SimState) -> nova.Tensor:
        """Return the mean position of the free left edge of each world {worlds, 3} (m)."""
        places = self.model.particle_q.numpy()
        count = len(places) // self.worlds
        pick = np.zeros((self.worlds, len(places)), np.float32)
        left = np.flatnonzero(places[:count, 0] < 1e-3)
        for world in range(self.worlds):
            pick[world, world * count + left] = 1 / len(left)
        return nova.tensor(pick) @ diff.state_particle_q_tensor(state)

    def away(self, state: novaphy.SimState) -> nova.Tensor:
        """Return the losses {worlds} of a last state."""
        return squares(self.mean_of_left(state)[:, 0:2] - nova.tensor(np.float32([[0.75, 0.0]])))


class ClothVbd(Cloth):
    """The cloth in VBD. The pulled edge follows targets. VBD has no gradient of the motion."""

    solver_name = "VBD, unrolled"
    start: ClassVar = [0.1, 0.1, 0.2, 0.05, 0.3, 0.02]
    sigma = 0.03
    steps = 60
    rate = 120
    modes = ("code",)
    gradient: ClassVar[str] = "unrolled"

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return novaphy.ShapeConfig(ke=2e3, kd=0.0, mu=0.4)

    def finish(self, builder: novaphy.ModelBuilder) -> novaphy.Model:
        """Color the cloth and make the model."""
        builder.color()
        return super().finish(builder)

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver."""
        self.model.soft_contact_ke, self.model.soft_contact_kd = 2e3, 0.0
        self.model.soft_contact_mu = 0.4
        more = {"allow_unconverged": True} if self.gradient == "implicit" else {}
        return SOLVERS.DiffSolverVBD(self.model, iterations=10, gradient=self.gradient, **more)

    def ramps(self) -> nova.Tensor:
        """Return the weights {steps, knots} that interpolate linearly from 0 over the knots."""
        time = np.arange(1, self.steps + 1) / self.steps * self.knots
        hats = np.maximum(0, 1 - np.abs(time[:, None] - np.arange(1, self.knots + 1)))
        return nova.tensor(np.float32(hats))

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses if the pulled edge moves by theta (x and z at each knot)."""
        self.solver.reset()
        held = self.model.particle_q.numpy()[self.model.particle_mass.numpy() <= 0]
        width = 3 * (len(held) // self.worlds)
        matrix = np.zeros((2, width), np.float32)
        matrix[0, 0::3] = matrix[1, 2::3] = 1
        moves = self.ramps() @ self.rows(theta, matrix) + nova.tensor(held.reshape(1, -1))
        return self.away(self.roll(targets=moves.reshape(self.steps, len(held), 3)))


class ClothVbdImplicit(ClothVbd):
    """The cloth in VBD with implicit gradients."""

    solver_name = "VBD, implicit"
    gradient = "implicit"


class ClothPenalty(Cloth):
    """The cloth with penalty contacts. Forces pull the right edge."""

    solver_name = "semi-implicit, cloth"
    start: ClassVar = [1.5, 1.0, 2.0, 0.2, 1.0, 0.0]
    sigma = 0.3
    steps = 800
    rate = 1600
    stiffness = (2e2, 1e-1)
    holds = False

    def surface(self) -> novaphy.ShapeConfig:
        """Return the material of all shapes."""
        return penalties(4e2, 0.5, 1.0, 0.4)

    def make_solver(self) -> novaphy.solvers.SolverBase:
        """Make the solver with the task's contact_gradient."""
        self.model.soft_contact_ke, self.model.soft_contact_kd = 4e2, 0.5
        self.model.soft_contact_kf, self.model.soft_contact_mu = 1.0, 0.4
        config = SOLVERS.DiffSolverConfig(
            enable_triangles=True, enable_bending=True, contact_gradient=self.mode
        )
        return SOLVERS.DiffSemiImplicitSolver(self.model, config)

    def run(self, theta: nova.Tensor) -> nova.Tensor:
        """Return the losses under the forces theta (x and z at each knot)."""
        places = self.model.particle_q.numpy()
        count = len(places) // self.worlds
        right = np.flatnonzero(places[:count, 0] > 0.5 - 1e-3)
        matrix = np.zeros((2, 3 * count), np.float32)
        matrix[0, 3 * right] = matrix[1, 3 * right + 2] = 0.5 / len(right)
        pulls = stretches(self.steps, self.knots) @ self.rows(theta, matrix)
        return self.away(self.roll(forces=pulls.reshape(self.steps, len(places), 3)))
