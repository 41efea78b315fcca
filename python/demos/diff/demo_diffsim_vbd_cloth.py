"""Find the stiffness of a cloth from noisy positions, by implicit gradients through VBD.

A cloth of 0.6 m hangs from its upper side and swings. The measured data are the positions over 0.75
s of a simulation with a noise of 2 mm. The measured simulation has another step, more iterations
and other colors than the fitted simulation. The logarithm of a factor of the membrane stiffness is
optimized: the secant method finds a root of the loss's derivative. The demo checks the stiffness,
and the motion of the next 0.5 s, in which the upper side is moved. The fit does not use this
motion.

    python demo_diffsim_vbd_cloth.py
    python demo_diffsim_vbd_cloth.py --headless 6 --check-grad --plot vbd_cloth.png
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

FPS, FITTED, HELD_OUT = 60, 45, 30  # frames per second, frames of the fit, frames of the test
DT = 1.0 / FPS / 2
SUBSTEPS, ITERATIONS = 2, 12
TRUE_SUBSTEPS, TRUE_ITERATIONS = 6, 40
TRUE_STIFFNESS, START, NOISE = 24.0, 0.5, 2e-3  # N/m; initial factor; m
CELLS, SIZE = 8, 0.6  # per side; m
SWING = 0.1  # m, amplitude of the kinematic side in the part that is not fitted


def build_model(stiffness: float, reverse_colors: bool = False) -> novaphy.Model:
    """Build a cloth with a kinematic left side, optionally with colors in reverse order."""
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0.0, -0.5 * SIZE, 1.0), rot=(0.0, 0.5**0.5, 0.0, 0.5**0.5), dim_x=CELLS, dim_y=CELLS,
        cell_x=SIZE / CELLS, cell_y=SIZE / CELLS, mass=1.2e-3, fix_left=True, tri_ke=stiffness,
        tri_ka=stiffness, tri_kd=0.1, edge_ke=1e-3, edge_kd=1e-4,
    )  # fmt: skip
    builder.color(include_bending=not reverse_colors)
    model = builder.finalize()
    if reverse_colors:
        builder.set_coloring(model.particle_color_groups[::-1], allow_conflicts=True)
        model = builder.finalize()
    return model


def targets(model: novaphy.Model, frames: int, substeps: int) -> np.ndarray:
    """Return the positions of the kinematic side in every substep, {steps, k, 3} (m).

    The side first stands still, then swings.
    """
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0.0]
    time = (1 + np.arange(frames * substeps)) / (FPS * substeps)
    swing = SWING * np.sin(2 * np.pi * np.maximum(0.0, time - FITTED / FPS) / 0.8)
    path = np.repeat(held[None], len(time), 0)
    path[:, :, 0] += swing[:, None]
    return path.astype(np.float32)


def rollout(solver, substeps: int, frames: int) -> np.ndarray:
    """Return the positions {frames + 1, n, 3} (m) of every frame."""
    model = solver.model
    trajectory = diff.Trajectory(model, frames * substeps)
    places = nova.tensor(targets(model, frames, substeps))
    solver.rollout(trajectory, None, None, 1.0 / FPS / substeps, targets=places)
    return trajectory.particle_q.numpy()[::substeps]


def measure(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the measured motion with noise, and the true motion, {frames + 1, n, 3} (m) each."""
    true = novaphy.solvers.SolverVBD(
        build_model(TRUE_STIFFNESS, reverse_colors=True), iterations=TRUE_ITERATIONS
    )
    motion = rollout(true, TRUE_SUBSTEPS, FITTED + HELD_OUT)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, motion.shape)
    return (motion + noise).astype(np.float32), motion


