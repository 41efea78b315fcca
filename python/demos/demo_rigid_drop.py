"""Throw three dice on the ground, and wait until they rest on a face.

Each die is a box of 12 kg. The dice have different initial velocities and angular velocities. A
second has 60 frames with 16 substeps each. Contacts are found in every substep.

    python demo_rigid_drop.py
    python demo_rigid_drop.py --headless 180 --plot rigid_drop.png --record rigid_drop.html
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 16
DT = 1.0 / (FPS * SUBSTEPS)
HALF = 0.1  # half an edge of a die (m)
STARTS = [  # x (m); linear and angular velocity (m/s, rad/s)
    (-1.0, (0.6, 0.0, 0.0, 1.0, 5.0, 2.0)),
    (0.0, (0.3, 0.2, 0.0, -4.0, 1.0, 3.0)),
    (1.0, (-0.4, 0.0, 1.0, 2.0, -7.0, 0.5)),
]


def build_model() -> novaphy.Model:
    """Build three dice above the ground plane."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for x, velocity in STARTS:
        die = builder.add_body(xform=((x, 0.0, 0.6), (0.0, 0.0, 0.0, 1.0)), mass=4.0)
        builder.add_shape_box(die, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
        builder.body_qd[die] = velocity
    return builder.finalize()


def simulate(
    model: novaphy.Model, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, novaphy.SimState]:
    """Return the poses {frames + 1, dice, 7} and the last state."""
    for run in stage.runs(frames):
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        solver = novaphy.solvers.SolverSemiImplicit(model)
        state, after = model.state(), model.state()
        poses = [state.body_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, DT)
                state, after = after, state
            poses.append(state.body_q.numpy())
            stage.show(frame / FPS, state, contacts)
    return np.array(poses), state


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return vectors {n, 3} rotated by a quaternion xyzw."""
    t = 2.0 * np.cross(q[:3], v)
    return v + q[3] * t + np.cross(q[:3], t)


def plot(path: str, poses: np.ndarray) -> None:
    """Draw the heights over time, and the dice from the side at ten times."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11.0, 4.2), width_ratios=(4.4, 6.6), layout="constrained"
    )
    colors = ("#2a6f97", "#c1666b", "#4f772d")
    left.plot(np.arange(len(poses)) / FPS, poses[:, :, 2])
    for line, color in zip(left.lines, colors, strict=True):
        line.set_color(color)
    left.axhline(HALF, color="0.6", linestyle=":")
    left.set(xlabel="time (s)", ylabel="height (m)", title="Centers of the dice")
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    edges = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    for frame in np.linspace(0, len(poses) - 1, 10).astype(int):
        for pose, color in zip(poses[frame], colors, strict=True):
            corners = pose[:3] + rotate(pose[3:], HALF * signs)
            for a, b in edges:
                alpha = 0.15 + 0.85 * frame / max(len(poses) - 1, 1)
                right.plot(*corners[[a, b]][:, [0, 2]].T, color=color, alpha=alpha, lw=0.8)
    right.axhline(0.0, color="0.3")
    right.set(xlabel="x (m)", ylabel="z (m)", title="From the side", aspect="equal")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw, and check that the dice rest. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:1, dlan, ...")
    parser.add_argument("--dump-states", metavar="PATH.npz", help="write the poses")
    parser.add_argument("--plot", metavar="PATH.png", help="draw heights and dice")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)

    novaphy.set_default_device(args.device)
    model = build_model()
    look = ((0.8, -2.7, 1.1), (0.1, 0.0, 0.2))
    with viewer.Stage(args, model, fps=FPS, look=look) as stage:
        poses, end = simulate(model, args.headless, stage)
    if args.dump_states:
        np.savez_compressed(args.dump_states, body_q=poses, body_qd=end.body_qd.numpy())
    if args.plot:
        plot(args.plot, poses)
    weight = float(model.body_mass.numpy()[0]) * 9.81
    rest = HALF - weight / (4 * 1e4)  # minus the overlap of a face on four contacts of 1e4 N/m
    heights, speeds = end.body_q.numpy()[:, 2], np.linalg.norm(end.body_qd.numpy(), axis=1)
    for height, speed in zip(heights, speeds, strict=True):
        print(f"height {height:.5f} m  speed {speed:.1e}")
    if args.headless >= 150 and (np.abs(heights - rest).max() > 1e-4 or speeds.max() > 1e-2):
        print(f"CHECK FAILED: expected dice at rest on a face, {rest:.5f} m high")
        return 1
    print("ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())
