"""Swing a pole up by pushing the cart that it hangs on.

The cart moves along a rail. The pole hangs on the cart by a hinge without a motor. The force on the
cart is optimized: 60 values over 2 s, each for 8 of the 480 substeps. At the end the pole should be
upright and the cart in the middle, both at rest. One iteration is a rollout of
DiffFeatherstoneSolver, a backward pass and a step of Adam.

    python demo_diffsim_cart_pole.py
    python demo_diffsim_cart_pole.py --headless 300 --plot cart_pole.png
    python demo_diffsim_cart_pole.py --headless 0 --check-grad
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from demo_common import loss_figure, make_parser, parse, progress, run, save_figure, verdict

import novaphy
from novaphy import diff, nova, viewer

STEPS, DT, FORCES = 480, 1.0 / 240.0, 60
FPS, SUBSTEPS = 60, 4
LENGTH, CART, POLE = 0.5, 1.0, 0.2  # hinge to the pole's center of mass (m), masses (kg)
LEARNING_RATE, EFFORT = 0.4, 1e-4  # N, decays as 1 / (1 + iteration / 100); 1/N², force weight
IDENTITY = (0.0, 0.0, 0.0, 1.0)
FLOATING = (0.0, 0.0, 1.0, *IDENTITY)


def build_model(device: str) -> novaphy.Model:
    """Build the cart on its rail, 1 m above the ground. The pole hangs down."""
    builder = novaphy.ModelBuilder()
    looks = novaphy.ShapeConfig(density=0.0)
    builder.add_ground_plane(cfg=looks)
    cart = builder.add_link(mass=CART, inertia=np.diag([0.01] * 3), lock_inertia=True)
    inertia = np.diag([POLE * LENGTH**2 / 3.0] * 2 + [1e-3])
    pole = builder.add_link(mass=POLE, inertia=inertia, lock_inertia=True)
    joints = [
        builder.add_joint_prismatic(-1, cart, axis=(1.0, 0.0, 0.0), parent_xform=FLOATING),
        builder.add_joint_revolute(
            cart, pole, axis=(0.0, 1.0, 0.0), child_xform=(0.0, 0.0, LENGTH, *IDENTITY)
        ),
    ]
    builder.add_shape_box(cart, hx=0.15, hy=0.1, hz=0.06, cfg=looks)
    builder.add_shape_box(pole, hx=0.02, hy=0.02, hz=LENGTH, cfg=looks)
    builder.add_articulation(joints)
    return builder.finalize(device, requires_grad=True)


class CartPole:
    """The rollout, its loss and the forces that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        self.solver = novaphy.solvers.DiffFeatherstoneSolver(self.model, angular_damping=0.0)
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.controls = [self.model.control() for _ in range(FORCES)]
        for control in self.controls:
            control.joint_f.requires_grad = True
        # The initial force oscillates at the pole's frequency. A force of 0 has a gradient of 0,
        # because swinging up in both directions is equally good.
        self.forces = 2.0 * np.sin(np.arange(FORCES) * (STEPS / FORCES * DT) * 4.4)
        self.moments = np.zeros((2, FORCES))
        self.iterations = 0

    def forward(self) -> nova.Tensor:
        """Run all substeps. Return the loss {1}: the distance of the final state from the goal."""
        for control, force in zip(self.controls, self.forces, strict=True):
            control.joint_f.assign(np.float32([force, 0.0]))
        self.solver.rollout(self.trajectory, self.controls, None, DT)
        end = self.trajectory[STEPS]
        q, qd = diff.state_joint_q_tensor(end), diff.state_joint_qd_tensor(end)
        upright = 1.0 + nova.cos(q[1:2])
        return upright + 0.3 * q[0:1] * q[0:1] + 0.05 * nova.sum(qd * qd)

    def gradient(self) -> tuple[float, np.ndarray]:
        """Return the loss plus the weighted squared forces, and the gradient by the forces."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            gradient = np.array([c.joint_f.grad.numpy()[0] for c in self.controls], np.float64)
            tape.zero()
        effort = EFFORT * float(np.mean(self.forces**2))
        return loss.item() + effort, gradient + 2.0 * EFFORT / FORCES * self.forces

    def train(self) -> float:
        """Run one iteration of Adam. Return the loss before its update."""
        loss, gradient = self.gradient()
        self.iterations += 1
        first, second = self.moments
        first += 0.1 * (gradient - first)
        second += 0.01 * (gradient**2 - second)
        mean = first / (1.0 - 0.9**self.iterations)
        spread = np.sqrt(second / (1.0 - 0.99**self.iterations)) + 1e-8
        rate = LEARNING_RATE / (1.0 + self.iterations / 100.0)
        self.forces -= rate * mean / spread
        return loss

    def check_gradient(self) -> bool:
        """Compare some values of the gradient with central differences."""
        _, gradient = self.gradient()
        start, eps, chosen = self.forces.copy(), 0.1, (0, 17, 41)
        ends = []
        for k in chosen:
            pair = []
            for sign in (1.0, -1.0):
                self.forces = start.copy()
                self.forces[k] += sign * eps
                pair.append(self.forward().item() + EFFORT * float(np.mean(self.forces**2)))
            ends.append((pair[0] - pair[1]) / (2.0 * eps))
        self.forces = start
        ad, fd = gradient[list(chosen)], np.array(ends)
        error = float(np.max(np.abs(ad - fd)) / np.max(np.abs(fd)))
        print(f"gradient  ad {ad}  fd {fd}  relative error {error:.1e} (tolerance 1e-02)")
        return error < 1e-2

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout.

        The initial state is left out, because only steps set the poses of bodies.
        """
        for k in range(0, STEPS + 1, SUBSTEPS):
            yield k * DT, self.trajectory[max(1, k)]

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path of the pole's end in the last rollout {steps + 1, 3} (m), by name."""
        q = self.coordinates()
        x, z = q[:, 0] - 2.0 * LENGTH * np.sin(q[:, 1]), 1.0 - 2.0 * LENGTH * np.cos(q[:, 1])
        return {"path": np.stack([x, np.zeros_like(x), z], axis=1).astype(np.float32)}

    def coordinates(self) -> np.ndarray:
        """Return the cart's position (m) and the pole's angle (rad) of all states of the last
        rollout.

        The shape is {steps + 1, 2}.
        """
        return np.array([self.trajectory[t].joint_q.numpy() for t in range(STEPS + 1)])


