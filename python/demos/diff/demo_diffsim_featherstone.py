"""Throw a two-link arm so that its tip ends at a target.

The arm hangs on two hinges and falls for 0.6 s: 576 substeps of SolverFeatherstone.step.
record_planar_2r_featherstone_step records each substep after it ran. The initial velocities of the
hinges are optimized, so that the tip ends at a target. Every update is a gradient step whose length
is halved until the loss falls. The arm moves in the vertical plane XOZ.

    python demo_diffsim_featherstone.py
    python demo_diffsim_featherstone.py --headless 20 --plot arm.png --record arm.html
    python demo_diffsim_featherstone.py --headless 0 --check-grad
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

FPS, SUBSTEPS, FRAMES = 60, 16, 36
STEPS, DT = SUBSTEPS * FRAMES, 1.0 / (FPS * SUBSTEPS)
LENGTH, MASS = 0.5, 1.0  # m, kg, of a link
START, VELOCITY = (0.4, -0.6), (1.0, -0.5)
TARGET = (0.35, -0.75)  # m, x and z
ANGULAR_DAMPING = 0.0  # 1/s
LEARNING_RATE, SMALLEST_RATE = 16.0, 1e-3
COLORS = ((0.16, 0.44, 0.72), (0.95, 0.50, 0.05))  # blue link 1, orange link 2
GROUND, CHECKER = (0.96, 0.96, 0.96), 0.93  # white squares, and the contrast to the black squares
IDENTITY = (0.0, 0.0, 0.0, 1.0)
# Reference loss and gradient of the first iteration, in float64
# (tests/golden/newton_2r_strict.npz).
EXACT_LOSS, EXACT_GRADIENT = 1.09098, (0.32981, 0.11073)


def build_model(device: str) -> novaphy.Model:
    """Build the arm above a checkered ground, which the arm does not touch."""
    builder = novaphy.ModelBuilder()
    looks = novaphy.ShapeConfig(density=0.0)
    builder.add_ground_plane(height=-1.25, cfg=looks)
    inertia = np.diag([0.0025, MASS * LENGTH**2 / 12.0, MASS * LENGTH**2 / 12.0])
    parent, joints = -1, []
    for _ in range(2):
        link = builder.add_link(mass=MASS, inertia=inertia, lock_inertia=True)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=(0.0, 1.0, 0.0),
                parent_xform=(0.0 if parent < 0 else LENGTH / 2, 0.0, 0.0, *IDENTITY),
                child_xform=(-LENGTH / 2, 0.0, 0.0, *IDENTITY),
            )
        )
        builder.add_shape_box(link, hx=LENGTH / 2, hy=0.03, hz=0.03, cfg=looks)
        parent = link
    builder.add_articulation(joints)
    builder.joint_q, builder.joint_qd = START, VELOCITY
    return builder.finalize(device, requires_grad=True)


class Arm:
    """The rollout, its loss and the velocities that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        self.solver = novaphy.solvers.SolverFeatherstone(
            self.model, angular_damping=ANGULAR_DAMPING
        )
        self.states = [self.model.state() for _ in range(STEPS + 1)]
        self.q = [diff.state_joint_q_tensor(s) for s in self.states]
        self.qd = [diff.state_joint_qd_tensor(s) for s in self.states]
        self.last: tuple[np.ndarray, np.ndarray] | None = None  # last velocities, their gradient

    @property
    def velocities(self) -> nova.Tensor:
        """The optimized parameters: joint_qd of the first state {2} (rad/s)."""
        return self.qd[0]

    def forward(self) -> nova.Tensor:
        """Run all substeps, recorded on an active tape. Return the squared distance {1} (m²)."""
        for t in range(STEPS):
            old, new = self.states[t], self.states[t + 1]
            self.solver.step(old, new, None, None, DT)
            diff.record_planar_2r_featherstone_step(
                self.model,
                old,
                None,
                self.q[t],
                self.qd[t],
                self.q[t + 1],
                self.qd[t + 1],
                DT,
                ANGULAR_DAMPING,
            )
        return diff.planar_2r_tip_loss(self.model, self.q[STEPS], *TARGET)

    def gradient(self) -> tuple[float, np.ndarray]:
        """Return the loss, and its gradient with respect to the velocities."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            gradient = self.velocities.grad.numpy()
            tape.zero()
        return loss.item(), gradient

    def iterate(self) -> tuple[float, bool]:
        """Compute a gradient, and halve the step until the loss falls.

        The initial step length is that of Barzilai and Borwein (1988), from the change of the
        gradient. Return the loss before the step, and whether a step was taken.
        """
        before, gradient = self.gradient()
        start, rate = self.velocities.numpy(), LEARNING_RATE
        if self.last is not None:
            moved, turned = start - self.last[0], gradient - self.last[1]
            curvature = float(moved @ turned)
            rate = float(moved @ moved) / curvature if curvature > 0.0 else rate
        self.last = start, gradient
        while rate >= SMALLEST_RATE:
            self.velocities.assign(start - np.float32(rate) * gradient)
            if self.forward().item() < before:
                return before, True
            rate /= 2.0
        self.velocities.assign(start)
        return before, False

    def train(self, iterations: range, stage: viewer.Stage) -> list[float]:
        """Iterate until no step lowers the loss, and show the iterations. Return the losses."""
        losses = []
        for k in iterations:
            loss, moved = self.iterate()
            losses.append(loss)
            if not moved:
                return losses
            stage.iteration(k, loss, self.frames, self.paths)
        return [*losses, self.forward().item()]

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout.

        The initial state is left out, because only steps set the poses of bodies.
        """
        return ((k / FPS, self.states[max(1, k * SUBSTEPS)]) for k in range(FRAMES + 1))

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path of the tip in the last rollout, by name."""
        return {"path": tips(np.array([q.numpy() for q in self.q]))}


def tips(q: np.ndarray) -> np.ndarray:
    """Return the positions of the tip {n, 3} (m) at the joint angles q {n, 2} (rad)."""
    first, both = q[:, 0], q[:, 0] + q[:, 1]
    x = LENGTH * (np.cos(first) + np.cos(both))
    z = -LENGTH * (np.sin(first) + np.sin(both))
    return np.stack([x, np.zeros_like(x), z], axis=1).astype(np.float32)


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and the path of the tip in the first and the last rollout."""
    figure, right = loss_figure(losses, "squared distance [m²]")
    for q, color, name in zip(rollouts, ("#adb5bd", "#d62828"), ("before", "after"), strict=True):
        way = tips(q)
        right.plot(way[:, 0], way[:, 2], color=color, label=f"tip, {name}")
    joints = np.stack([np.zeros(3), tips(rollouts[-1][-1:])[0]])
    elbow = LENGTH * np.array([np.cos(rollouts[-1][-1, 0]), -np.sin(rollouts[-1][-1, 0])])
    for a, b, color in (
        ((0.0, 0.0), elbow, COLORS[0]),
        (elbow, joints[1, [0, 2]], COLORS[1]),
    ):
        right.plot((a[0], b[0]), (a[1], b[1]), color=color, linewidth=4)
    right.plot(*TARGET, "x", color="#000000", label="target")
    right.set(xlabel="x [m]", ylabel="z [m]", title="Way of the tip", aspect="equal")
    right.legend()
    save_figure(figure, path)


