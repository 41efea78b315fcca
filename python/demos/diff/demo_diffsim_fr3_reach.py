"""Reach a pose with an arm of seven axes by optimizing the targets of its drives.

The Franka Research 3 starts at rest and moves for 0.75 s under gravity. Four targets for each axis
are optimized, each constant for 45 of the 180 substeps. At the end the hand should have a given
pose and be at rest. Drives with effort limits follow the targets. One iteration is a rollout of
DiffFeatherstoneSolver, a backward pass and a step of Adam.

    python demo_diffsim_fr3_reach.py
    python demo_diffsim_fr3_reach.py --headless 150 --plot reach.png
    python demo_diffsim_fr3_reach.py --headless 0 --check-grad
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from demo_common import loss_figure, make_parser, parse, progress, run, save_figure, verdict

import novaphy
from novaphy import diff, nova, viewer

STEPS, DT, KNOTS = 180, 1.0 / 240.0, 4
FPS, SUBSTEPS = 60, 4
HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])  # initial (rad)
KE, KD = 600.0, 50.0  # N m/rad, N m s/rad: gains of the drives
PLACE = (0.45, 0.3, 0.35)  # m, the goal of the hand's position
TURN = (0.9239, -0.3827, 0.0, 0.0)  # xyzw, the goal: the hand points down, rotated by 45 degrees
WEIGHTS = (1.0, 0.1, 0.0005)  # of the squared distance (1/m²), sin(angle / 2), rates (s²/rad²)
LEARNING_RATE = 0.1  # rad, decays as 1 / (1 + iteration / 50)


def build_model(device: str) -> tuple[novaphy.Model, int]:
    """Build the arm with drives and open fingers. Return the model and the body of the hand."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(density=0.0))
    robot = builder.add_urdf(novaphy.assets.path("fr3.urdf"))
    builder.joint_q = builder.joint_target_q = [*HOME, 0.04, 0.04]
    builder.joint_target_ke = [KE] * 7 + [200.0] * 2
    builder.joint_target_kd = [KD] * 7 + [5.0] * 2
    builder.joint_target_mode = [int(novaphy.JointTargetMode.POSITION)] * 9
    return builder.finalize(device, requires_grad=True), robot.links["fr3_hand"]


class Reach:
    """The rollout, its loss and the targets that are optimized."""

    def __init__(self, device: str) -> None:
        self.model, self.hand = build_model(device)
        self.solver = novaphy.solvers.DiffFeatherstoneSolver(
            self.model, angular_damping=0.05, contact=None
        )
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.controls = [self.model.control() for _ in range(KNOTS)]
        for control in self.controls:
            control.joint_target_q.requires_grad = True
        self.targets = np.tile(HOME, (KNOTS, 1))
        self.moments = np.zeros((2, KNOTS, 7))
        self.iterations = 0
        self.goal = np.float32([*PLACE, *TURN])
        self.goal[3:] /= np.linalg.norm(self.goal[3:])

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the loss {1}: how far the hand is from goal and rest."""
        for control, targets in zip(self.controls, self.targets, strict=True):
            control.joint_target_q.assign(np.float32([*targets, 0.04, 0.04]))
        self.solver.rollout(self.trajectory, self.controls, None, DT)
        end = self.trajectory[STEPS]
        pose = diff.state_body_q_tensor(end)[self.hand : self.hand + 1]
        away = (pose - nova.tensor(self.goal[None])) * nova.tensor(np.float32([[1] * 3 + [0] * 4]))
        along = nova.sum(pose * nova.tensor(np.float32([[*[0] * 3, *self.goal[3:]]])))
        rates = diff.state_joint_qd_tensor(end)
        loss = WEIGHTS[0] * nova.sum(away * away) + WEIGHTS[1] * (1.0 - along * along)
        return loss + WEIGHTS[2] * nova.sum(rates * rates)

    def gradient(self) -> tuple[float, np.ndarray]:
        """Return the loss, and its gradient with respect to the targets, {knots, 7}."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            gradient = np.array([c.joint_target_q.grad.numpy()[:7] for c in self.controls], float)
            tape.zero()
        return loss.item(), gradient

    def train(self) -> float:
        """Run one iteration of Adam. Return the loss before its update."""
        loss, gradient = self.gradient()
        self.iterations += 1
        first, second = self.moments
        first += 0.1 * (gradient - first)
        second += 0.01 * (gradient**2 - second)
        mean = first / (1.0 - 0.9**self.iterations)
        spread = np.sqrt(second / (1.0 - 0.99**self.iterations)) + 1e-10
        rate = LEARNING_RATE / (1.0 + self.iterations / 50.0)
        self.targets -= rate * mean / spread
        lower, upper = (
            getattr(self.model, f"joint_limit_{end}").numpy()[:7] for end in ("lower", "upper")
        )
        self.targets = np.clip(self.targets, lower, upper)
        return loss

    def check_gradient(self) -> bool:
        """Compare some values of the gradient with central differences."""
        _, gradient = self.gradient()
        start, eps, chosen = self.targets.copy(), 0.02, ((0, 0), (1, 3), (3, 5))
        ends = []
        for at in chosen:
            pair = []
            for sign in (1.0, -1.0):
                self.targets = start.copy()
                self.targets[at] += sign * eps
                pair.append(self.forward().item())
            ends.append((pair[0] - pair[1]) / (2.0 * eps))
        self.targets = start
        ad, fd = np.array([gradient[at] for at in chosen]), np.array(ends)
        error = float(np.max(np.abs(ad - fd)) / np.max(np.abs(fd)))
        print(f"gradient  ad {ad}  fd {fd}  relative error {error:.1e} (tolerance 1e-02)")
        return error < 1e-2

    def errors(self) -> tuple[float, float]:
        """Return the distance (m) and the angle (degrees) of the hand from its goal at the end."""
        pose = self.trajectory[STEPS].body_q.numpy()[self.hand]
        along = min(1.0, abs(float(pose[3:] @ self.goal[3:])))
        away = float(np.linalg.norm(pose[:3] - self.goal[:3]))
        return away, float(np.degrees(2.0 * np.arccos(along)))

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout.

        The initial state is left out, because only steps set the poses of bodies.
        """
        for k in range(0, STEPS + 1, SUBSTEPS):
            yield k * DT, self.trajectory[max(1, k)]

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path of the hand in the last rollout, by name."""
        way = [self.trajectory[t].body_q.numpy()[self.hand, :3] for t in range(1, STEPS + 1)]
        return {"path": np.stack(way).astype(np.float32)}


