"""Find the rest lengths of eight springs that pull a particle to a target.

A particle hangs in a cage of eight fixed points, with a spring to each. The rest lengths of the
springs are optimized, so that the particle is at the target after a second (30 steps).

    python demo_diffsim_spring_cage.py
    python demo_diffsim_spring_cage.py --headless 60 --record spring_cage.html
    python demo_diffsim_spring_cage.py --headless 0 --check-grad
"""

from __future__ import annotations

import numpy as np
from demo_common import (
    check_gradient,
    loss_figure,
    make_parser,
    parse,
    run,
    save_figure,
    train,
    verdict,
)

import novaphy
from novaphy import diff, nova, viewer

FPS, STEPS = 30, 30
DT = 1.0 / FPS
TARGET = (0.375, 0.125, 0.25)
LEARNING_RATE = 0.5
CAGE = [
    (0.2, -0.7, 0.8),
    (1.1, 0.0, 0.2),
    (-1.2, 0.1, 0.1),
    (0.4, 0.6, 0.4),
    (-0.2, 0.7, -0.9),
    (0.1, -0.8, -0.8),
    (-0.8, -0.9, 0.2),
    (-0.1, 1.0, 0.4),
]


def build_model(device: str) -> novaphy.Model:
    """Build the particle, the fixed points of the cage (mass 0), and the springs."""
    builder = novaphy.ModelBuilder()
    builder.add_particle((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    for corner in CAGE:
        point = builder.add_particle(corner, (0.0, 0.0, 0.0), 0.0)
        builder.add_spring(0, point, ke=100.0, kd=10.0, control=0.0)
    return builder.finalize(device, requires_grad=True)


class SpringCage:
    """The rollout, its loss and the rest lengths that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        config = novaphy.solvers.DiffSolverConfig(enable_springs=True)
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.lengths = diff.model_spring_rest_length_tensor(self.model, requires_grad=True)

    def forward(self) -> nova.Tensor:
        """Run all steps. Return the squared distance {1} (m²) of the particle to the target."""
        self.solver.rollout(self.trajectory, None, None, DT)
        last = diff.state_particle_q_tensor(self.trajectory[STEPS])
        return diff.particle_point_loss_generated(last, 0, *TARGET)

    def train(self) -> float:
        """Run one iteration of gradient descent. Return the loss before its update."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            nova.sgd_update_f32(self.lengths, LEARNING_RATE)
            tape.zero()
        return loss.item()


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and the path of the particle in the cage before and after the training."""
    figure, right = loss_figure(losses, "squared distance to the target [m²]")
    for corner in CAGE:
        end = rollouts[-1][-1, 0]
        right.plot([corner[0], end[0]], [corner[2], end[2]], color="#dee2e6", linewidth=1.0)
        right.plot(corner[0], corner[2], "o", color="#adb5bd", markersize=5)
    for q, color, name in zip(rollouts, ("#adb5bd", "#2a6f97"), ("before", "after")):
        right.plot(q[:, 0, 0], q[:, 0, 2], color=color, linewidth=1.5, label=name)
    right.plot(TARGET[0], TARGET[2], "*", color="#c1121f", markersize=15, label="target", zorder=3)
    right.set(xlabel="x [m]", ylabel="z [m]", title="The particle in the cage")
    right.set_aspect("equal")
    right.legend(loc="lower left")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=60))
    cage = SpringCage(args.device)
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            cage.lengths, cage.forward, 1.0e-3, 5.0e-3
        )
    look = ((3.0, -2.9, 1.5), (0.0, 0.0, -0.1))
    with viewer.Stage(args, cage.model, fps=FPS, refresh=6, look=look, path_width=0.02) as stage:
        stage.mark(TARGET)
        losses = train(cage, args, 1, plot, stage, lambda q: q[:, 0])
    checks["a loss below 0.3 m²"] = max(losses) < 0.3
    checks["a loss that falls"] = not args.headless or losses[-1] < losses[0]
    print(
        f"spring cage on {cage.model.device}: {args.headless} iterations, "
        f"loss {losses[0]:.5f} -> {losses[-1]:.2e}, rest lengths {cage.lengths.numpy()} m, "
        f"{verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
