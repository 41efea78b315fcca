#!/usr/bin/env python3
"""Time NovaPhy on rigid bodies. rigid.py describes scenes and records.

Boxes use `SolverSemiImplicit`, with contacts in every step and four rows for a pair. Dice use
`DiffSemiImplicitSolver`, whose training iteration is captured once and replayed.
    python tools/bench/novaphy_rigid.py --scene columns --n 1000
"""

from __future__ import annotations

import numpy as np
from rigid import (
    DENSITY,
    DIE,
    DIE_DT,
    DIE_HEIGHT,
    DIE_MASS,
    DIE_SPIN,
    DIE_SUBSTEPS,
    HALF,
    MIXED_KINDS,
    MIXED_SURFACE,
    SCENES,
    SURFACE,
    PenaltyBoxes,
    box_poses,
    hills,
    mixed_poses,
    run,
    stiffer,
    stone,
)

import novaphy


class Boxes(PenaltyBoxes):
    """Boxes, or mixed shapes, under gravity on the ground."""

    def __init__(self, scene: str, n: int, turn: float, factor: float, device: str) -> None:
        """Build the model."""
        self.dt = PenaltyBoxes.dt / factor**0.5
        builder = novaphy.ModelBuilder()
        add_mixed(builder, n, factor) if scene == "mixed" else add_boxes(
            builder, scene, n, turn, factor
        )
        self.model = builder.finalize(device)
        self.solver = novaphy.solvers.SolverSemiImplicit(self.model)
        self.pipeline = novaphy.CollisionPipeline(
            self.model, broad_phase="sap", contacts_per_pair=4
        )
        self.found = self.pipeline.contacts()
        self.now, self.next = self.model.state(), self.model.state()


def add_boxes(
    builder: novaphy.ModelBuilder, scene: str, n: int, turn: float, factor: float
) -> None:
    """Add boxes in columns or in a pile."""
    surface = novaphy.ShapeConfig(density=DENSITY, **stiffer(SURFACE, factor))
    builder.add_ground_plane(cfg=surface)
    for pose in box_poses(scene, n, turn, factor):
        body = builder.add_body(xform=tuple(map(float, pose)))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)


def add_mixed(builder: novaphy.ModelBuilder, n: int, factor: float) -> None:
    """Add shapes of all kinds on a mesh."""
    surface = novaphy.ShapeConfig(density=DENSITY, gap=0.02, **stiffer(MIXED_SURFACE, factor))
    builder.add_shape_mesh(-1, mesh=novaphy.io.Mesh(*hills()), cfg=surface)
    corners, _ = stone()
    for k, pose in enumerate(mixed_poses(n)):
        body = builder.add_body(xform=tuple(map(float, pose)))
        kind = MIXED_KINDS[k % len(MIXED_KINDS)]
        if kind == "sphere":
            builder.add_shape_sphere(body, radius=HALF, cfg=surface)
        elif kind == "box":
            builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
        elif kind == "hull":
            builder.add_shape_convex_hull(body, vertices=corners, cfg=surface)
        else:
            add = getattr(builder, f"add_shape_{kind}")
            add(body, radius=0.07, half_height=0.08, cfg=surface)


class Dice:
    """Dice that fall alone, and the gradient of their last twists."""

    dt = DIE_DT * DIE_SUBSTEPS

    def __init__(self, n: int, device: str) -> None:
        """Build the model, and capture an iteration."""
        from novaphy import diff, nova

        surface = novaphy.ShapeConfig(**DIE)
        one = novaphy.ModelBuilder()
        one.add_ground_plane(cfg=surface)
        die = one.add_body(xform=(0.0, 0.0, DIE_HEIGHT, 0.0, 0.0, 0.0, 1.0), mass=DIE_MASS)
        one.add_shape_box(die, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
        builder = one
        if n > 1:
            builder = novaphy.ModelBuilder()
            builder.replicate(one, n, (1.0, 0.0, 0.0))
        self.model = builder.finalize(device, requires_grad=True)
        config = novaphy.solvers.DiffSolverConfig(
            enable_static_contacts=True, friction_law="huber", friction_smoothing=0.1
        )
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, DIE_SUBSTEPS)
        self.spin = nova.tensor(np.tile(np.float32([DIE_SPIN]), (n, 1)), device=device)
        self.spin.requires_grad = True
        with nova.ScopedCapture() as capture:
            with nova.Tape() as tape:
                twist = diff.body_twist_from_omega_generated(self.spin, 1.0, 0.0, 0.0)
                diff.state_body_qd_tensor(self.trajectory[0]).copy_(twist)
                self.solver.rollout(self.trajectory, None, None, DIE_DT)
                end = diff.state_body_qd_tensor(self.trajectory[DIE_SUBSTEPS])
                tape.backward(nova.sum(end * end))
        self.graph = capture.graph

    def step(self) -> None:
        """Run one training iteration."""
        self.graph.launch()
        novaphy.synchronize(self.model.device)

    def contacts(self) -> np.ndarray:
        """Return an empty array, because the solver finds the contacts inside of its kernel."""
        return np.zeros(0)


def make(scene: str, n: int, turn: float, factor: float, device: str) -> Boxes | Dice:
    """Return the scene with a name."""
    return Dice(n, device) if scene == "dice" else Boxes(scene, n, turn, factor, device)


if __name__ == "__main__":
    run(__doc__, "novaphy", make, SCENES)
