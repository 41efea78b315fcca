"""Stiff cloth and soft bodies by Vertex Block Descent, one step a frame.

There are five scenes, and each ends with a check:

hanging: a cloth hangs from one side.
draped: a cloth falls over a sphere.
twisted: a bar is twisted by its ends.
crushed: a block starts flat and turned inside out.
net: a net of springs catches heavy particles, which hit it at 3 m/s and stay in its knots.

--check-grad compares the gradient of one more frame, with respect to its velocities, with
differences.

    python demo_vbd.py draped --headless 120 --plot draped.png
    python demo_vbd.py draped --headless 60 --check-grad
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import novaphy
from novaphy import viewer
from novaphy.solvers import SolverVBD

FPS = 60


@dataclass
class Scene:
    """A model, the options of its steps, and the check of its end."""

    model: novaphy.Model
    iterations: int
    substeps: int = 1
    turn: float = 0.0  # rad/s, the relative angular velocity of the kinematic ends


def hanging() -> Scene:
    """Build a cloth of 1 m that swings down from its fixed left side."""
    builder = novaphy.ModelBuilder()
    cloth = {"tri_ke": 2e3, "tri_ka": 2e3, "tri_kd": 1e-2, "edge_ke": 1e-3, "edge_kd": 1e-5}
    builder.add_cloth_grid(
        pos=(0.0, -0.5, 1.2), dim_x=32, dim_y=32, cell_x=1 / 32, cell_y=1 / 32, mass=2e-4,
        fix_left=True, **cloth,
    )  # fmt: skip
    builder.color()
    return Scene(builder.finalize(), iterations=20, substeps=4)


def draped() -> Scene:
    """Build a cloth of 1.2 m that falls over a sphere."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=1e3, kd=1e-2, mu=0.5)
    builder.default_shape_cfg = surface
    builder.add_shape_sphere(-1, xform=((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)), radius=0.3)
    builder.add_ground_plane()
    cloth = {"tri_ke": 1e3, "tri_ka": 1e3, "tri_kd": 1e-2, "edge_ke": 1e-3, "edge_kd": 1e-5}
    builder.add_cloth_grid(
        pos=(-0.6, -0.6, 0.9), dim_x=40, dim_y=40, cell_x=0.03, cell_y=0.03, mass=2e-4,
        particle_radius=0.01, **cloth,
    )  # fmt: skip
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e3, 1e-2, 0.5
    return Scene(model, iterations=10, substeps=4)


def twisted() -> Scene:
    """Build a bar of 1 m, whose ends are rotated against each other by a full turn."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_soft_grid(
        pos=(0.0, -0.1, 0.3), dim_x=30, dim_y=6, dim_z=6, cell_x=1 / 30, cell_y=1 / 30,
        cell_z=1 / 30, density=1000.0, k_mu=1e6, k_lambda=4e6, k_damp=100.0, fix_left=True,
        fix_right=True,
    )  # fmt: skip
    builder.color()
    return Scene(builder.finalize(), iterations=30, turn=2 * np.pi / 2.0)


def crushed() -> Scene:
    """Build a block that starts flat, with every second layer on the wrong side."""
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e4, kd=1.0, mu=0.5)
    builder.add_ground_plane()
    builder.add_soft_grid(
        pos=(-0.25, -0.25, 0.2), dim_x=10, dim_y=10, dim_z=10, cell_x=0.05, cell_y=0.05,
        cell_z=0.05, density=1000.0, k_mu=5e4, k_lambda=1e5, k_damp=20.0, particle_radius=0.01,
    )  # fmt: skip
    rest = np.array(builder.particle_q)
    layer = np.round((rest[:, 2] - 0.2) / 0.05).astype(int)
    flat = rest.copy()
    flat[:, 2] = 0.3 + 0.002 * (-1.0) ** layer * layer
    builder.particle_q = flat
    builder.color()
    return Scene(builder.finalize(), iterations=40, substeps=2)


def net() -> Scene:
    """Build a net of springs with a fixed rim. Nine heavy particles fall into its knots."""
    builder = novaphy.ModelBuilder()
    count, mesh = 21, 0.05
    side = mesh * (count - 1)
    for row in range(count):
        for column in range(count):
            rim = row in (0, count - 1) or column in (0, count - 1)
            caught = row in (5, 10, 15) and column in (5, 10, 15)
            builder.add_particle(
                (mesh * column - 0.5 * side, mesh * row - 0.5 * side, 1.0),
                (0.0, 0.0, -3.0 if caught else 0.0),
                0.0 if rim else 0.2 if caught else 2e-3,
                0.02 if caught else 0.004,
            )
    for row in range(count):
        for column in range(count):
            knot = row * count + column
            if column + 1 < count:
                builder.add_spring(knot, knot + 1, 2e3, 20.0)
            if row + 1 < count:
                builder.add_spring(knot, knot + count, 2e3, 20.0)
    builder.color()
    return Scene(builder.finalize(), iterations=30, substeps=4)


SCENES = {
    "hanging": hanging, "draped": draped, "twisted": twisted, "crushed": crushed, "net": net,
}  # fmt: skip
LOOKS = {
    "hanging": ((2.4, -2.4, 1.4), (0.3, 0.0, 0.7)),
    "draped": ((1.6, -1.8, 1.2), (0.0, 0.0, 0.4)),
    "twisted": ((0.5, -1.5, 0.9), (0.5, 0.0, 0.4)),
    "crushed": ((1.2, -1.4, 0.9), (0.0, 0.0, 0.3)),
    "net": ((1.5, -1.7, 1.5), (0.0, 0.0, 0.85)),
}


def turned(rest: np.ndarray, angle: float) -> np.ndarray:
    """Return points of the bar's ends, rotated about its x axis by +angle / 2 and -angle / 2."""
    center = np.array([0.0, 0.0, 0.4], np.float32)
    signed = np.where(rest[:, 0] > 0.5, 0.5, -0.5) * angle
    x, y, z = (rest - center).T
    c, s = np.cos(signed), np.sin(signed)
    return np.stack([x, c * y - s * z, s * y + c * z], 1).astype(np.float32) + center


