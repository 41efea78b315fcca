"""Let a Franka push a box to a mark, by the gradient through the push of its hand.

The seven axes of a Franka Research 3 follow four key poses with their drives for 1 s: 1,000 steps
of SolverFeatherstone. The tip of the hand is a sphere that pushes a box along x, against friction
(integrate_push_box_rollout_generated). The key poses are optimized, so that the box stops at x =
0.70 m, the tip moves along a straight line, and the joints move slowly.

The gradient is a product of two factors. The first factor is the adjoint of the contact, from a
tape. The second factor is the derivative of the tip's motion by the key poses, from
FeatherstoneAnalyticControlSensitivity. The contact is a smooth surrogate without a reaction on the
arm. The derivative treats the arm's mass matrix and forces as constants, unless --gradient is
exact. With --contact full, arm and box are one simulation (franka_contact.py).

    python demo_diffsim_franka_push_box.py
    python demo_diffsim_franka_push_box.py --train 5 --plot franka.png
    python demo_diffsim_franka_push_box.py --check-gradient
    python demo_diffsim_franka_push_box.py --train 5 --contact full
    python demo_diffsim_franka_push_box.py --headless 5 --record franka.html
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from demo_common import loss_figure, make_parser, parse, progress, run, save_figure, verdict

import novaphy
from novaphy import diff, nova, viewer
from novaphy.solvers import FeatherstoneAnalyticControlSensitivity, SolverFeatherstone

STEPS, DT, FPS = 1000, 1e-3, 50
KEYS, AXES = 4, 7
KE = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # N m/rad
KD = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)  # N m s/rad
FINGER_KE, FINGER_KD = 1e3, 50.0  # N/m, N s/m: drives that keep the fingers closed
TIP = (0.0, 0.0, 0.107 + 0.1034)  # m, in the frame of link 7
LINE = (0.0, 0.10)  # m, y and z of the line on which the tip should move
START = (0.40, 0.45, 0.50, 0.55)  # m, x of the tip at the key poses
NO_CONTACT = "no contact: the box does not move at all, so there is no gradient"
# Box: half extent (m), initial x (m), mass (kg), friction. Radius of the tip (m); contact gains.
HALF, BOX, MASS, FRICTION, RADIUS, CONTACT_KE, CONTACT_KD = 0.05, 0.55, 0.5, 0.3, 0.02, 2e3, 5.0
MARK = 0.70  # m, the goal of the box
SLOW, OFF_LINE, CALM = 0.01, 4.0, 1e-5  # weights of box speed, tip's distance to line, joint speeds
SAMPLE = 10  # steps between two samples of the tip's distance and of the joint speeds
DAMPING, TRIES = 1e-4, 8  # initial damping of Levenberg-Marquardt, largest number of tries per step


def build_model(device: str, with_box: bool = False) -> novaphy.Model:
    """Build the arm from its file, with drives. with_box: build the model for viewers instead."""
    builder = novaphy.ModelBuilder()
    looks = novaphy.ShapeConfig(density=0.0)
    builder.add_ground_plane(cfg=looks)
    builder.add_urdf(novaphy.assets.path("fr3.urdf"))
    if with_box:
        pose = (BOX, LINE[0], LINE[1], 0.0, 0.0, 0.0, 1.0)
        inertia = np.diag([MASS * HALF**2 * 2.0 / 3.0] * 3)
        box = builder.add_body(mass=MASS, inertia=inertia, xform=pose, label="box")
        builder.add_shape_box(box, hx=HALF, hy=HALF, hz=HALF, cfg=looks)
        stand = ((0.55, LINE[0], 0.5 * (LINE[1] - HALF)), (0.0, 0.0, 0.0, 1.0))
        table = {"hx": 0.3, "hy": 0.15, "hz": 0.5 * (LINE[1] - HALF)}
        builder.add_shape_box(-1, xform=stand, cfg=looks, **table)
    model = builder.finalize(device)
    dofs = axis_dofs(model)
    ke = np.full(model.joint_dof_count, FINGER_KE, np.float32)
    kd = np.full(model.joint_dof_count, FINGER_KD, np.float32)
    ke[dofs], kd[dofs] = KE, KD
    if with_box:  # the model of the viewers needs no drives
        return model
    model.joint_target_ke.assign(ke)
    model.joint_target_kd.assign(kd)
    mode = int(novaphy.JointTargetMode.POSITION_VELOCITY)
    model.joint_target_mode.assign(np.full(model.joint_dof_count, mode, np.int32))
    return model


def axis_dofs(model: novaphy.Model) -> list[int]:
    """Return the indices of the dofs of the seven axes."""
    start = model.joint_qd_start.numpy()
    names = [f"fr3_joint{k + 1}" for k in range(AXES)]
    return [int(start[index_of(model.joint_label, name)]) for name in names]


def index_of(labels: list[str], name: str) -> int:
    """Return the index of a name among labels. A label may have a prefix that ends in "/"."""
    return next(k for k, label in enumerate(labels) if label.split("/")[-1] == name)


def key_weights() -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of pose and rate of each step by the key poses, {steps, keys} each.
    The poses between two keys are a cubic (Catmull-Rom) spline. Its slope at a key is that of the
    line between the neighboring keys, and 0 at both ends."""
    x = (np.arange(STEPS) + 1.0) / STEPS * (KEYS - 1.0)
    k = np.minimum(x.astype(int), KEYS - 2)
    u = (x - k)[:, None]
    poses = np.eye(KEYS)
    slopes = np.zeros((KEYS, KEYS))
    slopes[1:-1] = 0.5 * (poses[2:] - poses[:-2])
    step = poses[k + 1] - poses[k]
    pose = poses[k] + (3 * u**2 - 2 * u**3) * step
    pose += (u**3 - 2 * u**2 + u) * slopes[k] + (u**3 - u**2) * slopes[k + 1]
    rate = 6 * (u - u**2) * step
    rate += (3 * u**2 - 4 * u + 1) * slopes[k] + (3 * u**2 - 2 * u) * slopes[k + 1]
    return pose, rate * (KEYS - 1.0) / (STEPS * DT)


