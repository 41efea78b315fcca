"""Scenes that several tests share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import novaphy

GOLDEN = Path(__file__).parents[1] / "golden"
STEPS = 36 * 8
DT = 1.0 / 60.0 / 8.0
TARGET = (0.0, -2.0, 1.5)
LEARNING_RATE = 0.02


def golden(name: str) -> dict[str, np.ndarray]:
    """The arrays of a golden file; a missing one fails."""
    with np.load(GOLDEN / f"{name}.npz", allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def ball_builder(balls: int = 1) -> novaphy.ModelBuilder:
    """Balls before a wall, over the ground: Newton's diffsim_ball."""
    builder = novaphy.ModelBuilder()
    for k in range(balls):
        x = 0.0 if balls == 1 else (k % 7 - 3) * 0.05
        builder.add_particle((x, -0.5, 1.0), (0.0, 5.0, -5.0), 1.0)
    cfg = novaphy.ShapeConfig(ke=1.0e4, kd=10.0, kf=0.0, mu=0.2)
    wall = ((0.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0))
    builder.add_shape_box(-1, xform=wall, hx=1.0, hy=0.25, hz=1.0, cfg=cfg)
    builder.add_ground_plane(cfg=cfg)
    return builder


def ball_model(balls: int = 1) -> novaphy.Model:
    """The model of the balls."""
    model = ball_builder(balls).finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 1.0e4, 10.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
    model.soft_contact_restitution = 1.0  # as there; no force uses it
    return model


def soft_body_model(device: str = "cpu") -> novaphy.Model:
    """The block of Newton's diffsim_soft_body."""
    builder = novaphy.ModelBuilder()
    builder.default_particle_radius = 0.0005
    density = 0.2 / 27 / 0.1**3
    builder.add_soft_grid(
        pos=(-0.1, -0.5, 1.0),
        vel=(0.0, 6.0, -6.0),
        dim_x=2,
        dim_y=2,
        dim_z=2,
        cell_x=0.1,
        cell_y=0.1,
        cell_z=0.1,
        density=density,
        k_mu=0.5 * 1.5e4 / 1.3,
        k_lambda=1.5e4 * 0.3 / (1.3 * 0.4),
        k_damp=0.0,
        tri_ke=1e-4,
        tri_ka=1e-4,
        tri_kd=1e-4,
    )
    # In Newton each particle has the mass of a cell.
    builder.particle_mass = [0.1 * 0.1 * 0.1 * density] * builder.particle_count
    cfg = novaphy.ShapeConfig(ke=1.0e3, kd=1.0, kf=0.0, mu=0.2)
    builder.add_shape_box(
        -1, xform=((0.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0)), hx=1.0, hy=0.25, hz=1.0, cfg=cfg
    )
    builder.add_ground_plane(cfg=cfg)
    model = builder.finalize(device, requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 1.0e3, 1.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
    return model


def ball_contacts(model: novaphy.Model, state: novaphy.SimState) -> novaphy.Contacts:
    """The contacts of the first state, as Newton's example keeps them."""
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=10.0)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    return contacts


class Ball:
    """The ball as a loop of steps."""

    def __init__(self, balls: int = 1, steps: int = STEPS) -> None:
        """Make the states and the contacts."""
        from novaphy import diff, solvers

        self.diff = diff
        self.model = ball_model(balls)
        self.solver = solvers.DiffSemiImplicitSolver(
            self.model, solvers.DiffSolverConfig(contact_gradient="code")
        )
        self.states = [self.model.state() for _ in range(steps + 1)]
        self.contacts = ball_contacts(self.model, self.states[0])
        self.velocity = diff.state_particle_qd_tensor(self.states[0], requires_grad=True)

    def loss(self):
        """Squared distance of the last position to the target."""
        last = self.diff.state_particle_q_tensor(self.states[-1])
        return self.diff.particle_point_loss_generated(last, 0, *TARGET)

    def forward(self):
        """All steps; the loss."""
        for now, then in zip(self.states, self.states[1:]):
            now.clear_forces()
            self.solver.step(now, then, None, self.contacts, DT)
        return self.loss()

    def array(self, field: str) -> np.ndarray:
        """A field of all states, {steps + 1, ...}."""
        return np.stack([getattr(state, field).numpy() for state in self.states])
