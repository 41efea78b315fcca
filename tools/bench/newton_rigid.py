#!/usr/bin/env python3
"""Time Newton on rigid bodies. rigid.py describes scenes and records.

Boxes use `SolverSemiImplicit`, with contacts by sweep and prune in every step. Dice use the same
solver under `wp.Tape`, launched step by step, as in Newton's differentiable examples.
    pip install newton==1.8.0 warp-lang==1.19.0
    python tools/bench/newton_rigid.py --scene columns --n 1000
"""

from __future__ import annotations

import newton
import numpy as np
import warp as wp
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


@wp.kernel
def squares_kernel(twist: wp.array[wp.spatial_vector], loss: wp.array[float]):
    """Add the squared norm of a twist."""
    v = twist[wp.tid()]
    wp.atomic_add(loss, 0, wp.dot(v, v))


class Boxes(PenaltyBoxes):
    """Boxes, or mixed shapes, under gravity on the ground."""

    def __init__(self, scene: str, n: int, turn: float, factor: float, device: str) -> None:
        """Build the model."""
        wp.set_device(device)
        self.dt = PenaltyBoxes.dt / factor**0.5
        builder = newton.ModelBuilder()
        add_mixed(builder, n, factor) if scene == "mixed" else add_boxes(
            builder, scene, n, turn, factor
        )
        self.model = builder.finalize()
        self.solver = newton.solvers.SolverSemiImplicit(self.model)
        self.pipeline = newton.CollisionPipeline(self.model, broad_phase="sap")
        self.found = self.pipeline.contacts()
        self.now, self.next = self.model.state(), self.model.state()

    def step(self) -> None:
        """Find contacts, run one step, and wait for the device."""
        super().step()
        wp.synchronize()


def add_boxes(builder: newton.ModelBuilder, scene: str, n: int, turn: float, factor: float) -> None:
    """Add boxes in columns or in a pile."""
    surface = newton.ModelBuilder.ShapeConfig(density=DENSITY, **stiffer(SURFACE, factor))
    builder.add_ground_plane(cfg=surface)
    for pose in box_poses(scene, n, turn, factor):
        body = builder.add_body(xform=wp.transform(pose[:3], wp.quat(*pose[3:])))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)


def add_mixed(builder: newton.ModelBuilder, n: int, factor: float) -> None:
    """Add shapes of all kinds on a mesh."""
    surface = newton.ModelBuilder.ShapeConfig(
        density=DENSITY, gap=0.02, **stiffer(MIXED_SURFACE, factor)
    )
    vertices, triangles = hills()
    ground = newton.Mesh(vertices, triangles.ravel(), compute_inertia=False)
    builder.add_shape_mesh(-1, mesh=ground, cfg=surface)
    corners, faces = stone()
    hull = newton.Mesh(corners, faces.ravel(), compute_inertia=True)
    for k, pose in enumerate(mixed_poses(n)):
        body = builder.add_body(xform=wp.transform(pose[:3], wp.quat(*pose[3:])))
        kind = MIXED_KINDS[k % len(MIXED_KINDS)]
        if kind == "sphere":
            builder.add_shape_sphere(body, radius=HALF, cfg=surface)
        elif kind == "box":
            builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
        elif kind == "hull":
            builder.add_shape_convex_hull(body, mesh=hull, cfg=surface)
        else:
            add = getattr(builder, f"add_shape_{kind}")
            add(body, radius=0.07, half_height=0.08, cfg=surface)


class Dice:
    """Dice that fall far apart from each other, and the gradient of their last twists."""

    dt = DIE_DT * DIE_SUBSTEPS

    def __init__(self, n: int, device: str) -> None:
        """Build the model and its states."""
        wp.set_device(device)
        surface = newton.ModelBuilder.ShapeConfig(**DIE)
        builder = newton.ModelBuilder()
        builder.add_ground_plane(cfg=surface)
        for i in range(n):
            place = wp.transform((1.0 * i, 0.0, DIE_HEIGHT), wp.quat_identity())
            die = builder.add_body(xform=place, mass=DIE_MASS)
            builder.add_shape_box(die, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
        self.model = builder.finalize(requires_grad=True)
        self.solver = newton.solvers.SolverSemiImplicit(self.model)
        self.pipeline = newton.CollisionPipeline(
            self.model, broad_phase="explicit", requires_grad=True
        )
        self.states = [self.model.state() for _ in range(DIE_SUBSTEPS + 1)]
        start = np.tile(np.float32([(1.0, 0.0, 0.0, *DIE_SPIN)]), (n, 1))
        self.states[0].body_qd.assign(start)
        self.loss = wp.zeros(1, dtype=wp.float32, requires_grad=True)

    def step(self) -> None:
        """Run one training iteration."""
        self.loss.zero_()
        tape = wp.Tape()
        with tape:
            for before, after in zip(self.states, self.states[1:], strict=False):
                before.clear_forces()
                found = self.pipeline.contacts()
                self.pipeline.collide(before, found)
                self.solver.step(before, after, None, found, DIE_DT)
            last = self.states[-1].body_qd
            wp.launch(squares_kernel, dim=len(last), inputs=[last, self.loss])
        tape.backward(self.loss)
        tape.zero()
        wp.synchronize()

    def contacts(self) -> np.ndarray:
        """Return an empty array, because this scene counts no contacts."""
        return np.zeros(0)


def make(scene: str, n: int, turn: float, factor: float, device: str) -> Boxes | Dice:
    """Return the scene with a name."""
    return Dice(n, device) if scene == "dice" else Boxes(scene, n, turn, factor, device)


if __name__ == "__main__":
    run(__doc__, "newton", make, SCENES)
