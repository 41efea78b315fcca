"""Fly a drone to a waypoint, where it hovers.

A drone of 1.2 kg hovers with four rotors, which rotate in alternating directions. Four commands
over 1.5 s are optimized: lift, roll, pitch and yaw, with 9 values each that are interpolated
linearly. The commands give the thrust of each rotor. At the end the drone should be at rest at the
waypoint, upright.

The thrusts act along the drone's axis. A kernel of this file converts the thrusts to the wrench on
the body in each of the 300 substeps. The adjoint of the kernel is generated.

    python demo_diffsim_drone.py
    python demo_diffsim_drone.py --headless 100 --plot drone.png --record drone.html
    python demo_diffsim_drone.py --headless 0 --check-grad
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

FPS, SUBSTEPS, FRAMES = 50, 4, 75
STEPS, DT = SUBSTEPS * FRAMES, 1.0 / (FPS * SUBSTEPS)
HALF = (0.1, 0.1, 0.03)  # half extents (m)
MASS, GRAVITY = 1.2, 9.81
ARM = 0.15  # m, distance of a rotor from the center along x and along y
SENSES = (1.0, -1.0, 1.0, -1.0)  # direction of rotation of each rotor, in order around the drone
DRAG = 0.02  # m: moment about the axis of a rotor (N m) per thrust (N)
KNOTS = 9
# Change of the thrusts (N) per unit of a command. Rows: lift, roll, pitch, yaw. Columns: rotors.
MIX = np.float32(
    [[1, 1, 1, 1], [0.1, 0.1, -0.1, -0.1], [-0.1, 0.1, 0.1, -0.1], [0.1, -0.1, 0.1, -0.1]]
)
START, WAYPOINT = (0.0, 0.0, 1.0), (0.8, 0.4, 1.5)  # m
LEARNING_RATE = 0.2  # step size of the commands
STILL, UPRIGHT = 0.05, 0.2


def build_model(device: str) -> novaphy.Model:
    """Build the drone above the ground, which the drone does not touch."""
    builder = novaphy.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    builder.add_ground_plane()
    density = MASS / (8.0 * HALF[0] * HALF[1] * HALF[2])
    body = builder.add_body(xform=(START, (0.0, 0.0, 0.0, 1.0)))
    look = novaphy.ShapeConfig(density=density)
    builder.add_shape_box(body, hx=HALF[0], hy=HALF[1], hz=HALF[2], cfg=look)
    return builder.finalize(device, requires_grad=True)


def rotor_wrench(c: nova.TraceContext) -> list[nova.Real]:
    """Return force (N) and moment (N m) of the rotors, about the center of mass, in world axes."""
    thrust = [c.f32("thrust", k) for k in range(4)]
    places = [(ARM, ARM), (-ARM, ARM), (-ARM, -ARM), (ARM, -ARM)]
    lift, moment = nova.Real(0.0), [nova.Real(0.0)] * 3
    for t, (x, y), sense in zip(thrust, places, SENSES, strict=True):
        lift = lift + t
        moment = [moment[0] + y * t, moment[1] - x * t, moment[2] + (sense * DRAG) * t]
    x, y, z, w = (c.f32("body_q", k) for k in range(3, 7))
    turn = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return [row[2] * lift for row in turn] + [
        row[0] * moment[0] + row[1] * moment[1] + row[2] * moment[2] for row in turn
    ]


def interpolation() -> np.ndarray:
    """Return weights {steps, knots} that interpolate the commands of knots linearly to substeps."""
    at = np.linspace(0.0, KNOTS - 1.0, STEPS)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(at - np.arange(KNOTS))).astype(np.float32)


class Drone:
    """The flight, its loss and the thrusts that are optimized."""

    def __init__(self, device: str) -> None:
        self.model = build_model(device)
        config = novaphy.solvers.DiffSolverConfig(enable_rigid_contacts=False)
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        self.states = [self.model.state() for _ in range(STEPS + 1)]
        self.rotors = nova.make_indexed_kernel(
            "rotor_wrench",
            [("body_q", nova.float32, 7), ("thrust", nova.float32, 4)],
            6,
            rotor_wrench,
        )
        self.commands = nova.zeros((KNOTS, 4), device=device, requires_grad=True)
        self.optimizer = nova.optim.Adam([self.commands], lr=LEARNING_RATE)
        self.basis = nova.tensor(interpolation(), device=device)
        self.mix = nova.tensor(MIX, device=device)
        goal, weights = np.float32([[*WAYPOINT, 0, 0, 0, 0]]), [[1, 1, 1, UPRIGHT, UPRIGHT, 0, 0]]
        self.goal = nova.tensor(goal, device=device)
        self.weights = nova.tensor(np.float32(weights), device=device)

    def thrusts(self) -> nova.Tensor:
        """Return the thrust (N) of each rotor in each substep, {steps, 4}: hover plus commands."""
        return (self.basis @ self.commands) @ self.mix + MASS * GRAVITY / 4.0

    def forward(self) -> nova.Tensor:
        """Simulate the flight, and return the loss {1}.

        The loss is the squared distance (m^2) from the waypoint, and terms of the remaining tilt
        and motion.
        """
        thrusts = self.thrusts()
        for t, (state, after) in enumerate(zip(self.states, self.states[1:], strict=False)):
            (wrench,) = self.rotors(1, [diff.state_body_q_tensor(state), thrusts[t : t + 1]])
            diff.state_body_f_tensor(state).copy_(wrench)
            self.solver.step(state, after, None, None, DT)
        away = diff.state_body_q_tensor(self.states[-1]) - self.goal
        twist = diff.state_body_qd_tensor(self.states[-1])
        return nova.sum(away * away * self.weights) + STILL * nova.sum(twist * twist)

    def train(self) -> float:
        """Compute one gradient and one update. Return the loss before the update."""
        with nova.Tape() as tape:
            loss = self.forward()
            tape.backward(loss)
            self.optimizer.step()
            tape.zero()
        return loss.item()

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last flight."""
        return ((k / FPS, self.states[k * SUBSTEPS]) for k in range(FRAMES + 1))

    def poses(self) -> np.ndarray:
        """Return all poses of the last flight, {steps + 1, 7}."""
        return np.array([state.body_q.numpy()[0] for state in self.states])


