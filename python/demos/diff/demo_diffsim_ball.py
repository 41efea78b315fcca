"""Throw a ball off a wall so that it lands on a target, by gradient descent through the simulation.

The initial velocity of one particle is optimized. Every step of the simulation runs on the regular
arrays of a ``SimState`` and is recorded by a ``nova.Tape``. ``tape.backward(loss)`` computes the
gradient of the landing error through 288 substeps with two contacts. Contacts are found only once,
in the first state, so the wall acts as the half-space behind its front face.

    python demo_diffsim_ball.py
    python demo_diffsim_ball.py --headless 150 --plot ball.png --record ball.html
    python demo_diffsim_ball.py --check-grad
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from demo_common import (
    check_gradient,
    dump_states,
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

FPS, FRAMES, SUBSTEPS = 60, 36, 8
STEPS = FRAMES * SUBSTEPS
DT = 1.0 / FPS / SUBSTEPS
TARGET = (0.0, -2.0, 1.5)
LEARNING_RATE = 0.02


def build_model(device: str) -> novaphy.Model:
    """Build one particle in front of a wall, above the ground."""
    builder = novaphy.ModelBuilder()
    builder.add_particle(pos=(0.0, -0.5, 1.0), vel=(0.0, 5.0, -5.0), mass=1.0)
    cfg = novaphy.ShapeConfig(ke=1.0e4, kd=10.0, kf=0.0, mu=0.2)
    builder.add_shape_box(
        -1, xform=((0.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0)), hx=1.0, hy=0.25, hz=1.0, cfg=cfg
    )
    builder.add_ground_plane(cfg=cfg)
    model = builder.finalize(device, requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 1.0e4, 10.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
    return model


class Ball:
    """The rollout and its loss."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        # Newton's gradient is that of the code.
        config = novaphy.solvers.DiffSolverConfig(contact_gradient="code")
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.states = [self.model.state() for _ in range(STEPS + 1)]
        self.control = self.model.control()
        pipeline = novaphy.CollisionPipeline(
            self.model, broad_phase="explicit", soft_contact_margin=10.0
        )
        self.contacts = pipeline.contacts()
        pipeline.collide(self.states[0], self.contacts)
        self.velocity = diff.state_particle_qd_tensor(self.states[0], requires_grad=True)

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the squared distance {1} (m²) of the ball to the target."""
        for state, next_state in zip(self.states, self.states[1:]):
            state.clear_forces()
            self.solver.step(state, next_state, self.control, self.contacts, DT)
        return diff.particle_point_loss_generated(
            diff.state_particle_q_tensor(self.states[-1]), 0, *TARGET
        )

    def train(self) -> float:
        """Run one iteration of gradient descent. Return the loss before its update."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            nova.sgd_update_f32(self.velocity, LEARNING_RATE)
            tape.zero()
        return loss.item()

    def positions(self) -> np.ndarray:
        """Return all positions of the last rollout, {STEPS + 1, n, 3} (m)."""
        return np.stack([state.particle_q.numpy() for state in self.states])

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout."""
        return ((k / FPS, self.states[k * SUBSTEPS]) for k in range(FRAMES + 1))


def plot(path: str, losses: list[float], trajectories: list[np.ndarray]) -> None:
    """Draw the loss and the trajectories over the iterations, in the plane of the throw."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    figure, right = loss_figure(losses, "squared distance to the target [m²]")
    last = len(trajectories) - 1
    scale = plt.cm.ScalarMappable(cmap="viridis_r", norm=plt.Normalize(0, max(last, 1)))
    shown = sorted({round(k) for k in np.linspace(0, last, 25)})  # more lines would overlap
    for k in shown:
        q = trajectories[k]
        right.plot(q[:, 0, 1], q[:, 0, 2], color=scale.to_rgba(k), linewidth=1.2)
    start = trajectories[0][0, 0]
    right.plot(start[1], start[2], "ko", markersize=6, label="start")
    right.plot(TARGET[1], TARGET[2], "*", color="#c1121f", markersize=15, label="target", zorder=3)
    right.add_patch(
        plt.Rectangle((1.75, 0.0), 0.5, 2.0, facecolor="#adb5bd", edgecolor="#495057", label="wall")
    )
    right.axhspan(-0.25, 0.0, color="#dee2e6")
    right.text(-2.4, -0.18, "ground", color="#495057")
    figure.colorbar(scale, ax=right, pad=0.01, label="iteration", ticks=MaxNLocator(integer=True))
    right.set(
        xlabel="y [m]", ylabel="z [m]", title="Trajectories", xlim=(-2.6, 2.4), ylim=(-0.25, 2.2)
    )
    right.set_aspect("equal")
    right.legend(loc="upper left", ncols=3)
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=150))
    ball = Ball(args.device)
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            ball.velocity, ball.forward, eps=1.0e-3, tolerance=3.0e-3
        )
    losses, trajectories = [], []
    look = ((5.6, -1.5, 1.9), (0.0, 0.1, 0.8))
    with viewer.Stage(args, ball.model, fps=FPS, refresh=16, look=look) as stage:
        stage.mark(TARGET, 0.06)
        for k in progress(range(args.headless)):
            losses.append(ball.train())
            trajectories.append(ball.positions())
            stage.iteration(k, losses[-1], ball.frames, {"path": trajectories[-1][:, 0]})
        final = ball.forward().item()
        losses.append(final)
        trajectories.append(ball.positions())
        path = {"path": trajectories[-1][:, 0]}
        stage.iteration(args.headless, final, ball.frames, path, last=True)

    if args.dump_states:
        dump_states(args.dump_states, trajectories[-1], SUBSTEPS, losses)
    if args.plot:
        plot(args.plot, losses, trajectories)
    drops = -np.diff(losses[:31])  # later the loss may jump when a contact begins or ends
    checks["a loss that falls by 1e-3 m² in each of 30 iterations"] = bool(np.all(drops > 1.0e-3))
    checks["a loss that falls"] = final < losses[0] or not args.headless
    print(
        f"ball on {ball.model.device}: {args.headless} iterations, "
        f"loss {losses[0]:.4f} -> {final:.4f}, "
        f"v0 = {ball.velocity.numpy().ravel()}, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
