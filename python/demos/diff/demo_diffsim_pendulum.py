"""Throw the tip of a double pendulum through a mark, by the targets of its two drives.

Two rods hang from the world by hinges. The hinges are penalty joints: springs and dampers hold
their two sides together. Each hinge has a drive, a weak spring to a target angle. The two target
angles are optimized. After 0.8 s (768 substeps) the tip should be at the mark. The gradient through
joints, drives and bodies is exact.

    python demo_diffsim_pendulum.py
    python demo_diffsim_pendulum.py --headless 60 --plot pendulum.png --record pendulum.html
    python demo_diffsim_pendulum.py --headless 0 --check-grad
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
from novaphy import JointTargetMode, diff, nova, viewer

FPS, SUBSTEPS, FRAMES = 60, 16, 48
STEPS, DT = SUBSTEPS * FRAMES, 1.0 / (FPS * SUBSTEPS)
LENGTH, MASS, RADIUS = 0.5, 1.0, 0.03  # length (m), mass (kg) and radius (m) of a rod
ATTACH = {"joint_attach_ke": 4e3, "joint_attach_kd": 40.0}  # N/m, N s/m: the attachment of a hinge
HEIGHT = 1.3  # m, height of the hinge at the world
STIFFNESS, DAMPING = 6.0, 0.4  # N m/rad, N m s/rad: gains of the drives
FIRST_ANGLES = (0.4, 0.2)  # rad, target angles before the first iteration
MARK = np.array([-0.55, 0.0, 0.75])  # m
LEARNING_RATE, MOMENTUM = 0.1, 0.8  # rad


def build_model(device: str) -> novaphy.Model:
    """Build two rods that hang down, at rest."""
    builder = novaphy.ModelBuilder()
    rod = novaphy.ShapeConfig(density=0.0, collision_group=0)
    inertia = np.diag([MASS * LENGTH**2 / 12, MASS * LENGTH**2 / 12, MASS * RADIUS**2 * 4])
    joints, last = [], -1
    for k in range(2):
        middle = HEIGHT - (k + 0.5) * LENGTH
        link = builder.add_link(
            xform=((0.0, 0.0, middle), (0.0, 0.0, 0.0, 1.0)), mass=MASS, inertia=inertia
        )
        builder.add_shape_capsule(link, radius=RADIUS, half_height=0.5 * LENGTH - RADIUS, cfg=rod)
        anchor = (0.0, 0.0, HEIGHT if last < 0 else -0.5 * LENGTH)
        joints.append(
            builder.add_joint_revolute(
                last,
                link,
                axis=novaphy.Axis.Y,
                parent_xform=(anchor, (0.0, 0.0, 0.0, 1.0)),
                child_xform=((0.0, 0.0, 0.5 * LENGTH), (0.0, 0.0, 0.0, 1.0)),
                target_ke=STIFFNESS,
                target_kd=DAMPING,
                actuator_mode=JointTargetMode.POSITION,
            )
        )
        last = link
    builder.add_articulation(joints)
    return builder.finalize(device, requires_grad=True)


class Pendulum:
    """The rollout, its loss and the angles that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, **ATTACH)
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.control = self.model.control()
        self.angles = diff.control_joint_target_q_tensor(self.control, requires_grad=True)
        self.angles.assign(np.float32(FIRST_ANGLES))
        self.optimizer = nova.optim.Adam([self.angles], lr=LEARNING_RATE, betas=(MOMENTUM, 0.999))
        self.mark = nova.tensor(np.float32(MARK), device=device)
        self.train = Recorded(self.iterate)

    def tip(self) -> nova.Tensor:
        """Return the final position {3} (m) of the tip, the lower end of the second rod."""
        x, y, z, qx, qy, qz, qw = (
            diff.state_body_q_tensor(self.trajectory[STEPS])[1, k : k + 1] for k in range(7)
        )
        half = 0.5 * LENGTH
        return nova.concat(
            [
                x - half * (2.0 * (qx * qz + qw * qy)),
                y - half * (2.0 * (qy * qz - qw * qx)),
                z - half * (1.0 - 2.0 * (qx * qx + qy * qy)),
            ]
        )

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the squared distance {1} (m²) of the tip to the mark."""
        self.solver.rollout(self.trajectory, self.control, None, DT)
        away = self.tip() - self.mark
        return nova.sum(away * away)

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
        """Return the path of the tip in the last rollout, {steps + 1, 3} (m)."""
        q = self.trajectory.body_q.numpy().reshape(STEPS + 1, 2, 7)[:, 1]
        x, y, z, w = q[:, 3:].T
        down = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
        return q[:, :3] - 0.5 * LENGTH * down

    def gap(self) -> float:
        """Return the largest gap (m) of the penalty joint between the two rods."""
        q = self.trajectory.body_q.numpy().reshape(STEPS + 1, 2, 7)
        x, y, z, w = np.moveaxis(q[:, :, 3:], 2, 0)
        up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 2)
        ends = q[:, 0, :3] - 0.5 * LENGTH * up[:, 0], q[:, 1, :3] + 0.5 * LENGTH * up[:, 1]
        return float(np.linalg.norm(ends[0] - ends[1], axis=1).max())


def plot(path: str, losses: list[float], ways: list[np.ndarray]) -> None:
    """Plot the loss, and the path of the tip before and after the optimization."""
    figure, right = loss_figure(losses, "loss [m²]")
    for way, color, name in zip(ways, ("#adb5bd", "#2a6f97"), ("before", "after"), strict=True):
        right.plot(way[:, 0], way[:, 2], color=color, label=f"tip {name}")
        right.plot(way[-1, 0], way[-1, 2], "o", color=color)
    right.plot(0.0, HEIGHT, "s", color="#343a40", label="hinge")
    right.plot(MARK[0], MARK[2], "x", color="#c1121f", markersize=10, label="mark")
    right.set(xlabel="x [m]", ylabel="z [m]", title="Way of the tip", aspect="equal")
    right.legend(fontsize="small")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=60))
    pendulum, checks = Pendulum(args.device), {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            pendulum.angles, pendulum.forward, 1e-2, 1e-2
        )
    pendulum.forward()
    ways, losses = [pendulum.way()], []
    look = ((0.0, -3.0, 0.9), (0.0, 0.0, 0.7))
    with viewer.Stage(
        args, pendulum.model, fps=FPS, refresh=6, look=look, path_width=0.006
    ) as stage:
        stage.mark(MARK, radius=0.02)

        def paths() -> dict[str, np.ndarray]:
            return {"path": pendulum.way()}

        for k in progress(range(args.headless)):
            losses.append(pendulum.train())
            stage.iteration(k, losses[-1], pendulum.frames, paths)
        losses.append(pendulum.forward().item())
        stage.iteration(args.headless, losses[-1], pendulum.frames, paths, last=True)
    ways.append(pendulum.way())
    away = float(np.linalg.norm(ways[-1][-1] - MARK))
    if args.dump_states:
        poses = pendulum.trajectory.body_q.numpy().reshape(STEPS + 1, 2, 7)
        novaphy.io.save_npz(args.dump_states, body_q=poses, loss=np.float32(losses))
    if args.plot:
        plot(args.plot, losses, ways)
    checks["hinges that hold to 1 cm"] = pendulum.gap() < 0.01
    if args.headless >= 60:
        checks["the tip within 1 cm of the mark"] = away < 0.01
    angles = np.rad2deg(pendulum.angles.numpy())
    print(
        f"pendulum on {pendulum.model.device}: {args.headless} iterations, loss {losses[0]:.4f} -> "
        f"{losses[-1]:.2e}, angles {angles[0]:.0f} and {angles[1]:.0f} deg, "
        f"{1000 * away:.1f} mm from the mark, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