def plot(path: str, losses: list[float], poses: np.ndarray, thrusts: np.ndarray) -> None:
    """Draw the loss, and the position and the thrusts over time."""
    figure, right = loss_figure(losses, "loss [m²]", widths=(4.0, 8.0))
    spec = right.get_subplotspec()
    right.remove()
    left, right = spec.subgridspec(1, 2).subplots()
    time = np.arange(STEPS + 1) * DT
    for k, color in enumerate(("#2a6f97", "#e09f3e", "#5f7f4f")):
        left.plot(time, poses[:, k], color=color, label="xyz"[k])
        left.plot(time[-1], WAYPOINT[k], "x", color=color, markersize=10)
    left.set(xlabel="time [s]", ylabel="m", title="Position, and the waypoint")
    left.legend()
    right.plot(time[1:], thrusts, label=[f"rotor {k + 1}" for k in range(4)])
    right.axhline(MASS * GRAVITY / 4.0, color="#adb5bd", linestyle=":", label="hover")
    right.set(xlabel="time [s]", ylabel="N", title="Thrusts")
    right.legend(fontsize="small")
    save_figure(figure, path)


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = parse(make_parser(__doc__, iterations=100))
    drone, checks = Drone(args.device), {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = check_gradient(
            drone.commands, drone.forward, 5e-2, 2e-2, range(8)
        )
    losses: list[float] = []
    look = ((0.5, -6.4, 3.0), (0.4, 0.2, 2.1))
    with viewer.Stage(args, drone.model, fps=FPS, refresh=10, look=look, path_width=0.012) as stage:
        stage.mark(WAYPOINT, radius=0.04)

        def paths() -> dict[str, np.ndarray]:
            return {"path": drone.poses()[:, :3]}

        for k in progress(range(args.headless)):
            losses.append(drone.train())
            stage.iteration(k, losses[-1], drone.frames, paths)
        losses.append(drone.forward().item())
        stage.iteration(args.headless, losses[-1], drone.frames, paths, last=True)
    poses = drone.poses()
    away = float(np.linalg.norm(poses[-1, :3] - WAYPOINT))
    if args.dump_states:
        novaphy.io.save_npz(args.dump_states, body_q=poses, loss=np.float32(losses))
    if args.plot:
        plot(args.plot, losses, poses, drone.thrusts().numpy())
    if args.headless >= 100:
        checks["the drone within 2 cm of the waypoint"] = away < 0.02
        checks["a loss below 0.005"] = losses[-1] < 0.005
    print(
        f"drone on {drone.model.device}: {args.headless} iterations, loss {losses[0]:.4f} -> "
        f"{losses[-1]:.2e}, {1000 * away:.1f} mm from the waypoint, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