class FrankaPush:
    """The rollout of arm and box, its loss, and the key poses that are optimized."""

    def __init__(self, device: str, exact: bool) -> None:
        self.model = build_model(device)
        self.looks = build_model(device, with_box=True)
        self.solver = SolverFeatherstone(self.model, angular_damping=0.0)
        self.dofs = axis_dofs(self.model)
        self.hand = index_of(self.model.body_label, "fr3_link7")
        self.sensitivity = self.make_sensitivity(KEYS * AXES, exact)
        self.probe = self.make_sensitivity(1, False)  # gives the position of the tip
        self.weights, self.rate_weights = key_weights()
        self.states = [self.model.state() for _ in range(STEPS + 1)]
        self.at_rest = self.model.state()
        self.control = self.model.control()
        self.keys = np.stack([self.inverse_kinematics(x) for x in START])
        self.first = self.keys[0].copy()
        self.damping = DAMPING

    def make_sensitivity(self, count: int, exact: bool) -> FeatherstoneAnalyticControlSensitivity:
        """Make the sensitivity of the tip to `count` parameters."""
        return FeatherstoneAnalyticControlSensitivity(
            self.model,
            parameter_count=count,
            point_body=self.hand,
            point_local=TIP,
            exact=exact,
            solver=self.solver,
        )

    def label(self) -> str:
        """Return a description of the gradient."""
        return f"surrogate contact, {self.sensitivity.label} dynamics, no reaction"

    def inverse_kinematics(self, x: float) -> np.ndarray:
        """Return the joint angles {7} (rad) with the hand pointing down and the tip at x (m) on the
        line. The arm is then equivalent to two bars in a plane."""
        upper, lower = np.hypot(0.316, 0.0825), np.hypot(0.384, 0.0825)
        x, z = x - 0.088, LINE[1] + TIP[2] - 0.333  # the vector from the shoulder to the wrist
        reach = np.hypot(x, z)
        elbow = np.arccos((upper**2 + lower**2 - reach**2) / (2.0 * upper * lower))
        lift = np.arccos((upper**2 + reach**2 - lower**2) / (2.0 * upper * reach))
        bends = np.arctan2(0.0825, 0.316), np.arctan2(0.0825, 0.384)
        j2 = np.pi / 2 - np.arctan2(z, x) - lift - bends[0]
        j4 = elbow - np.pi - bends[0] - bends[1]
        return np.array([0.0, j2, 0.0, j4, 0.0, j2 - j4, np.pi / 4])

    def place(self, state: novaphy.SimState, pose: np.ndarray) -> None:
        """Put the arm at rest in a pose."""
        q = np.zeros(self.model.joint_coord_count, np.float32)
        q[self.dofs] = pose
        state.joint_q.assign(q)
        state.joint_qd.zero_()

    def target(self, pose: np.ndarray) -> np.ndarray:
        """Return the targets {7} (rad) of the drives that hold a pose against gravity."""
        self.place(self.at_rest, pose)
        return pose + novaphy.eval_bias(self.model, self.at_rest)[self.dofs] / KE

    def target_by_pose(self) -> np.ndarray:
        """Return the derivative {axes, axes} of the last target by its pose. Frozen dynamics leave
        out the change of gravity forces with the pose in two places, here and in the arm's motion,
        where the two changes would cancel."""
        if self.sensitivity.label == "frozen":
            return np.eye(AXES)
        return self.exact_target_by_pose()

    def exact_target_by_pose(self) -> np.ndarray:
        """Return the derivative {axes, axes} of the last target, with changing gravity forces."""
        still = np.zeros(self.model.joint_dof_count, np.float32)
        stiffness = novaphy.eval_inverse_dynamics_derivatives(self.model, self.at_rest, still)[0][0]
        return np.eye(AXES) + stiffness[np.ix_(self.dofs, self.dofs)] / np.array(KE)[:, None]

    def forward(self, keys: np.ndarray, gradient: bool = False) -> None:
        """Run arm and box. With `gradient` also compute the derivatives of the tip and the
        joints."""
        s = self.sensitivity if gradient else self.probe
        poses, rates = self.weights @ keys, self.rate_weights @ keys
        target, rate = np.zeros((2, self.model.joint_dof_count), np.float32)
        change, rate_change = np.zeros(
            (2, self.model.joint_dof_count, s.parameter_count), np.float32
        )
        self.tip, self.tip_rate = np.zeros((2, STEPS, 3))
        self.by_keys = np.zeros((2, STEPS, 3, KEYS * AXES))
        self.speed_by_keys = np.zeros((STEPS, AXES, KEYS * AXES))
        self.place(self.states[0], self.first)
        s.reset(self.states[0])
        for t in range(STEPS):
            target[self.dofs], rate[self.dofs] = self.target(poses[t]), rates[t]
            self.control.joint_target_q.assign(target)
            self.control.joint_target_qd.assign(rate)
            now, then = self.states[t], self.states[t + 1]
            self.solver.step(now, then, self.control, None, DT)
            if gradient:
                change[self.dofs] = np.kron(self.weights[t], self.target_by_pose())
                rate_change[self.dofs] = np.kron(self.rate_weights[t], np.eye(AXES))
            s.step(now, then, self.control, DT, change, rate_change)
            self.tip[t], self.tip_rate[t] = s.point(), s.point_velocity()
            if gradient:
                self.by_keys[:, t] = s.point_jacobian, s.point_velocity_jacobian
                self.speed_by_keys[t] = s.dqd[self.dofs]
        self.push(gradient)

    def push(self, gradient: bool) -> None:
        """Move the box by the tip's motion. With `gradient` also set its final derivative."""
        x, v = (nova.tensor([number], requires_grad=True) for number in (BOX, 0.0))
        tip = [
            nova.tensor(np.float32(rows[:, 0]), requires_grad=True)
            for rows in (self.tip, self.tip_rate)
        ]
        numbers = (MASS, HALF, RADIUS, CONTACT_KE, CONTACT_KD, FRICTION, DT)
        with nova.Tape() as tape:
            xs, vs = diff.integrate_push_box_rollout_generated(x, v, *tip, *numbers)
        self.box, self.box_rate = xs.numpy().astype(np.float64), vs.numpy().astype(np.float64)
        if not gradient:
            return
        if np.all(self.box == np.float32(BOX)):
            raise ValueError(NO_CONTACT)
        last = np.zeros(STEPS, np.float32)
        last[-1] = 1.0
        self.end_by_keys = np.zeros((2, KEYS * AXES))
        for row, end in enumerate((xs, vs)):
            tape.zero()
            tape.backward(end, nova.tensor(last))
            for by_tip, by_keys in zip(tip, self.by_keys, strict=True):
                self.end_by_keys[row] += by_tip.grad.numpy().astype(np.float64) @ by_keys[:, 0]

    def residuals(self) -> np.ndarray:
        """Return the residuals {residuals}, whose sum of squares is the loss."""
        ends = [self.box[-1] - MARK, np.sqrt(SLOW) * self.box_rate[-1]]
        off = (self.tip[::SAMPLE, 1:] - LINE).ravel()
        speeds = np.array([s.joint_qd.numpy()[self.dofs] for s in self.states[1::SAMPLE]])
        weights = np.sqrt(OFF_LINE / (off.size / 2)), np.sqrt(CALM / len(speeds))
        return np.concatenate([ends, weights[0] * off, weights[1] * speeds.ravel()])

    def jacobian(self) -> np.ndarray:
        """Return the Jacobian {residuals, keys * axes} of the residuals by the key poses."""
        off = self.by_keys[0, ::SAMPLE, 1:].reshape(-1, KEYS * AXES)
        speeds = self.speed_by_keys[::SAMPLE].reshape(-1, KEYS * AXES)
        weights = np.sqrt(OFF_LINE / (len(off) / 2)), np.sqrt(CALM / (len(speeds) / AXES))
        ends = self.end_by_keys * np.array([[1.0], [np.sqrt(SLOW)]])
        return np.concatenate([ends, weights[0] * off, weights[1] * speeds])

    def loss(self, keys: np.ndarray) -> float:
        """Run a rollout with the key poses, and return its loss."""
        self.forward(keys)
        return float(np.sum(self.residuals() ** 2))

    def gradient(self) -> tuple[float, np.ndarray]:
        """Return the loss, and its gradient {keys * axes} with respect to the key poses."""
        self.forward(self.keys, gradient=True)
        residuals = self.residuals()
        return float(np.sum(residuals**2)), 2.0 * self.jacobian().T @ residuals

    def train(self) -> float:
        """Take one step of Levenberg and Marquardt. Return the loss before the step. The step is
        shortened until the loss falls."""
        before, gradient = self.gradient()
        jacobian = self.jacobian()
        for _ in range(TRIES):
            matrix = jacobian.T @ jacobian + self.damping * np.eye(KEYS * AXES)
            keys = self.keys - 0.5 * np.linalg.solve(matrix, gradient).reshape(KEYS, AXES)
            if self.loss(keys) < before:
                self.keys, self.damping = keys, self.damping / 4.0
                return before
            self.damping *= 4.0
        self.loss(self.keys)
        return before

    def difference(self, direction: np.ndarray) -> float:
        """Return the slope of the loss along a direction, from simulated rollouts. Rounding in
        1,000 steps moves the box by about 1e-6 m. Therefore a linear and a cubic term are fitted to
        central differences over several steps of some milliradians."""
        steps = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5]) * 4e-3
        ends = [
            [self.loss(self.keys + sign * eps * direction) for sign in (0.5, -0.5)] for eps in steps
        ]
        cubic = np.stack([steps, steps**3], axis=1)
        return float(np.linalg.lstsq(cubic, -np.diff(ends)[:, 0], rcond=None)[0][0])

    def check_gradient(self) -> bool:
        """Compare the gradient with differences along five random directions. The frozen gradient
        may differ by 5 %, the exact gradient by 1 %."""
        rng = np.random.default_rng(7)
        directions = rng.normal(size=(5, KEYS, AXES))
        directions /= np.linalg.norm(directions, axis=(1, 2), keepdims=True)
        fd = np.array([self.difference(direction) for direction in directions])
        chosen, passed = self.sensitivity, True
        for exact, tolerance in ((False, 5e-2), (True, 1e-2)):
            self.sensitivity = self.make_sensitivity(KEYS * AXES, exact)
            ad = np.tensordot(directions.reshape(5, -1), self.gradient()[1], 1)
            error = float(np.abs(ad - fd).max() / np.abs(fd).max())
            print(f"{self.label()}: relative error {error:.1e} (tolerance {tolerance:.0e})")
            print(f"  along five directions {np.round(ad, 5)}, differences {np.round(fd, 5)}")
            passed = passed and error <= tolerance
        self.sensitivity = chosen
        return passed

    def off_line(self) -> float:
        """Return the largest distance of the tip from its line (m)."""
        return float(np.linalg.norm(self.tip[:, 1:] - LINE, axis=1).max())

    def limits_kept(self) -> bool:
        """Return whether all axes stayed within their limits of angle and speed."""
        q, qd = (
            np.array([getattr(s, name).numpy()[self.dofs] for s in self.states])
            for name in ("joint_q", "joint_qd")
        )
        lower, upper, fastest = (
            getattr(self.model, f"joint_{name}").numpy()[self.dofs]
            for name in ("limit_lower", "limit_upper", "velocity_limit")
        )
        return bool(np.all(q >= lower) and np.all(q <= upper) and np.all(np.abs(qd) < fastest))

    def frames(self) -> Iterator[tuple[float, novaphy.SimState]]:
        """Yield times (s) and states of the frames of the last rollout, with the box."""
        state = self.looks.state()
        poses = state.body_q.numpy()
        box = index_of(self.looks.body_label, "box")
        for t in range(STEPS // FPS, STEPS + 1, STEPS // FPS):
            poses[: self.model.body_count] = self.states[t].body_q.numpy()
            poses[box, 0] = self.box[t - 1]
            state.body_q.assign(poses)
            yield t * DT, state

    def paths(self) -> dict[str, np.ndarray]:
        """Return the path of the tip in the last rollout {steps, 3} (m)."""
        return {"path": self.tip.astype(np.float32)}


def plot(path: str, losses: list[float], scene: FrankaPush) -> None:
    """Draw the loss, and the last rollout."""
    figure, right = loss_figure(losses, "loss")
    time = (np.arange(STEPS) + 1) * DT
    right.plot(time, scene.box, color="#f48c06", label="box x [m]")
    right.plot(time, scene.tip[:, 0], color="#2a6f97", label="tip x [m]")
    off = np.linalg.norm(scene.tip[:, 1:] - LINE, axis=1)
    right.plot(time, 0.01 * off / 1e-3, color="#adb5bd", label="tip off its line [0.1 m]")
    right.axhline(MARK, color="#d00000", linewidth=0.8, linestyle="--", label="mark")
    right.set(xlabel="time [s]", title="Push")
    right.legend()
    save_figure(figure, path)


def arguments() -> argparse.Namespace:
    """Parse the flags of all demos and the two flags of this demo."""
    parser = make_parser(__doc__, iterations=5)
    parser.add_argument(
        "--train", type=int, dest="headless", metavar="N", help="the same as --headless N"
    )
    parser.add_argument(
        "--check-gradient", action="store_true", dest="check_grad", help="the same as --check-grad"
    )
    parser.add_argument(
        "--gradient", choices=("frozen", "exact"), default="frozen", help="of the arm's dynamics"
    )
    parser.add_argument(
        "--contact",
        choices=("surrogate", "full"),
        default="surrogate",
        help="of tip and box: a smooth law without reaction, or rigid, in one simulation",
    )
    args = parse(parser)
    if args.device != "cpu":
        parser.error(f"--device: expected cpu, articulations run there only, got {args.device}")
    if args.check_grad and args.live:
        args.live, args.headless = False, 0
    return args


def make_scene(args: argparse.Namespace) -> FrankaPush:
    """Make the scene with the contact of the flags."""
    if args.contact == "full":
        from franka_contact import FullPush  # here, because franka_contact imports this module

        return FullPush(args.device, args.gradient == "exact")
    return FrankaPush(args.device, args.gradient == "exact")


def main() -> int:
    """Train, check, save and plot. Return 0 if every check passed."""
    args = arguments()
    scene = make_scene(args)
    print(scene.label())
    checks = {}
    if args.check_grad:
        checks["a gradient within the tolerance"] = scene.check_gradient()
    losses = []
    look = ((1.3, -1.4, 0.9), (0.35, 0.0, 0.25))
    with viewer.Stage(args, scene.looks, fps=FPS, look=look, path_width=0.006) as stage:
        stage.mark((MARK, LINE[0], LINE[1] - HALF), radius=0.012)
        for k in progress(range(args.headless)):
            losses.append(scene.train())
            stage.iteration(k, losses[-1], scene.frames, scene.paths)
        losses.append(scene.loss(scene.keys))
        stage.iteration(args.headless, losses[-1], scene.frames, scene.paths, last=True)
    if args.dump_states:
        novaphy.io.save_npz(
            args.dump_states,
            joint_q=np.array([s.joint_q.numpy() for s in scene.states]),
            tip=np.float32(scene.tip),
            box_x=np.float32(scene.box),
            keys=np.float32(scene.keys),
            loss=np.float32(losses),
        )
    if args.plot:
        plot(args.plot, losses, scene)
    if args.headless >= 5:
        checks["the box within 5 mm of its mark"] = abs(scene.box[-1] - MARK) < 5e-3
        checks["the tip within 10 mm of its line"] = scene.off_line() < 0.01
        checks["angles and speeds within their limits"] = scene.limits_kept()
    print(
        f"franka pushes a box on {scene.model.device}: {args.headless} iterations, loss "
        f"{losses[0]:.6f} -> {losses[-1]:.6f}, box at {scene.box[-1]:.4f} m, tip at most "
        f"{1e3 * scene.off_line():.1f} mm off its line, {verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