class Cloth:
    """The rollout, its loss and the stiffness that is optimized."""

    def __init__(self) -> None:
        self.model = build_model(TRUE_STIFFNESS * START)
        self.solver = novaphy.solvers.DiffSolverVBD(
            self.model, iterations=ITERATIONS, gradient="implicit"
        )
        self.trajectory = diff.Trajectory(self.model, FITTED * SUBSTEPS)
        self.materials = diff.model_tri_material_tensor(self.model)
        stiff = np.zeros((self.model.tri_count, 5), np.float32)
        stiff[:, :2] = self.materials.numpy()[:, :2]
        self.stiff = nova.tensor(stiff)
        self.rest = nova.tensor(self.materials.numpy() - stiff)
        self.params = nova.tensor([0.0], requires_grad=True)
        self.measured, self.motion = measure()
        moving = self.model.particle_mass.numpy() > 0.0
        weight = np.where(moving, 1.0 / np.sqrt(FITTED * moving.sum()), 0.0)
        self.weight = nova.tensor(np.repeat(weight[:, None], 3, 1).astype(np.float32))
        self.wanted = [nova.tensor(frame) for frame in self.measured[1 : FITTED + 1]]
        self.last: tuple[float, float] | None = None  # the last logarithm and derivative

    @property
    def stiffness(self) -> float:
        """The stiffness of the membrane (N/m)."""
        return TRUE_STIFFNESS * START * float(np.exp(self.params.numpy()[0]))

    def forward(self) -> nova.Tensor:
        """Run all steps. Return the mean squared distance {1} (m²) to the measured positions."""
        factor = nova.broadcast_to(nova.exp(self.params), self.stiff.shape)
        self.materials.copy_(self.rest + self.stiff * factor)
        self.solver.rollout(self.trajectory, None, None, DT)
        loss = nova.zeros([1])
        for frame, wanted in enumerate(self.wanted, 1):
            at = diff.state_particle_q_tensor(self.trajectory[frame * SUBSTEPS])
            distance = (at - wanted) * self.weight
            loss = loss + nova.sum(distance * distance)
        return loss

    def train(self) -> float:
        """Run a rollout, the backward pass and a secant step of the derivative.

        Return the loss before the step.
        """
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            slope, value = float(self.params.grad.numpy()[0]), float(self.params.numpy()[0])
            tape.zero()
        step = -0.2 * np.sign(slope)
        if self.last is not None and slope != self.last[1]:
            secant = -slope * (value - self.last[0]) / (slope - self.last[1])
            step = float(np.clip(secant, -0.5, 0.5))
        self.last = (value, slope)
        self.params.assign(np.float32([value + step]))
        return loss.item()

    def predict(self) -> float:
        """Return the root mean square distance (m) to the true motion after the fitted frames."""
        found = novaphy.solvers.DiffSolverVBD(
            build_model(self.stiffness), iterations=ITERATIONS, gradient="implicit"
        )
        motion = rollout(found, SUBSTEPS, FITTED + HELD_OUT)
        distance = np.linalg.norm(motion - self.motion, axis=2)[FITTED + 1 :]
        return float(np.sqrt((distance**2).mean()))


def plot(path: str, losses: list[float], rollouts: list[np.ndarray]) -> None:
    """Draw the loss, and the height of the middle of the lower edge over time."""
    figure, right = loss_figure(losses, "mean square distance [m²]")
    lowest = (CELLS + 1) * (CELLS // 2) + CELLS
    measured, motion = measure()
    time = np.arange(FITTED + HELD_OUT + 1) / FPS
    right.plot(time, measured[:, lowest, 2], ".", color="#c1121f", markersize=3, label="measured")
    right.plot(time, motion[:, lowest, 2], color="#dda15e", linewidth=1, label="true")
    for q, color, name in zip(rollouts, ("#adb5bd", "#2a6f97"), ("before", "after"), strict=True):
        right.plot(np.arange(len(q)) * DT, q[:, lowest, 2], color=color, label=name)
    right.axvline(FITTED / FPS, color="#6c757d", linestyle=":", label="held out from here")
    right.set(xlabel="time [s]", ylabel="z [m]", title="The middle of the lower edge")
    right.legend(loc="upper left")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    parser = make_parser(__doc__, iterations=7)
    args = parse(parser)
    if args.device != "cpu":
        parser.error(f"--device: expected cpu, where VBD runs, got {args.device}")
    cloth = Cloth()
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            cloth.params, cloth.forward, 0.01, 2.0e-2
        )
    look = ((1.15, -0.9, 0.95), (0.0, 0.0, 0.7))
    with viewer.Stage(args, cloth.model, fps=FPS, refresh=2, look=look) as stage:
        losses = train(cloth, args, SUBSTEPS, plot, stage)
    error = abs(cloth.stiffness / TRUE_STIFFNESS - 1.0)
    distance = cloth.predict()
    if args.headless >= 6:
        checks["a stiffness within 2 %"] = error < 0.02
        checks["a held-out motion within 5 mm"] = distance < 5e-3
    print(
        f"vbd cloth: {args.headless} iterations, loss {losses[0]:.3e} -> {losses[-1]:.3e}, "
        f"stiffness {cloth.stiffness:.3f} N/m ({100 * error:.2f} % off), "
        f"held-out motion {1e3 * distance:.2f} mm off, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
