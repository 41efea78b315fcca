"""Rigid bodies at work: a stack that stands, dominoes that fall, a cloth over a falling box.

python demo_rigid_scenes.py
python demo_rigid_scenes.py stack
python demo_rigid_scenes.py dominoes --headless 180 --plot dominoes.png
python demo_rigid_scenes.py cloth --headless 120 --record cloth.html
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 16
DT = 1.0 / (FPS * SUBSTEPS)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
CUBE, CUBES = 0.1, 10  # m, half an edge
DOMINO, DOMINOES, SPACING = (0.02, 0.1, 0.2), 12, 0.2  # m, half extents
CLOTH_CELLS, CLOTH_CELL = 24, 0.05  # m


def build_stack() -> novaphy.ModelBuilder:
    """Ten cubes of 8 kg, one upon the other."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=2e5, kd=300.0, kf=200.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(CUBES):
        cube = builder.add_body(xform=((0.0, 0.0, CUBE * (2 * k + 1)), UPRIGHT))
        builder.add_shape_box(cube, hx=CUBE, hy=CUBE, hz=CUBE, cfg=surface)
    return builder


def build_dominoes() -> novaphy.ModelBuilder:
    """A row of upright blocks, the first of which is tipped over."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(density=600.0, ke=2e4, kd=40.0, kf=60.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    hx, hy, hz = DOMINO
    for k in range(DOMINOES):
        block = builder.add_body(xform=((SPACING * k, 0.0, hz), UPRIGHT))
        builder.add_shape_box(block, hx=hx, hy=hy, hz=hz, cfg=surface)
    builder.body_qd[0] = (0.5, 0.0, 0.0, 0.0, 2.5, 0.0)
    return builder


def build_cloth() -> novaphy.ModelBuilder:
    """A cloth above a box that falls and tumbles a little."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(density=300.0, ke=1e4, kd=40.0, kf=60.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    box = builder.add_body(xform=((0.0, 0.0, 0.45), (0.0, 0.0, np.sin(0.3), np.cos(0.3))))
    builder.add_shape_box(box, hx=0.2, hy=0.2, hz=0.2, cfg=surface)
    builder.body_qd[box] = (0.0, 0.0, 0.0, 0.4, -0.3, 0.5)
    half = CLOTH_CELLS * CLOTH_CELL / 2.0
    builder.add_cloth_grid(
        pos=(-half, -half, 0.8),
        dim_x=CLOTH_CELLS,
        dim_y=CLOTH_CELLS,
        cell_x=CLOTH_CELL,
        cell_y=CLOTH_CELL,
        mass=0.02,
        tri_ke=300.0,
        tri_ka=300.0,
        tri_kd=0.02,
        edge_ke=0.005,
        edge_kd=1e-5,
        particle_radius=0.02,
    )
    return builder


SCENES = {"stack": build_stack, "dominoes": build_dominoes, "cloth": build_cloth}
LOOKS = {
    "stack": ((0.6, -3.6, 1.4), (0.0, 0.0, 1.0)),
    "dominoes": ((1.2, -3.2, 1.2), (1.2, 0.0, 0.2)),
    "cloth": ((0.4, -2.6, 1.1), (0.0, 0.0, 0.3)),
}


def build_model(scene: str) -> novaphy.Model:
    """The model of a scene."""
    model = SCENES[scene]().finalize()
    if model.particle_count:
        model.soft_contact_ke, model.soft_contact_kd = 1e3, 1.0
        model.soft_contact_kf, model.soft_contact_mu = 1.0, 0.5
    return model


def simulate(
    model: novaphy.Model, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, np.ndarray]:
    """Poses {frames + 1, bodies, 7} and positions {frames + 1, particles, 3}."""
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    solver = novaphy.solvers.SolverSemiImplicit(model)
    state, after = model.state(), model.state()
    poses, points = [state.body_q.numpy()], [state.particle_q.numpy()]
    for frame in stage.frames(frames):
        for _ in range(SUBSTEPS):
            state.clear_forces()
            pipeline.collide(state, contacts)
            solver.step(state, after, None, contacts, DT)
            state, after = after, state
        poses.append(state.body_q.numpy())
        points.append(state.particle_q.numpy())
        stage.show(frame / FPS, state)
    return np.array(poses), np.array(points)