def simulate(
    scene: Scene, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, SolverVBD, novaphy.SimState]:
    """Return the positions {frames + 1, n, 3} (m) of every frame, the solver and the last state."""
    model = scene.model
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0.0]
    dt = 1.0 / (FPS * scene.substeps)
    for run in stage.runs(frames):
        solver = SolverVBD(model, iterations=scene.iterations)
        pipeline = novaphy.CollisionPipeline(model) if model.shape_count else None
        contacts = pipeline.contacts() if pipeline else None
        state, after = model.state(), model.state()
        positions = [state.particle_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            for sub in range(scene.substeps):
                state.clear_forces()
                stage.apply_forces(state)
                if pipeline:
                    pipeline.collide(state, contacts)
                targets = None
                if scene.turn:
                    time = min((frame + (sub + 1) / scene.substeps) / FPS, 2.0)
                    targets = turned(held, scene.turn * time)
                solver.step(state, after, None, contacts, dt, targets=targets)
                state, after = after, state
            stage.show(frame / FPS, state)
            positions.append(state.particle_q.numpy())
    return np.array(positions), solver, state


def check_gradient(scene: Scene, start: novaphy.SimState) -> bool:
    """Return whether the gradient of a frame agrees with differences along the gradient.

    The loss is a sum of positions with random weights. Contacts are found in the state `start`.
    """
    from novaphy import diff, nova

    model = scene.model
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=scene.iterations)
    contacts = None
    if model.shape_count:
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(start, contacts)
    trajectory = diff.Trajectory(model, scene.substeps)
    trajectory[0].particle_q.assign(start.particle_q.numpy())
    velocity = start.particle_qd.numpy()
    weights = np.random.default_rng(0).normal(size=velocity.shape).astype(np.float32)
    weight = nova.tensor(weights, device=model.device)

    def loss(v: np.ndarray) -> nova.Tensor:
        trajectory[0].particle_qd.assign(v)
        solver.rollout(trajectory, None, contacts, 1.0 / (FPS * scene.substeps))
        return nova.sum(diff.state_particle_q_tensor(trajectory[scene.substeps]) * weight)

    with nova.Tape() as tape:
        value = loss(velocity)
    tape.backward(value)
    gradient = trajectory[0].particle_qd.grad.numpy()
    direction = gradient / np.sqrt(np.mean(np.square(gradient)))  # root mean square: 1 m/s
    expected = float((gradient * direction).sum())
    sums, size = [], 2e-3
    for sign in (1.0, -1.0):
        loss(velocity + np.float32(sign * size) * direction)
        q = trajectory[scene.substeps].particle_q.numpy().astype(np.float64)
        sums.append(float((q * weights).sum()))
    found = (sums[0] - sums[1]) / (2.0 * size)
    error = abs(found - expected) / abs(expected)
    print(f"gradient {expected:.6g}, by differences {found:.6g}: apart by {100 * error:.2f} %")
    return error < 1e-2


def least_volume(model: novaphy.Model, q: np.ndarray) -> float:
    """Return the smallest ratio of a tetrahedron's volume to its rest volume."""
    a, b, c, d = q[model.tet_indices.numpy().T].astype(np.float64)
    volume = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0
    return float((volume / model.particle_tet_volume.numpy()).min())