def check_start(arm: Arm) -> dict[str, bool]:
    """Compare the gradient of the first rollout with central differences and the reference."""
    loss, gradient = arm.gradient()
    return {
        "a gradient within the tolerance": check_gradient(arm.velocities, arm.forward, 1e-2, 1e-3),
        "the exact loss": abs(loss - EXACT_LOSS) < 1e-4,
        "the exact gradient": bool(np.allclose(gradient, EXACT_GRADIENT, atol=1e-4)),
    }


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=20))
    arm = Arm(args.device)
    checks = check_start(arm) if args.check_grad else {}
    arm.forward()
    rollouts = [angles(arm)]
    look = ((0.15, -3.3, -0.35), (0.15, 0.0, -0.35))  # perpendicular to the plane of the arm
    with viewer.Stage(args, arm.model, fps=FPS, look=look, path_width=0.012) as stage:
        stage.set_shape_colors((0, 1, 2), [(*GROUND, CHECKER), *((*c, 0.0) for c in COLORS)])
        stage.mark((TARGET[0], 0.0, TARGET[1]), radius=0.03)
        losses = arm.train(progress(range(args.headless)), stage) or [arm.forward().item()]
        arm.forward()
        stage.iteration(args.headless, losses[-1], arm.frames, arm.paths, last=True)
    rollouts.append(angles(arm))
    if args.dump_states:
        novaphy.io.save_npz(
            args.dump_states,
            joint_q=rollouts[-1],
            joint_qd=np.array([qd.numpy() for qd in arm.qd]),
            body_q=np.array([s.body_q.numpy() for s in arm.states]),
            loss=np.float32(losses),
        )
    if args.plot:
        plot(args.plot, losses, rollouts)
    if args.headless >= 20:
        checks["the tip at the target"] = losses[-1] < 1e-4
    print(
        f"arm on {arm.model.device}: {len(losses) - 1} iterations, loss {losses[0]:.5f} -> "
        f"{losses[-1]:.2e}, velocities {arm.velocities.numpy().round(3)}, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


def angles(arm: Arm) -> np.ndarray:
    """Return the angles of the last rollout, {steps + 1, 2} (rad)."""
    return np.array([q.numpy() for q in arm.q])


if __name__ == "__main__":
    run(main)
