"""Throw a cloth so that its middle flies through a target, by gradient descent.

A square meter of cloth with drag and lift is thrown into the air, for 1,920 substeps. The initial
velocities of all 289 particles are optimized, so that the centroid is at the target after two
seconds. An iteration (rollout, gradient, update) is recorded once and replayed.

    python demo_diffsim_cloth.py
    python demo_diffsim_cloth.py --headless 40 --plot cloth.png --record cloth.html
    python demo_diffsim_cloth.py --headless 0 --check-grad
"""

from __future__ import annotations

import numpy as np
from demo_common import (
    Recorded,
    check_gradient,
    loss_figure,
    make_parser,
    mostly_falls,
    parse,
    run,
    save_figure,
    train,
    verdict,
)

import novaphy
from novaphy import diff, nova, viewer

FPS, FRAMES, SUBSTEPS = 60, 120, 16
STEPS = FRAMES * SUBSTEPS
DT = 1.0 / FPS / SUBSTEPS
TARGET = (0.0, 8.0, 0.0)
LEARNING_RATE = 5.0  # 1/s²
CELLS = 16


def build_model(device: str) -> novaphy.Model:
    """Build a cloth, rotated by 135 degrees about y."""
    half = -0.75 * np.pi / 2.0
    builder = novaphy.ModelBuilder()
    builder.default_particle_radius = 0.01
    builder.add_cloth_grid(
        rot=(0.0, np.sin(half), 0.0, np.cos(half)),
        vel=(0.0, 0.1, 0.1),
        dim_x=CELLS,
        dim_y=CELLS,
        cell_x=1.0 / CELLS,
        cell_y=1.0 / CELLS,
        mass=1.0,
        tri_ke=1.0e4,
        tri_ka=1.0e4,
        tri_kd=100.0,
        tri_drag=5.0,
        tri_lift=10.0,
    )
    return builder.finalize(device, requires_grad=True)


class Cloth:
    """The rollout of the cloth, its loss, and the initial velocities that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        config = novaphy.solvers.DiffSolverConfig(enable_triangles=True, enable_bending=True)
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.velocity = diff.state_particle_qd_tensor(self.trajectory[0], requires_grad=True)
        self.train = Recorded(self.iterate)

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the squared distance {1} (m²) of the centroid to the target."""
        self.solver.rollout(self.trajectory, None, None, DT)
        last = diff.state_particle_q_tensor(self.trajectory[STEPS])
        return diff.vec3_point_loss_generated(diff.particle_centroid_generated(last), *TARGET)

    def iterate(self) -> nova.Tensor:
        """Run a rollout, the backward pass and one step of gradient descent. Return the loss."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            nova.sgd_update_f32(self.velocity, LEARNING_RATE)
            tape.zero()
        return loss


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and the cloth and its centroid in the first and the last rollout."""
    figure, right = loss_figure(losses, "squared distance of the centroid [m²]", (4.4, 2.6))
    for q, color, name in zip(rollouts, ("#adb5bd", "#2a6f97"), ("before", "after")):
        middle = q.mean(axis=1)
        right.plot(middle[:, 1], middle[:, 2], color=color, linewidth=1.5, label=name)
        for frame in q[:: 20 * SUBSTEPS]:
            right.plot(frame[:, 1], frame[:, 2], ".", color=color, markersize=1)
    right.plot(TARGET[1], TARGET[2], "*", color="#c1121f", markersize=15, label="target", zorder=3)
    right.set(xlabel="y [m]", ylabel="z [m]", title="The cloth")
    right.set_aspect("equal")
    right.legend(loc="lower right")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=40))
    cloth = Cloth(args.device)
    checks = {}
    if args.check_grad:  # some velocities of the first particle and of the middle one
        chosen = [0, 1, 2, 3 * 144, 3 * 144 + 1, 3 * 144 + 2]
        checks["a gradient within the tolerance"] = check_gradient(
            cloth.velocity, cloth.forward, 0.2, 2.0e-2, chosen
        )
    look = ((28.0, -1.0, 0.0), (0.0, 4.2, -5.0))
    with viewer.Stage(args, cloth.model, fps=FPS, refresh=5, look=look, path_width=0.06) as stage:
        stage.mark(TARGET, 0.12)
        losses = train(cloth, args, SUBSTEPS, plot, stage)
    checks["a loss below 300 m²"] = max(losses) < 300.0
    # The first steps are long and may go too far.
    checks["a loss that falls in 80 % of the iterations"] = mostly_falls(losses)
    print(
        f"cloth on {cloth.model.device}: {args.headless} iterations, "
        f"loss {losses[0]:.4f} -> {losses[-1]:.4f}, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
