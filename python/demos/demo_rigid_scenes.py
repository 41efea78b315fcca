"""Rigid bodies at work: a stack, dominoes, a cloth over a box, a wall that breaks, a pendulum.

python demo_rigid_scenes.py
python demo_rigid_scenes.py stack
python demo_rigid_scenes.py dominoes --headless 180 --plot dominoes.png
python demo_rigid_scenes.py cloth --headless 120 --record cloth.html
python demo_rigid_scenes.py wall
python demo_rigid_scenes.py pendulum
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 16
DT = 1.0 / (FPS * SUBSTEPS)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
CUBE, CUBES = 0.1, 10  # half an edge of a cube (m), number of cubes
DOMINO, DOMINOES, SPACING = (0.02, 0.1, 0.2), 12, 0.2  # half extents (m), number, distance (m)
CLOTH_CELLS, CLOTH_CELL = 24, 0.05  # cells along a side, size of a cell (m)
BRICK, COURSES, BRICKS = (0.1, 0.05, 0.05), 6, 6  # half extents (m), rows, bricks in a row
LINKS, LINK = 4, 0.3  # number of rods, length of a rod (m)


def build_stack() -> novaphy.ModelBuilder:
    """Build a stack of ten cubes of 8 kg."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=2e5, kd=300.0, kf=200.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(CUBES):
        cube = builder.add_body(xform=((0.0, 0.0, CUBE * (2 * k + 1)), UPRIGHT))
        builder.add_shape_box(cube, hx=CUBE, hy=CUBE, hz=CUBE, cfg=surface)
    return builder


def build_dominoes() -> novaphy.ModelBuilder:
    """Build a row of upright blocks, the first of which is tipped over."""
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
    """Build a cloth above a box that falls and tumbles a little."""
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