def plot(path: str, losses: list[float], scene: Reach) -> None:
    """Draw the loss, and the target and actual angles of the axes in the last rollout."""
    figure, right = loss_figure(losses, "loss")
    right.set_prop_cycle(None)
    time = np.arange(STEPS + 1) * DT
    q = np.array([scene.trajectory[t].joint_q.numpy()[:7] for t in range(STEPS + 1)])
    steps = np.arange(KNOTS + 1) * (STEPS // KNOTS) * DT
    for k in range(7):
        (line,) = right.plot(time, q[:, k], label=f"axis {k + 1}")
        held = np.append(scene.targets[:, k], scene.targets[-1, k])
        right.step(steps, held, color=line.get_color(), where="post", alpha=0.4, linestyle="--")
    right.set(xlabel="time [s]", title="Axes (lines) and targets (dashed) [rad]")
    right.legend(fontsize=7, ncol=2)
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=150))
    scene = Reach(args.device)
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = scene.check_gradient()
    losses = []
    look = ((1.6, -1.2, 1.1), (0.3, 0.1, 0.4))
    with viewer.Stage(args, scene.model, fps=FPS, refresh=10, look=look, path_width=0.008) as stage:
        stage.mark(PLACE, radius=0.02)
        for k in progress(range(args.headless)):
            losses.append(scene.train())
            stage.iteration(k, losses[-1], scene.frames, scene.paths)
        losses.append(scene.gradient()[0])
        stage.iteration(args.headless, losses[-1], scene.frames, scene.paths, last=True)
    away, turned = scene.errors()
    if args.dump_states:
        q = np.array([scene.trajectory[t].joint_q.numpy() for t in range(STEPS + 1)])
        novaphy.io.save_npz(
            args.dump_states, joint_q=q, target_q=np.float32(scene.targets), loss=np.float32(losses)
        )
    if args.plot:
        plot(args.plot, losses, scene)
    if args.headless >= 150:
        checks["the hand within 5 mm and 2 degrees"] = away < 5e-3 and turned < 2.0
    print(
        f"FR3 on {scene.model.device}: {args.headless} iterations, loss {losses[0]:.4f} -> "
        f"{losses[-1]:.6f}, hand {1e3 * away:.1f} mm and {turned:.1f} degrees from its goal, "
        f"{verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
