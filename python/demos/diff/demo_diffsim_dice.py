"""Spin a die so that it falls on the ground with a chosen face up.

A die of 12 kg falls from 0.6 m with a fixed linear velocity. The initial angular velocity is
optimized. After 0.8 s (768 substeps) the x axis of the die should point up, and the die should be
at rest. Contacts of the corners with the ground are found in every substep. The loss jumps between
faces. Therefore every update is a clipped gradient step, whose length is halved until the loss
falls. Then the demo repeats the optimization from random initial spins with fixed seeds.

A single die uses a generated operator, which finds the contacts of corners in its kernel. Several
dice (`--dice`) are thrown side by side and may collide. A collision pipeline finds their contacts
in every substep, and the gradient includes both bodies of a contact.

    python demo_diffsim_dice.py
    python demo_diffsim_dice.py --dice 3 --starts 0
    python demo_diffsim_dice.py --headless 8 --plot dice.png --record dice.html
    python demo_diffsim_dice.py --headless 0 --starts 0 --check-grad
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from demo_common import (
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

FPS, SUBSTEPS, FRAMES = 60, 16, 48
STEPS, DT = SUBSTEPS * FRAMES, 1.0 / (FPS * SUBSTEPS)
HALF, SPACING = 0.1, 0.4  # half an edge, distance of dice (m)
START = (0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0)
PENETRATING = (0.0, 0.0, 0.13, 0.11, -0.21, 0.29, 0.927)  # a pose with a corner in the ground
VELOCITY, SPIN = (1.0, 0.0, 0.0), (1.0, 5.0, 2.0)
FRICTION_SMOOTHING = 0.1  # m/s
LEARNING_RATE, SMALLEST_RATE = 0.5, 1e-3
MAX_GRADIENT, MAX_SPIN = 10.0, 20.0


def build_model(device: str, start: tuple[float, ...], count: int) -> novaphy.Model:
    """Build dice above the ground, side by side, each a little higher than the one before."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(count):
        place = np.add(start[:3], (0.0, SPACING * (k - (count - 1) / 2), 0.05 * k))
        die = builder.add_body(xform=(*place, *start[3:]), mass=4.0)
        builder.add_shape_box(die, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    return builder.finalize(device, requires_grad=True)


class Dice:
    """The rollout, its loss and the spins that are optimized."""

    def __init__(
        self,
        device: str,
        start: tuple[float, ...] = START,
        steps: int = STEPS,
        count: int = 1,
    ) -> None:
        self.model = build_model(device, start, count)
        config = novaphy.solvers.DiffSolverConfig(
            enable_static_contacts=count == 1,
            friction_law="huber",
            friction_smoothing=FRICTION_SMOOTHING,
        )
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, steps)
        self.pipeline = None if count == 1 else novaphy.CollisionPipeline(self.model)
        spins = np.float32([SPIN]) + np.float32([0.7, -0.9, 0.4]) * np.arange(count)[:, None]
        self.spin = nova.tensor(spins.astype(np.float32), device=device, requires_grad=True)

    @property
    def gradient(self) -> str:
        """A description of the gradient that is used."""
        if self.pipeline is None:
            return "generated operator, exact"
        return "contacts found anew in every substep, exact but for coinciding features"

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the sum {1} of the dice's losses."""
        twist = diff.body_twist_from_omega_generated(self.spin, *VELOCITY)
        diff.state_body_qd_tensor(self.trajectory[0]).copy_(twist)
        self.solver.rollout(self.trajectory, None, None, DT, pipeline=self.pipeline)
        end = self.trajectory[self.trajectory.steps]
        loss = self.loss(end, 0)
        for die in range(1, self.model.body_count):
            loss = loss + self.loss(end, die)
        return loss

    def loss(self, end: novaphy.SimState, die: int) -> nova.Tensor:
        """Return the loss {1} of one die.

        The loss has two terms: 1 - cosine of the angle between the die's x axis and the vertical,
        and the remaining motion.
        """
        return diff.rigid_orientation_velocity_loss_generated(
            diff.state_body_q_tensor(end),
            diff.state_body_qd_tensor(end),
            die,
            local_axis_a=(1.0, 0.0, 0.0),
            target_axis_a=(0.0, 0.0, 1.0),
            local_axis_b=(0.0, 1.0, 0.0),
            target_axis_b=(0.0, 1.0, 0.0),
            axis_weight_b=0.0,  # any yaw; a weight would add a local minimum half a turn away
            target_height=HALF,
            height_weight=1.0,
            linear_velocity_weight=0.01,
            angular_velocity_weight=0.001,
        )

    def iterate(self) -> tuple[float, bool]:
        """Compute a gradient, and for each die halve the step until the loss falls.

        Return the loss before the steps, and whether any step was taken.
        """
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            gradient = self.spin.grad.numpy()
            tape.zero()
        before = loss.item()
        lowest, moved = before, False
        for die in range(len(gradient)):
            lowest, stepped = self.search(die, gradient[die], lowest)
            moved = moved or stepped
        return before, moved

    def search(self, die: int, gradient: np.ndarray, before: float) -> tuple[float, bool]:
        """Halve the step of one die's spin until the loss falls. Return the loss, and whether a
        step was taken."""
        start = self.spin.numpy()
        length = float(np.linalg.norm(gradient))
        if not np.isfinite(length) or length == 0.0:
            return before, False
        gradient = gradient * min(1.0, MAX_GRADIENT / length)
        rate = LEARNING_RATE
        while rate >= SMALLEST_RATE:
            spin = start.copy()
            spin[die] -= rate * gradient
            spin[die] *= min(1.0, MAX_SPIN / float(np.linalg.norm(spin[die])))
            self.spin.assign(spin.astype(np.float32))
            after = self.forward().item()
            if after < before:
                return after, True
            rate /= 2.0
        self.spin.assign(start)
        return before, False

    def train(self, iterations: range, stage: viewer.Stage | None = None) -> list[float]:
        """Iterate until no step lowers the loss, and show the iterations. Return the losses."""
        losses = []
        for k in iterations:
            loss, moved = self.iterate()
            losses.append(loss)
            if not moved:
                return losses
            if stage is not None:
                stage.iteration(k, loss, self.frames, self.paths)
        return [*losses, self.forward().item()]

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout."""
        return ((k / FPS, self.trajectory[k * SUBSTEPS]) for k in range(FRAMES + 1))

    def paths(self) -> dict[str, np.ndarray]:
        """Return the paths of the centers and of a corner of the first die in the last rollout."""
        q = poses(self)
        ways = {f"path {k}" if k else "path": q[:, k, :3] for k in range(q.shape[1])}
        return {**ways, "corner": corner_way(q[:, 0])}

    def landed(self) -> int:
        """Return the number of dice that end the last rollout at rest with the face up."""
        end = self.trajectory[self.trajectory.steps]
        x, y, z, w = end.body_q.numpy()[:, 3:].T
        up = 2.0 * (x * z - w * y)  # vertical components of the dice's x axes
        still = np.linalg.norm(end.body_qd.numpy(), axis=1) < 0.5
        return int((still & (up > 0.99)).sum())


def success_rate(device: str, starts: int, iterations: int) -> int:
    """Return the number of seeded spins that end with the face up."""
    random = np.random.default_rng(2024)
    die, landed = Dice(device), 0
    for _ in progress(range(starts)):
        die.spin.assign(random.uniform(-6.0, 6.0, (1, 3)).astype(np.float32))
        die.train(range(iterations))
        die.forward()
        landed += die.landed()
    return landed


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and x axis and center height of the die in the first and last rollout."""
    figure, right = loss_figure(losses, "loss")
    time = np.arange(STEPS + 1) * DT
    for q, color, name in zip(rollouts, ("#adb5bd", "#2a6f97"), ("before", "after"), strict=True):
        up = 2.0 * (q[..., 3] * q[..., 5] - q[..., 6] * q[..., 4])
        for k in range(q.shape[1]):
            of = {"color": color, "alpha": 1.0 - 0.6 * k / q.shape[1]}
            right.plot(time, up[:, k], label=None if k else f"x axis, {name}", **of)
            label = None if k else f"height (m), {name}"
            right.plot(time, q[:, k, 2], linestyle=":", label=label, **of)
    right.set(xlabel="time [s]", title="Upward part of the die's x axis, and its height")
    right.legend()
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    parser = make_parser(__doc__, iterations=8)
    parser.add_argument("--starts", type=int, default=20, help="seeded random spins to try")
    parser.add_argument("--dice", type=int, default=1, help="dice that are thrown together")
    args = parse(parser)
    if args.starts < 0:
        parser.error(f"--starts: expected a number >= 0, got {args.starts}")
    if args.dice < 1:
        parser.error(f"--dice: expected a number >= 1, got {args.dice}")
    checks = {}
    if args.check_grad:
        corner = Dice(args.device, PENETRATING, 8, args.dice)
        checks["a gradient within the tolerance"] = check_gradient(
            corner.spin, corner.forward, 1e-2, 1e-2
        )
    die = Dice(args.device, count=args.dice)
    die.forward()
    rollouts = [poses(die)]
    look = ((0.3, -2.3, 0.8), (0.3, 0.0, 0.32))
    with viewer.Stage(args, die.model, fps=FPS, look=look, path_width=0.01) as stage:
        losses = die.train(progress(range(args.headless)), stage) or [die.forward().item()]
        die.forward()
        stage.iteration(args.headless, losses[-1], die.frames, die.paths, last=True)
    rollouts.append(poses(die))
    if args.dump_states:
        novaphy.io.save_npz(args.dump_states, body_q=rollouts[-1], loss=np.float32(losses))
    if args.plot:
        plot(args.plot, losses, rollouts)
    if args.headless >= 3:
        checks["a loss that fell"] = losses[-1] < losses[0]
    if args.headless >= 3 and args.dice == 1:
        checks["the face up and the die at rest"] = die.landed() == 1
        checks["a loss below 0.01"] = losses[-1] < 0.01
    if args.starts:
        landed = success_rate(args.device, args.starts, args.headless)
        print(f"{landed} of {args.starts} random spins end with the face up")
    if args.dice > 1:
        print(f"{die.landed()} of {args.dice} dice end with the face up")
    print(f"gradient: {die.gradient}")
    print(
        f"die on {die.model.device}: {len(losses) - 1} iterations, loss {losses[0]:.4f} -> "
        f"{losses[-1]:.5f}, spin {die.spin.numpy().round(3).tolist()}, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


def corner_way(pose: np.ndarray) -> np.ndarray:
    """Return the path {n, 3} (m) of the corner (HALF, HALF, HALF) at poses {n, 7}."""
    axis, w, corner = pose[:, 3:6], pose[:, 6:], np.full(3, HALF, np.float32)
    turn = 2.0 * np.cross(axis, corner)
    return (pose[:, :3] + corner + w * turn + np.cross(axis, turn)).astype(np.float32)


def poses(die: Dice) -> np.ndarray:
    """Return all poses of the last rollout, {steps + 1, dice, 7}."""
    return np.array([die.trajectory[t].body_q.numpy() for t in range(STEPS + 1)])


if __name__ == "__main__":
    run(main)