def build_wall() -> novaphy.ModelBuilder:
    """Build a wall of bricks in staggered courses, and a ball that flies towards the wall."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(density=800.0, ke=2e4, kd=20.0, kf=30.0, mu=0.6)
    builder.add_ground_plane(cfg=surface)
    hx, hy, hz = BRICK
    for course in range(COURSES):
        for k in range(BRICKS):
            x = 2 * hx * (k - 0.5 * (BRICKS - 1)) + (0.5 * hx if course % 2 else -0.5 * hx)
            brick = builder.add_body(xform=((x, 0.0, hz * (2 * course + 1)), UPRIGHT))
            builder.add_shape_box(brick, hx=hx, hy=hy, hz=hz, cfg=surface)
    ball = builder.add_body(xform=((0.0, -1.0, 0.4), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.12, cfg=surface)
    builder.body_qd[ball] = (0.3, 8.0, 0.5, 0.0, 0.0, 0.0)
    return builder


def build_pendulum() -> novaphy.ModelBuilder:
    """Build a chain of rods that starts at an angle. Penalty joints (springs) connect the rods."""
    builder = novaphy.ModelBuilder()
    rod = novaphy.ShapeConfig(density=0.0, collision_group=0)
    turn = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))  # rotates z to x
    last, joints = -1, []
    for k in range(LINKS):
        link = builder.add_link(
            xform=(((k + 0.5) * LINK, 0.0, 1.4), turn), mass=1.0, inertia=np.eye(3) * 0.01
        )
        builder.add_shape_box(link, hx=0.03, hy=0.03, hz=0.5 * LINK, cfg=rod)
        anchor = ((0.0, 0.0, 1.4), turn) if last < 0 else ((0.0, 0.0, 0.5 * LINK), UPRIGHT)
        joints.append(
            builder.add_joint_revolute(
                last,
                link,
                axis=novaphy.Axis.Y,
                parent_xform=anchor,
                child_xform=((0.0, 0.0, -0.5 * LINK), UPRIGHT),
            )
        )
        last = link
    builder.add_articulation(joints)
    return builder


SCENES = {
    "stack": build_stack,
    "dominoes": build_dominoes,
    "cloth": build_cloth,
    "wall": build_wall,
    "pendulum": build_pendulum,
}
LOOKS = {
    "stack": ((0.6, -3.6, 1.4), (0.0, 0.0, 1.0)),
    "dominoes": ((1.2, -3.2, 1.2), (1.2, 0.0, 0.2)),
    "cloth": ((0.4, -2.6, 1.1), (0.0, 0.0, 0.3)),
    "wall": ((1.6, -2.2, 1.2), (0.0, 0.3, 0.3)),
    "pendulum": ((0.0, -3.4, 1.0), (0.0, 0.0, 0.8)),
}


def build_model(scene: str) -> novaphy.Model:
    """Return the model of a scene."""
    model = SCENES[scene]().finalize()
    if model.particle_count:
        model.soft_contact_ke, model.soft_contact_kd = 1e3, 1.0
        model.soft_contact_kf, model.soft_contact_mu = 1.0, 0.5
    return model


def simulate(
    model: novaphy.Model, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, np.ndarray]:
    """Return poses {frames + 1, bodies, 7} and positions {frames + 1, particles, 3} (m)."""
    for run in stage.runs(frames):
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        solver = novaphy.solvers.SolverSemiImplicit(model)
        state, after = model.state(), model.state()
        poses, points = [state.body_q.numpy()], [state.particle_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, DT)
                state, after = after, state
            poses.append(state.body_q.numpy())
            points.append(state.particle_q.numpy())
            stage.show(frame / FPS, state)
    return np.array(poses), np.array(points)


def upward(poses: np.ndarray) -> np.ndarray:
    """Return the vertical component of the z axis of each pose {n}."""
    return 1.0 - 2.0 * (poses[..., 3] ** 2 + poses[..., 4] ** 2)


def check(scene: str, poses: np.ndarray, points: np.ndarray) -> str:
    """Return a text about the failed checks of a scene; "": all checks passed."""
    if scene == "stack":
        drift = np.abs(poses[-1, :, :2]).max()
        return "" if drift < 1e-3 and upward(poses[-1]).min() > 0.9999 else "a stack that stands"
    if scene == "dominoes":
        fallen = int((upward(poses[-1]) < 0.7).sum())
        return "" if fallen == DOMINOES else f"{DOMINOES} fallen dominoes, got {fallen}"
    if scene == "wall":
        broken = int((np.linalg.norm(poses[-1, :-1, :3] - poses[0, :-1, :3], axis=1) > 0.1).sum())
        above = poses[-1, :, 2].min() > 0.02
        return "" if broken >= 8 and above else f"8 bricks out of the wall, got {broken}"
    if scene == "pendulum":
        tops = [
            pose[:3] + rotate(pose[3:], np.float64([[0, 0, -0.5 * LINK]]))[0] for pose in poses[-1]
        ]
        ends = [
            pose[:3] + rotate(pose[3:], np.float64([[0, 0, 0.5 * LINK]]))[0] for pose in poses[-1]
        ]
        gaps = np.linalg.norm(np.array(tops) - np.array([(0, 0, 1.4), *ends[:-1]]), axis=1)
        return "" if gaps.max() < 0.02 else f"hinges that hold, got gaps of {gaps.max():.3f} m"
    inside = (np.abs(local(poses[-1, 0], points[-1])) < 0.18).all(axis=1).sum()
    heights = points[-1, :, 2]
    draped = 0.35 < heights.max() < 0.6 and -0.05 < heights.min() < 0.25
    return "" if inside == 0 and draped else "a cloth that hangs over the box"


def local(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points {n, 3} (m, world frame) in the frame of a pose {7}."""
    q = pose[3:] * (-1.0, -1.0, -1.0, 1.0)
    return rotate(q, points - pose[:3])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return vectors {n, 3} rotated by a quaternion xyzw."""
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
    places = np.concatenate([poses[..., :2].ravel(), points[..., :2].ravel()])
    middle, reach = (places.max() + places.min()) / 2, np.ptp(places) / 2 + 0.5
    if poses[..., 1].max() > 5.0:  # some bricks have flown far from the wall
        middle, reach = 0.3, 1.6
    shape_body, scale = model.shape_body.numpy(), model.shape_scale.numpy()
    is_ball = model.shape_type.numpy() == novaphy.GeoType.SPHERE
    view = 1 if is_ball.any() else 0  # look at the wall from the side of the ball
    for axis, frame in zip(axes, np.linspace(0, len(poses) - 1, 4).astype(int), strict=True):
        if points.shape[1]:
            grid = points[frame].reshape(CLOTH_CELLS + 1, CLOTH_CELLS + 1, 3)
            for lines in (grid, grid.transpose(1, 0, 2)):
                axis.plot(lines[..., 0].T, lines[..., 2].T, color="#e09f3e", lw=0.6)
        for shape, body in enumerate(shape_body):
            if body < 0:
                continue
            pose = poses[frame, body]
            if is_ball[shape]:
                center, radius = pose[[view, 2]], scale[shape, 0]
                axis.add_patch(plt.Circle(center, radius, fill=False, color="#c1121f"))
                continue
            corners = pose[:3] + rotate(pose[3:], scale[shape] * signs)
            for a, b in edges:
                axis.plot(*corners[[a, b]][:, [view, 2]].T, color="#2a6f97", lw=0.9)
        axis.axhline(0.0, color="0.3")
        axis.set(xlabel=f"{'xy'[view]} (m)", title=f"{frame / FPS:.2f} s", aspect="equal")
        axis.set_xlim(middle - reach, middle + reach)
    axes[0].set_ylabel("z (m)")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw and check a scene. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=SCENES, nargs="?", default="cloth")
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the scene at four times")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)

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
