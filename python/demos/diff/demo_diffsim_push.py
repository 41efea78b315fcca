"""Push a box over the ground so that it comes to rest on a mark.

A box of 12 kg lies on the ground, with up to 59 N of friction. The horizontal force on the box over
1.2 s is optimized: 13 values for each direction, interpolated linearly. At the end the box should
be at rest on the mark. The force must overcome the friction, and the friction stops the box. A
collision pipeline finds the contacts in each of the 576 substeps. The gradient of the contacts is
exact, because the ground is a plane of the world.

    python demo_diffsim_push.py
    python demo_diffsim_push.py --headless 60 --plot push.png --record push.html
    python demo_diffsim_push.py --headless 0 --check-grad
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from demo_common import (
    Recorded,
    check_gradient,
    loss_figure,
    make_parser,
    parse,
    progress,
    run,
    save_figure,
    verdict,
)

import novaphy
from novaphy import diff, nova, viewer

FPS, SUBSTEPS, FRAMES = 60, 8, 72
STEPS, DT = SUBSTEPS * FRAMES, 1.0 / (FPS * SUBSTEPS)
HALF, MASS, FRICTION = 0.1, 12.0, 0.5  # half an edge (m), kg, friction coefficient
KNOTS = 13
MARK = np.array([0.8, 0.4])  # m
FIRST_FORCE = (70.0, 10.0)  # N, the force before the first iteration
LEARNING_RATE, MOMENTUM = 2.0, 0.8  # N, 1
STILL = 0.05  # s²: weight of the squared velocity in the loss; the squared distance has weight 1


def build_model(device: str) -> novaphy.Model:
    """Build the box on the ground, with the overlap at which contact force and weight balance."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=FRICTION)
    builder.add_ground_plane(cfg=surface)
    rest = HALF - MASS * 9.81 / (4.0 * 1e4)
    box = builder.add_body(xform=((0.0, 0.0, rest), (0.0, 0.0, 0.0, 1.0)), mass=4.0)
    builder.add_shape_box(box, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    return builder.finalize(device, requires_grad=True)


def interpolation() -> np.ndarray:
    """Return weights {steps, knots} that interpolate the forces of knots linearly to substeps."""
    at = np.linspace(0.0, KNOTS - 1.0, STEPS)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(at - np.arange(KNOTS))).astype(np.float32)


class Push:
    """The rollout, its loss and the forces that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        config = novaphy.solvers.DiffSolverConfig(friction_law="huber")
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        first = np.zeros((KNOTS, 2), np.float32)
        first[: KNOTS // 2] = FIRST_FORCE
        self.forces = nova.tensor(first, device=device, requires_grad=True)
        self.optimizer = nova.optim.Adam([self.forces], lr=LEARNING_RATE, betas=(MOMENTUM, 0.999))
        self.basis = nova.tensor(interpolation(), device=device)
        self.horizontal = nova.tensor(np.eye(2, 6, dtype=np.float32), device=device)
        self.mark = nova.tensor(np.float32([[*MARK, 0, 0, 0, 0, 0]]), device=device)
        self.plane = nova.tensor(np.float32([[1, 1, 0, 0, 0, 0, 0]]), device=device)
        self.train = Recorded(self.iterate)

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the loss {1}: squared distance and weighted squared velocity."""
        wrenches = self.basis @ (self.forces @ self.horizontal)
        self.solver.rollout(
            self.trajectory,
            None,
            None,
            DT,
            pipeline=self.pipeline,
            body_forces=wrenches.reshape(STEPS, 1, 6),
        )
        end = self.trajectory[STEPS]
        away = (diff.state_body_q_tensor(end) - self.mark) * self.plane
        twist = diff.state_body_qd_tensor(end)
        return nova.sum(away * away) + STILL * nova.sum(twist * twist)

    def iterate(self) -> nova.Tensor:
        """Compute one gradient and one update. Return the loss before the update."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            self.optimizer.step()
            tape.zero()
        return loss

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout."""
        return ((k / FPS, self.trajectory[k * SUBSTEPS]) for k in range(FRAMES + 1))

    def way(self) -> np.ndarray:
        """Return the path of the box in the last rollout, {steps + 1, 3} (m)."""
        return self.trajectory.body_q.numpy().reshape(STEPS + 1, 7)[:, :3]


def plot(path: str, losses: list[float], ways: list[np.ndarray], forces: np.ndarray) -> None:
    """Draw the loss, the path of the box, and the speed and force over time."""
    figure, right = loss_figure(losses, "loss [m²]", widths=(4.0, 8.0))
    spec = right.get_subplotspec()
    right.remove()
    left, over_time = spec.subgridspec(1, 2).subplots()
    time = np.arange(STEPS + 1) * DT
    for way, color, name in zip(ways, ("#adb5bd", "#2a6f97"), ("before", "after"), strict=True):
        left.plot(way[:, 0], way[:, 1], color=color, label=name)
        speed = np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1) / DT
        over_time.plot(time[1:], speed, color=color, label=f"speed {name} [m/s]")
    left.plot(*MARK, "x", color="#c1121f", markersize=10, label="mark")
    left.set(xlabel="x [m]", ylabel="y [m]", title="Way of the box", aspect="equal")
    left.legend()
    strength = np.linalg.norm(interpolation() @ forces, axis=1) / 100.0
    over_time.plot(time[1:], strength, color="#e09f3e", label="force after [100 N]")
    holds = FRICTION * MASS * 9.81 / 100.0
    over_time.axhline(holds, color="#e09f3e", linestyle=":", label="friction [100 N]")
    over_time.set(xlabel="time [s]", title="Speed and force")
    over_time.legend(fontsize="small")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=60))
    push, checks = Push(args.device), {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            push.forces, push.forward, 2.0, 2e-2, range(8)
        )
    push.forward()
    ways, losses = [push.way()], []
    look = ((0.4, -1.4, 1.2), (0.4, 0.2, 0.0))
    with viewer.Stage(args, push.model, fps=FPS, refresh=6, look=look, path_width=0.006) as stage:
        stage.mark((*MARK, 0.0), radius=0.02)

        def paths() -> dict[str, np.ndarray]:
            return {"path": push.way()}

        for k in progress(range(args.headless)):
            losses.append(push.train())
            stage.iteration(k, losses[-1], push.frames, paths)
        losses.append(push.forward().item())
        stage.iteration(args.headless, losses[-1], push.frames, paths, last=True)
    ways.append(push.way())
    away = float(np.linalg.norm(ways[-1][-1, :2] - MARK))
    if args.dump_states:
        poses = push.trajectory.body_q.numpy().reshape(STEPS + 1, 7)
        novaphy.io.save_npz(args.dump_states, body_q=poses, loss=np.float32(losses))
    if args.plot:
        plot(args.plot, losses, ways, push.forces.numpy())
    if args.headless >= 60:
        checks["the box within 1 cm of the mark"] = away < 0.01
        checks["the box at rest"] = np.linalg.norm(push.trajectory[STEPS].body_qd.numpy()) < 0.1
    print(
        f"push on {push.model.device}: {args.headless} iterations, loss {losses[0]:.4f} -> "
        f"{losses[-1]:.2e}, {1000 * away:.1f} mm from the mark, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