def plot(path: str, losses: list[float], scene: CartPole) -> None:
    """Draw the loss, and the motion and the force of the last rollout."""
    figure, right = loss_figure(losses, "loss")
    time = np.arange(STEPS + 1) * DT
    q = scene.coordinates()
    right.plot(time, q[:, 0], color="#2a6f97", label="cart [m]")
    right.plot(time, q[:, 1] / np.pi, color="#f48c06", label="pole [half turns]")
    steps = np.arange(FORCES) * (STEPS // FORCES) * DT
    right.step(steps, scene.forces / 10.0, color="#adb5bd", where="post", label="force [10 N]")
    right.set(xlabel="time [s]", title="Swing-up")
    right.legend()
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=300))
    scene = CartPole(args.device)
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = scene.check_gradient()
    losses = []
    look = ((0.0, -4.0, 1.2), (0.0, 0.0, 1.0))
    with viewer.Stage(args, scene.model, fps=FPS, refresh=20, look=look, path_width=0.008) as stage:
        for k in progress(range(args.headless)):
            losses.append(scene.train())
            stage.iteration(k, losses[-1], scene.frames, scene.paths)
        losses.append(scene.gradient()[0])
        stage.iteration(args.headless, losses[-1], scene.frames, scene.paths, last=True)
    q = scene.coordinates()
    if args.dump_states:
        novaphy.io.save_npz(
            args.dump_states, joint_q=q, force=np.float32(scene.forces), loss=np.float32(losses)
        )
    if args.plot:
        plot(args.plot, losses, scene)
    if args.headless >= 300:
        checks["the pole upright"] = bool(np.cos(q[-1, 1]) < -0.99)
    print(
        f"cart and pole on {scene.model.device}: {args.headless} iterations, loss "
        f"{losses[0]:.4f} -> {losses[-1]:.5f}, pole at {np.degrees(q[-1, 1]):.1f} degrees, "
        f"{verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