def check(name: str, scene: Scene, positions: np.ndarray) -> list[str]:
    """Return texts about the failed checks at the end of a complete scene."""
    end, speed = positions[-1], np.abs(positions[-1] - positions[-2]).max() * FPS
    faults = [] if np.isfinite(positions).all() else ["finite positions"]
    if name == "hanging":
        drop = 1.2 - positions[:, :, 2].min()
        a, b = end[scene.model.particle_edge_indices.numpy()[:, 2:].T]
        rest = scene.model.particle_edge_rest_length.numpy()
        stretch = (np.linalg.norm(a - b, axis=1) / rest).max()
        print(f"swings {drop:.3f} m below the held side, longest edge {stretch:.3f} of its length")
        faults += [] if 0.95 < drop < 1.5 else ["a cloth that hangs by its length, 1 m"]
        faults += [] if stretch < 1.2 else ["a cloth that keeps its length"]
    if name == "draped":
        distance, low = np.linalg.norm(end - (0.0, 0.0, 0.5), axis=1).min() - 0.3, end[:, 2].min()
        print(f"smallest distance to the sphere {distance:.4f} m, to the ground {low:.4f} m")
        faults += [] if distance > 0.0 and low > 0.0 else ["a cloth outside of shapes"]
        faults += [] if end[:, 2].max() > 0.78 else ["a cloth on the sphere"]
    if name in ("twisted", "crushed"):
        first, last = (least_volume(scene.model, q) for q in (positions[0], end))
        print(f"smallest relative volume {first:.3f} at the start, {last:.3f} at the end")
        faults += [] if last > 0.2 else ["no inverted or flat tetrahedron"]
    if name == "net":
        a, b = end[scene.model.particle_spring_indices.numpy().reshape(-1, 2).T]
        rest = scene.model.particle_spring_rest_length.numpy()
        longest, sag = (np.linalg.norm(a - b, axis=1) / rest).max(), 1.0 - end[:, 2].min()
        print(f"sags by {sag:.3f} m, longest spring {longest:.3f} of its length")
        faults += [] if 0.02 < sag < 0.4 and speed < 0.3 else ["particles that were caught"]
        faults += [] if longest < 1.3 else ["a net that keeps its size"]
    print(f"fastest particle {speed:.3f} m/s")
    return faults


def plot(path: str, model: novaphy.Model, positions: np.ndarray) -> None:
    """Draw the surface at four times."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(13.0, 3.8), layout="constrained")
    for column, frame in enumerate(np.linspace(0, len(positions) - 1, 4).astype(int)):
        axes = figure.add_subplot(1, 4, column + 1, projection="3d", box_aspect=(1, 1, 1))
        x, y, z = positions[frame].T
        style = {"color": "#5b8db8", "edgecolor": "#22445f", "lw": 0.15}
        if model.tri_count:
            axes.plot_trisurf(x, y, z, triangles=model.tri_indices.numpy(), **style)
        else:
            axes.scatter(x, y, z, s=2e3 * model.particle_radius.numpy() ** 1.5, color="#22445f")
            for spring in model.particle_spring_indices.numpy().reshape(-1, 2):
                axes.plot(x[spring], y[spring], z[spring], color="#5b8db8", lw=0.5)
        low, high = positions.min((0, 1)), positions.max((0, 1))
        center, half = (low + high) / 2, (high - low).max() / 2
        for axis, c in zip("xyz", center, strict=True):
            axes.set(**{f"{axis}lim": (c - half, c + half)})
        axes.set_title(f"{frame / FPS:.2f} s")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Simulate, draw and check a scene. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", choices=SCENES, default="draped")
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:1, dlan, ...")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the surface at four times")
    parser.add_argument("--dump-states", metavar="PATH.npz", help="write the positions")
    parser.add_argument("--check-grad", action="store_true", help="compare with differences")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.dump_states and not Path(args.dump_states).resolve().parent.is_dir():
        parser.error(f"the folder of {args.dump_states} does not exist")

    novaphy.set_default_device(args.device)
    scene = SCENES[args.scene]()
    with viewer.Stage(args, scene.model, fps=FPS, look=LOOKS[args.scene]) as stage:
        positions, solver, last = simulate(scene, args.headless, stage)
    if args.dump_states:
        np.savez_compressed(args.dump_states, particle_q=positions)
    if args.plot:
        plot(args.plot, scene.model, positions)
    if args.headless > 0:
        print(f"relative residual of the last step {solver.residual().relative:.1e}")
    faults = check(args.scene, scene, positions) if args.headless >= 150 else []
    if args.check_grad and not check_gradient(scene, last):
        faults.append("a gradient within 1 % of differences")
    for fault in faults:
        print(f"CHECK FAILED: expected {fault}")
    if not faults:
        print("ok")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