def upward(poses: np.ndarray) -> np.ndarray:
    """The upward part of the z axis of each pose."""
    return 1.0 - 2.0 * (poses[..., 3] ** 2 + poses[..., 4] ** 2)


def check(scene: str, poses: np.ndarray, points: np.ndarray) -> str:
    """What should be and is not; empty: nothing."""
    if scene == "stack":
        drift = np.abs(poses[-1, :, :2]).max()
        return "" if drift < 1e-3 and upward(poses[-1]).min() > 0.9999 else "a stack that stands"
    if scene == "dominoes":
        fallen = int((upward(poses[-1]) < 0.7).sum())
        return "" if fallen == DOMINOES else f"{DOMINOES} fallen dominoes, got {fallen}"
    inside = (np.abs(local(poses[-1, 0], points[-1])) < 0.18).all(axis=1).sum()
    heights = points[-1, :, 2]
    draped = 0.35 < heights.max() < 0.6 and -0.05 < heights.min() < 0.25
    return "" if inside == 0 and draped else "a cloth that hangs over the box"


def local(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of the world {n, 3} in the frame of a pose."""
    q = pose[3:] * (-1.0, -1.0, -1.0, 1.0)
    return rotate(q, points - pose[:3])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors {n, 3} turned by a quaternion xyzw."""
    t = 2.0 * np.cross(q[:3], v)
    return v + q[3] * t + np.cross(q[:3], t)


def plot(path: str, model: novaphy.Model, poses: np.ndarray, points: np.ndarray) -> None:
    """Draw the scene from the side at four times."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.6), sharey=True, layout="constrained")
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    edges = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    places = np.concatenate([poses[..., 0].ravel(), points[..., 0].ravel()])
    middle, reach = (places.max() + places.min()) / 2, np.ptp(places) / 2 + 0.5
    shape_body, scale = model.shape_body.numpy(), model.shape_scale.numpy()
    for axis, frame in zip(axes, np.linspace(0, len(poses) - 1, 4).astype(int), strict=True):
        if points.shape[1]:
            grid = points[frame].reshape(CLOTH_CELLS + 1, CLOTH_CELLS + 1, 3)
            for lines in (grid, grid.transpose(1, 0, 2)):
                axis.plot(lines[..., 0].T, lines[..., 2].T, color="#e09f3e", lw=0.6)
        for shape, body in enumerate(shape_body):
            if body < 0:
                continue
            pose = poses[frame, body]
            corners = pose[:3] + rotate(pose[3:], scale[shape] * signs)
            for a, b in edges:
                axis.plot(*corners[[a, b]][:, [0, 2]].T, color="#2a6f97", lw=0.9)
        axis.axhline(0.0, color="0.3")
        axis.set(xlabel="x (m)", title=f"{frame / FPS:.2f} s", aspect="equal")
        axis.set_xlim(middle - reach, middle + reach)
    axes[0].set_ylabel("z (m)")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw, and check what is left."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=SCENES, nargs="?", default="cloth")
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the scene at four times")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.plot and not Path(args.plot).parent.is_dir():
        parser.error(f"the folder of {args.plot} does not exist")

    model = build_model(args.scene)
    with viewer.Stage(args, model, fps=FPS, look=LOOKS[args.scene]) as stage:
        poses, points = simulate(model, args.headless, stage)
    if args.plot:
        plot(args.plot, model, poses, points)
    missing = check(args.scene, poses, points) if args.headless >= 120 else ""
    if missing:
        print(f"CHECK FAILED: expected {missing}")
        return 1
    print(f"{args.scene}: {args.headless} frames, ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())
