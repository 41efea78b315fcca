"""A ball on a chain knocks over a stack of ten boxes, by rigid bodies in SolverVBD.

The ball weighs 20 times as much as a link of its chain. The program checks that the chain keeps its
length and that the stack stands until the ball comes, then falls.

    python demo_vbd_wrecking_ball.py --headless 240 --plot wreck.png
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import novaphy
from novaphy import viewer
from novaphy.solvers import SolverVBD

FPS, SUBSTEPS = 60, 2
LINKS, LINK, BOX, RADIUS = 10, 0.2, 0.1, 0.16  # links; m: link length, half a box, ball radius
HEIGHT = LINKS * LINK + RADIUS + 0.9
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def build_model() -> novaphy.Model:
    """Build the stack of boxes, and the chain, which starts horizontal with the ball at its end."""
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e5, kd=50.0, mu=0.5, density=1000.0)
    wood = novaphy.ShapeConfig(ke=1e5, kd=50.0, mu=0.5, density=300.0)
    builder.add_ground_plane()
    for k in range(10):
        body = builder.add_body(xform=((0.0, 0.0, BOX * (2 * k + 1)), IDENTITY))
        color = (0.76, 0.6, 0.42) if k % 2 else (0.55, 0.38, 0.24)
        builder.add_shape_box(body, hx=BOX, hy=BOX, hz=BOX, cfg=wood, color=color)
    before, joints = -1, []
    for k in range(LINKS):
        x = -0.3 - LINK * (k + 0.5)
        link = builder.add_link(xform=((x, 0.0, HEIGHT), IDENTITY))
        builder.add_shape_capsule(
            link,
            xform=((0.0, 0.0, 0.0), (0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4))),
            radius=0.03,
            half_height=0.5 * LINK - 0.03,
        )
        start = (-0.3, 0.0, HEIGHT) if k == 0 else (-0.5 * LINK, 0.0, 0.0)
        joints.append(builder.add_joint_ball(
            before, link, parent_xform=(start, IDENTITY),
            child_xform=((0.5 * LINK, 0.0, 0.0), IDENTITY),
        ))  # fmt: skip
        before = link
    ball = builder.add_link(xform=((-0.3 - LINK * LINKS - RADIUS, 0.0, HEIGHT), IDENTITY))
    builder.add_shape_sphere(ball, radius=RADIUS)
    joints.append(builder.add_joint_fixed(
        before, ball, parent_xform=((-0.5 * LINK, 0.0, 0.0), IDENTITY),
        child_xform=((RADIUS, 0.0, 0.0), IDENTITY),
    ))  # fmt: skip
    builder.add_articulation(joints)
    return builder.finalize()


def simulate(model: novaphy.Model, frames: int, stage: viewer.Stage) -> np.ndarray:
    """Return the poses {frames + 1, bodies, 7} of every frame."""
    poses = []
    for run in stage.runs(frames):
        solver, pipeline = SolverVBD(model), novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        state, after = model.state(), model.state()
        poses = [state.body_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, 1.0 / (FPS * SUBSTEPS))
                state, after = after, state
            poses.append(state.body_q.numpy())
            stage.show(frame / FPS, state, contacts)
    return np.array(poses)


def turned(pose: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    """Return a point of a body in the world (m)."""
    q, v = pose[3:6], np.array(point)
    t = 2.0 * np.cross(q, v)
    return pose[:3] + v + pose[6] * t + np.cross(q, t)


def longest_gap(poses: np.ndarray) -> float:
    """Return the largest gap (m) between the two sides of a joint of the chain."""
    links = poses[10 : 10 + LINKS]
    starts = [turned(pose, (0.5 * LINK, 0.0, 0.0)) for pose in links]
    ends = [turned(pose, (-0.5 * LINK, 0.0, 0.0)) for pose in links]
    return float(max(np.linalg.norm(a - b) for a, b in zip(ends, starts[1:], strict=False)))


def plot(path: str, poses: np.ndarray) -> None:
    """Draw the scene from the side at six times."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    corners = [(x, 0.0, z) for x, z in ((-BOX, -BOX), (BOX, -BOX), (BOX, BOX), (-BOX, BOX))]
    figure, rows = plt.subplots(1, 6, figsize=(13.0, 3.2), sharey=True, layout="constrained")
    for axes, frame in zip(rows, np.linspace(0, len(poses) - 1, 6).astype(int), strict=True):
        for pose in poses[frame, :10]:
            square = np.array([turned(pose, c) for c in corners])
            axes.fill(square[:, 0], square[:, 2], facecolor="#c1996b", edgecolor="#5b4327", lw=0.6)
        axes.plot(*poses[frame, 10:, :3][:, [0, 2]].T, color="#22445f", lw=1.2)
        x, _, z = poses[frame, -1, :3]
        axes.add_patch(plt.Circle((x, z), RADIUS, color="#22445f"))
        axes.set(xlim=(-2.8, 3.0), ylim=(0, 3.4), aspect="equal", title=f"{frame / FPS:.2f} s")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Simulate, draw and check. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 240, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the scene at six times")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    model = build_model()
    look = ((0.5, -6.5, 2.2), (-0.2, 0.0, 1.3))
    with viewer.Stage(args, model, fps=FPS, look=look) as stage:
        poses = simulate(model, args.headless, stage)
    if args.plot:
        plot(args.plot, poses)
    gap = max(longest_gap(frame) for frame in poses)
    top = poses[:, 9, 2]
    print(f"largest gap of the chain {1e3 * gap:.3f} mm, top box at {top[-1]:.2f} m")
    faults = [] if gap < 5e-3 else ["a chain that stays together"]
    if args.headless >= 200:
        faults += [] if abs(top[30] - top[0]) < 0.02 else ["a stack that stands for 0.5 s"]
        faults += [] if top[-1] < 1.0 else ["a stack that falls"]
    for fault in faults:
        print(f"CHECK FAILED: expected {fault}")
    if not faults:
        print("ok")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
