"""Teach a soft gripper to hold a load that slipped before, by gradients through VBD.

A soft gripper holds objects from inside by expanding. Here it sits in a slot between two walls,
with a load of 0.5 kg at its lower end, and only friction holds it. With its initial expansion the
gripper slips, and the load drops by tens of centimeters. The expansions (activations) of four
layers are optimized, so that the load has not moved after half a second. The gradient goes through
60 implicit steps with contact and friction.

    python demo_diffsim_vbd_gripper.py
    python demo_diffsim_vbd_gripper.py --headless 15 --check-grad --plot vbd_gripper.png
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

FPS, FRAMES, SUBSTEPS, ITERATIONS = 60, 30, 2, 10
STEPS, DT = FRAMES * SUBSTEPS, 1.0 / (FPS * SUBSTEPS)
CELLS, LAYERS, CELL, RADIUS = 3, 4, 0.04, 0.002  # cells per side; layers; cell, particle (m)
LOAD, FRICTION = 0.5, 0.8  # kg, friction coefficient
WALL = 1.4  # height of the walls (m), so tall that the gripper stays between them
FIRST, LARGEST = 0.05, 0.4  # initial and largest expansion, relative to the rest volume
RATE = 0.05  # change of the expansion in an iteration


def build_model() -> novaphy.Model:
    """Build the gripper with its load between two walls that it just touches."""
    builder = novaphy.ModelBuilder()
    builder.add_soft_grid(
        pos=(-0.5 * CELLS * CELL, -0.5 * CELLS * CELL, 1.0), dim_x=CELLS, dim_y=CELLS, dim_z=LAYERS,
        cell_x=CELL, cell_y=CELL, cell_z=CELL, density=200.0, k_mu=4e3, k_lambda=4e3, k_damp=4.0,
        particle_radius=RADIUS,
    )  # fmt: skip
    lowest = np.array(builder.particle_q)[:, 2] < 1.0 + 0.5 * CELL
    mass = np.array(builder.particle_mass) + np.where(lowest, LOAD / lowest.sum(), 0.0)
    builder.particle_mass = mass.astype(np.float32)
    surface = novaphy.ShapeConfig(ke=2e3, kd=0.0, mu=FRICTION)
    for side in (-1.0, 1.0):
        away = side * (0.5 * CELLS * CELL + RADIUS + 0.05)
        builder.add_shape_box(
            -1, xform=((away, 0.0, 0.5 * WALL), (0.0, 0.0, 0.0, 1.0)),
            hx=0.05, hy=0.15, hz=0.5 * WALL, cfg=surface,
        )  # fmt: skip
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 2e3, 0.0, FRICTION
    return model


class Gripper:
    """The rollout, its loss and the expansions that are optimized."""

    def __init__(self) -> None:
        self.model = build_model()
        self.solver = novaphy.solvers.DiffSolverVBD(self.model, iterations=ITERATIONS)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.control = self.model.control()
        self.activation = diff.control_tet_activation_tensor(self.control)
        q = self.model.particle_q.numpy()
        layer = ((q[self.model.tet_indices.numpy()].mean(1)[:, 2] - 1.0) / CELL).astype(int)
        # A positive activation shrinks an element, because the law adds it to the relative volume.
        self.of_layers = nova.tensor(-np.eye(LAYERS, dtype=np.float32)[layer])
        self.params = nova.tensor(np.full((LAYERS, 1), FIRST, np.float32), requires_grad=True)
        self.lowest = q[:, 2] < 1.0 + 0.5 * CELL
        weight = np.zeros_like(q)
        weight[self.lowest, 2] = 1.0 / np.sqrt(self.lowest.sum())
        self.weight, self.start = nova.tensor(weight), nova.tensor(q * weight)

    @property
    def drop(self) -> float:
        """The fall of the load in the last rollout (m)."""
        q = self.trajectory.particle_q.numpy()[:, self.lowest, 2].mean(1)
        return float(q[0] - q[-1])

    @property
    def speed(self) -> float:
        """The speed of the load at the end of the last rollout (m/s)."""
        q = self.trajectory.particle_q.numpy()[-2:, self.lowest].mean(1)
        return float(np.linalg.norm(q[1] - q[0])) / DT

    def forward(self) -> nova.Tensor:
        """Run all steps. Return the mean squared fall {1} (m²) of the load."""
        self.activation.copy_(nova.matmul(self.of_layers, self.params))
        self.solver.rollout(self.trajectory, self.control, None, DT, pipeline=self.pipeline)
        fell = diff.state_particle_q_tensor(self.trajectory[STEPS]) * self.weight - self.start
        return nova.sum(fell * fell)

    def train(self) -> float:
        """Run a rollout, the backward pass and a step of fixed length against the gradient.

        Return the loss before the step.
        """
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            slope, value = self.params.grad.numpy(), self.params.numpy()
            tape.zero()
        length = RATE * min(1.0, self.drop / 0.02) if self.drop > 0.0 else 0.0
        step = length * slope / max(float(np.abs(slope).max()), 1e-20)
        self.params.assign(np.clip(value - step, 0.0, LARGEST).astype(np.float32))
        return loss.item()


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and the gripper at the end of the first and of the last rollout."""
    import matplotlib.pyplot as plt

    figure, right = loss_figure(losses, "mean square of the load's fall [m²]", (4.4, 4.4))
    for q, color, name in zip(rollouts, ("#adb5bd", "#2a6f97"), ("before", "after"), strict=True):
        right.plot(q[-1, :, 0], q[-1, :, 2], "o", color=color, markersize=4, label=name)
    wall = 0.5 * CELLS * CELL + RADIUS
    for x in (-wall - 0.1, wall):
        right.add_patch(plt.Rectangle((x, 0.0), 0.1, WALL, facecolor="#dee2e6"))
    right.axhline(1.0, color="#c1121f", linestyle=":", label="where the load was")
    right.set(xlabel="x [m]", ylabel="z [m]", title="The gripper after half a second")
    right.set_aspect("equal", "datalim")
    right.legend(loc="center right")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    parser = make_parser(__doc__, iterations=15)
    args = parse(parser)
    if args.device != "cpu":
        parser.error(f"--device: expected cpu, where VBD runs, got {args.device}")
    gripper = Gripper()
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            gripper.params, gripper.forward, 1e-3, 5e-3
        )
    gripper.forward()
    before = gripper.drop
    look = ((0.35, -2.3, 1.0), (0.0, 0.0, 0.7))
    with viewer.Stage(args, gripper.model, fps=FPS, refresh=5, look=look) as stage:
        losses = train(gripper, args, SUBSTEPS, plot, stage)
    checks["a load that dropped by more than 0.1 m before"] = before > 0.1
    if args.headless >= 15:
        checks["a load that is held within 20 mm"] = abs(gripper.drop) < 0.02
        checks["a load at rest, slower than 2 cm/s"] = gripper.speed < 0.02
    expansion = ", ".join(f"{100 * p:.0f} %" for p in gripper.params.numpy()[:, 0])
    print(
        f"vbd gripper: {args.headless} iterations, loss {losses[0]:.3e} -> {losses[-1]:.3e}, "
        f"load dropped {1e3 * before:.0f} mm -> {1e3 * gripper.drop:.1f} mm "
        f"at {1e3 * gripper.speed:.1f} mm/s, "
        f"layers expand by {expansion}, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
