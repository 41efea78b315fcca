"""Drop a pile of convex and concave bodies into a bowl of triangles.

The bowl is a triangle mesh that belongs to the world. A stone is a convex hull of random points. A
bracket is a concave body of two convex hulls. A second has 60 frames with 16 substeps each.
Contacts are found in every substep.

    python demo_rigid_meshes.py
    python demo_rigid_meshes.py --headless 300 --record rigid_meshes.html
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 16
DT = 1.0 / (FPS * SUBSTEPS)
CELLS, SIDE = 24, 2.4  # squares along a side of the bowl, and its length (m)
LAYERS, PER_LAYER = 6, 4
SURFACE = novaphy.ShapeConfig(density=1000.0, ke=1e4, kd=60.0, kf=80.0, mu=0.5, gap=0.02)


def bowl_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the bowl (m): flat in the middle, with a rim."""
    return 0.5 * np.maximum(np.hypot(x, y) - 0.3, 0.0) ** 2


def bowl() -> novaphy.io.Mesh:
    """Return the mesh of a bowl. Its triangles are counter-clockwise as seen from above."""
    line = np.linspace(-SIDE / 2, SIDE / 2, CELLS + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    row = CELLS + 1
    corner = (np.arange(CELLS)[:, None] * row + np.arange(CELLS)).reshape(-1, 1)
    triangles = np.concatenate([corner + np.array(k) for k in ((0, 1, row + 1), (0, row + 1, row))])
    vertices = np.stack([x, y, bowl_height(x, y)], axis=1)
    return novaphy.io.Mesh(vertices.astype(np.float32), triangles.astype(np.int32))


def box_corners(half: tuple[float, float, float], middle: tuple[float, float, float]) -> np.ndarray:
    """Return the eight corners {8, 3} of a box with half extents and a center (m)."""
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return np.asarray(middle) + np.asarray(half) * np.array(signs)


def build_model(seed: int = 0) -> novaphy.Model:
    """Build stones and brackets above the bowl."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(3, 24, 3))
    stones = directions / np.linalg.norm(directions, axis=2, keepdims=True) * (0.14, 0.11, 0.09)
    bracket = [
        box_corners((0.14, 0.05, 0.03), (0.0, 0.0, -0.05)),
        box_corners((0.03, 0.05, 0.08), (0.11, 0.0, 0.06)),
    ]
    builder = novaphy.ModelBuilder()
    builder.add_shape_mesh(-1, mesh=bowl(), cfg=SURFACE)
    for k in range(LAYERS * PER_LAYER):
        angle = 2.0 * np.pi * (k % PER_LAYER) / PER_LAYER + 0.4 * (k // PER_LAYER)
        height = 0.4 + 0.35 * (k // PER_LAYER)
        turn = random.normal(size=4)
        place = (0.25 * np.cos(angle), 0.25 * np.sin(angle), height)
        body = builder.add_body(xform=(place, turn / np.linalg.norm(turn)))
        for vertices in [stones[k % 3]] if k % 2 == 0 else bracket:
            builder.add_shape_convex_hull(body, vertices=vertices, cfg=SURFACE)
    return builder.finalize()


def simulate(model: novaphy.Model, frames: int, stage: viewer.Stage) -> novaphy.SimState:
    """Simulate some frames. Return the last state."""
    for run in stage.runs(frames):
        pipeline = novaphy.CollisionPipeline(model, broad_phase="sap")
        contacts = pipeline.contacts()
        solver = novaphy.solvers.SolverSemiImplicit(model)
        state, after = model.state(), model.state()
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, DT)
                state, after = after, state
            stage.show(frame / FPS, state)
    print(f"{int(contacts.rigid_contact_count.numpy()[0])} contacts")
    return state


def main() -> int:
    """Simulate, and check that the pile lies in the bowl. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 300, "frames of 1/60 s")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)

    model = build_model()
    with viewer.Stage(args, model, fps=FPS, look=((1.7, -2.9, 2.2), (0.0, 0.0, 0.3))) as stage:
        end = simulate(model, args.headless, stage)
    pose, speed = end.body_q.numpy(), np.linalg.norm(end.body_qd.numpy()[:, :3], axis=1)
    above = pose[:, 2] - bowl_height(pose[:, 0], pose[:, 1])
    print(f"lowest {above.min():.3f} m over the bowl  fastest {speed.max():.2f} m/s")
    if not (np.isfinite(pose).all() and above.min() > 0.0 and np.abs(pose[:, :2]).max() < SIDE / 2):
        print("CHECK FAILED: expected every body in the bowl")
        return 1
    if args.headless >= 240 and speed.max() > 0.3:
        print("CHECK FAILED: expected a pile that has come to rest")
        return 1
    print("ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())
