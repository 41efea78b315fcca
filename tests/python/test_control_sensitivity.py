"""FeatherstoneAnalyticControlSensitivity: against a linearised replay, and the real rollout."""

from __future__ import annotations

from collections.abc import Callable

import fr3
import numpy as np
import pytest

import novaphy
from novaphy.solvers import FeatherstoneAnalyticControlSensitivity, SolverFeatherstone

ANGULAR_DAMPING = 0.05  # 1/s, so that the replays see it
DT = 1e-3
IDENTITY = (0.0, 0.0, 0.0, 1.0)
START = np.array([0.0, 0.0654, 0.0, -2.7266, 0.0, 2.7920, 0.7854])
GOAL = START + np.array([0.05, 0.06, -0.04, 0.05, 0.03, -0.04, 0.05])  # within the efforts
Policy = Callable[..., np.ndarray]


class Rollout:
    """Steps of the regular solver under a control, with sensitivities when asked."""

    def __init__(self, builder: novaphy.ModelBuilder, body: int, local: tuple, **solver: object):
        """`body` and `local` name the point that is watched."""
        self.model = builder.finalize()
        self.solver = SolverFeatherstone(
            self.model, **{"angular_damping": ANGULAR_DAMPING, **solver}
        )
        self.body, self.local = body, local

    def sensitivity(self, count: int, **options: object) -> FeatherstoneAnalyticControlSensitivity:
        """One for the watched point."""
        return FeatherstoneAnalyticControlSensitivity(
            self.model,
            parameter_count=count,
            point_body=self.body,
            point_local=self.local,
            solver=self.solver,
            **options,
        )

    def run(
        self,
        steps: int,
        q: np.ndarray,
        apply: Callable,
        watch: list[FeatherstoneAnalyticControlSensitivity] | None = None,
        change: Callable | None = None,
        each: Callable | None = None,
    ) -> np.ndarray:
        """State, point and its velocity at the end.

        `apply(control, t, state)` sets the control of step t, `change(t, state, s)` gives dcontrol.
        """
        control = self.model.control()
        now, then = self.model.state(), self.model.state()
        now.joint_q.assign(np.float32(q))
        probe = self.sensitivity(1, kind="torque")
        for s in watch or []:
            s.reset(now)
        for t in range(steps):
            apply(control, t, now)
            self.solver.step(now, then, control, None, DT)
            for s in watch or []:
                s.step(now, then, control, DT, change(t, now, s))
            if each:
                each(t, now, then)
            now, then = then, now
        probe.reset(now)
        return np.concatenate(
            [now.joint_q.numpy(), now.joint_qd.numpy(), probe.point(), probe.point_velocity()]
        ).astype(np.float64)


def target(theta: np.ndarray) -> Callable:
    """A control that holds the target theta."""

    def apply(control: novaphy.Control, t: int, state: novaphy.SimState) -> None:
        control.joint_target_q.assign(np.float32(theta))

    return apply


def result(s: FeatherstoneAnalyticControlSensitivity) -> np.ndarray:
    """What a Rollout's end changes by, {n, parameters}."""
    return np.concatenate([s.dq, s.dqd, s.point_jacobian, s.point_velocity_jacobian])


def differences(end: Callable, theta: np.ndarray, eps: float) -> np.ndarray:
    """Central differences of end(theta), {n, parameters}."""
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = eps
        columns.append((end(theta + step) - end(theta - step)) / (2 * eps))
    return np.stack(columns, axis=1)


def agreement(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Largest difference relative to the largest entry, cosine, ratio of norms."""
    worst = float(np.abs(a - b).max() / np.abs(b).max())
    cosine = float(np.sum(a * b) / np.linalg.norm(a) / np.linalg.norm(b))
    return worst, cosine, float(np.linalg.norm(a) / np.linalg.norm(b))


def slider(**dof: object) -> novaphy.ModelBuilder:
    """A mass of 2 kg on a rail, without gravity."""
    b = novaphy.ModelBuilder(gravity=0.0)
    link = b.add_link(mass=2.0, inertia=np.eye(3) * 0.1, lock_inertia=True)
    drive = {
        "target_ke": 80.0,
        "target_kd": 6.0,
        "damping": 0.5,
        "actuator_mode": novaphy.JointTargetMode.POSITION,
    }
    b.add_articulation([b.add_joint_prismatic(-1, link, axis=(1.0, 0.0, 0.0), **(drive | dof))])
    return b


@pytest.mark.parametrize("implicit", [True, False])
def test_on_one_rail_the_linearisation_is_exact(implicit: bool) -> None:
    rollout = Rollout(slider(), 0, (0.0, 0.1, 0.0), implicit_drives=implicit)
    theta = np.array([0.3])
    watch = [rollout.sensitivity(1, exact=exact) for exact in (False, True)]
    rollout.run(200, [0.0], target(theta), watch, lambda t, state, s: [[1.0]])
    fd = differences(lambda x: rollout.run(200, [0.0], target(x)), theta, 0.1)
    for s in watch:
        np.testing.assert_allclose(result(s), fd, rtol=1e-4, atol=1e-6)
    # Backward Euler of m q'' = ke (target - q) - (kd + damping) q' in closed form, two numbers.
    if implicit:
        a = 2.0 + DT * 6.5 + DT**2 * 80.0
        q = v = 0.0
        for _ in range(200):
            v += DT * (80.0 * (1.0 - q - DT * v) - 6.5 * v) / a
            q += DT * v
        assert watch[0].dq[0, 0] == pytest.approx(q, rel=1e-5)


def arm_rollout() -> Rollout:
    """The FR3 with its tip."""
    return Rollout(fr3.builder(), 6, fr3.TCP)


def test_the_model_of_the_arm_is_where_it_should_be() -> None:
    rollout = arm_rollout()
    s = rollout.sensitivity(7)
    state = rollout.model.state()
    q = [0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4]
    state.joint_q.assign(np.float32(q))
    s.reset(state)
    np.testing.assert_allclose(s.point(), (0.30689, 0.0, 0.48688), atol=2e-5)
    gravity = novaphy.eval_bias(rollout.model, state)
    np.testing.assert_allclose(
        gravity, (0.0, -1.709, -0.6395, 18.9582, 0.7919, 1.5879, 0.0), atol=2e-4
    )


Part = tuple[np.ndarray, np.ndarray, np.ndarray]  # a target, by the parameters, and by q


class LinearisedReplay:
    """Small motions about a rollout of the arm, with the matrices that its steps had."""

    def __init__(self, rollout: Rollout) -> None:
        """Record by `each` of Rollout.run."""
        self.model, self.q, self.inverses = rollout.model, [], []
        self.ke, self.kd = np.diag(fr3.KE), np.diag(fr3.KD) + 0.003 * np.eye(7)

    def record(self, t: int, now: novaphy.SimState, then: novaphy.SimState) -> None:
        """A step."""
        mass = novaphy.eval_mass_matrix(self.model, now)[0].astype(np.float64)
        self.inverses.append(np.linalg.inv(mass + DT * self.kd + DT**2 * self.ke))
        self.q.append(now.joint_q.numpy().astype(np.float64))
        rows = novaphy.eval_jacobian(self.model, then)[0, 36:42].astype(np.float64)
        arm = quat_matrix(then.body_q.numpy()[6, 3:].astype(np.float64))
        arm = arm @ (np.array(fr3.TCP) - np.array(fr3.COM[6]))
        self.point = rows[:3] + np.cross(rows[3:].T, arm).T

    def end(self, policy: Callable[..., Part], theta: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Return the change of the end (q, qd, tip) for parameters `moved` instead of theta."""
        dq, dv = np.zeros((2, 7))
        for t, (q, inverse) in enumerate(zip(self.q, self.inverses, strict=True)):
            shift = policy(moved, t, q + dq)[0] - policy(theta, t, q)[0]
            dv = dv + DT * inverse @ (self.ke @ (shift - dq - DT * dv) - self.kd @ dv)
            dq = dq + DT * dv
            dv = (1.0 - ANGULAR_DAMPING * DT) * dv
        return np.concatenate([dq, dv, self.point @ dq, self.point @ dv])


def test_frozen_is_the_linearised_replay_and_exact_the_real_rollout() -> None:
    rollout = arm_rollout()
    frozen, exact = rollout.sensitivity(7, exact=False), rollout.sensitivity(7)  # the default
    assert (frozen.label, exact.label) == ("frozen", "exact")
    replay = LinearisedReplay(rollout)
    watch = [frozen, exact]
    rollout.run(300, START, target(GOAL), watch, lambda t, x, s: np.eye(7), replay.record)

    def hold(theta: np.ndarray, t: int, q: np.ndarray) -> Part:
        return theta, np.eye(7), np.zeros((7, 7))

    expected = differences(lambda x: replay.end(hold, GOAL, x), GOAL, 0.02)
    worst, _, _ = agreement(result(frozen), expected)
    assert worst < 1e-3
    fd = differences(lambda x: rollout.run(300, START, target(x)), GOAL, 0.02)
    worst, cosine, ratio = agreement(result(exact), fd)
    print(f"exact: {worst:.1e}, cosine {cosine:.6f}, ratio {ratio:.5f}")
    assert worst < 3e-3
    worst, cosine, ratio = agreement(frozen.dq, fd[:7])
    print(f"frozen dq: {worst:.1e}, cosine {cosine:.5f}, ratio {ratio:.4f}")
    assert 1e-3 < worst < 0.06
    assert cosine > 0.999
    assert abs(ratio - 1.0) < 0.03


def quat_matrix(q: np.ndarray) -> np.ndarray:
    """The rotation of a quaternion xyzw."""
    x, y, z, w = q
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


SPAN = 120  # steps of the parameterisations
MIX = np.random.default_rng(5).normal(size=(7, 3)) * 0.1


def along(weights: np.ndarray, theta: np.ndarray) -> Part:
    """A target between poses {n, 7} by their weights {n}."""
    return weights @ theta.reshape(-1, 7), np.kron(weights, np.eye(7)), np.zeros((7, 7))


def key_poses(theta: np.ndarray, t: int, q: np.ndarray) -> Part:
    """Three poses, at rest at each of them."""
    k, x = divmod(2.0 * (t + 1) / SPAN, 1.0)
    k, x = (1, 1.0) if k == 2 else (int(k), x)
    weights, rise = np.zeros(3), 3.0 * x**2 - 2.0 * x**3
    weights[k], weights[k + 1] = 1.0 - rise, rise
    return along(weights, theta)


def spline(theta: np.ndarray, t: int, q: np.ndarray) -> Part:
    """A uniform cubic B-spline of five control points."""
    k, x = divmod(2.0 * t / SPAN, 1.0)
    weights = np.zeros(5)
    weights[int(k) : int(k) + 4] = (
        np.array([(1 - x) ** 3, 3 * x**3 - 6 * x**2 + 4, -3 * x**3 + 3 * x**2 + 3 * x + 1, x**3])
        / 6.0
    )
    return along(weights, theta)


def net(theta: np.ndarray, t: int, q: np.ndarray) -> Part:
    """GOAL + MIX tanh(a (q - GOAL)) + b, by its gains a {3, 7} and b {7}."""
    a, b = theta[:21].reshape(3, 7), theta[21:]
    hidden = np.tanh(a @ (q - GOAL))
    slope = (1 - hidden**2)[:, None]
    by_a = np.einsum("ih,hj->ihj", MIX * slope[:, 0], np.tile(q - GOAL, (3, 1)))
    by_theta = np.concatenate([by_a.reshape(7, 21), np.eye(7)], axis=1)
    return GOAL + MIX @ hidden + b, by_theta, MIX @ (slope * a)


def poses(count: int) -> np.ndarray:
    """From START to GOAL."""
    return np.concatenate([START + x * (GOAL - START) for x in np.linspace(0.0, 1.0, count)])


def gains() -> np.ndarray:
    """Of the net."""
    rng = np.random.default_rng(6)
    return np.concatenate([rng.normal(size=21) * 0.5, rng.normal(size=7) * 0.02])


@pytest.mark.parametrize(
    ("policy", "theta"),
    [
        pytest.param(key_poses, poses(3), id="key poses"),
        pytest.param(spline, poses(5), id="spline"),
        pytest.param(net, gains(), id="gains of a net"),
    ],
)
def test_any_parameterisation_enters_by_what_moves_the_target(
    policy: Callable[..., Part], theta: np.ndarray
) -> None:
    rollout = arm_rollout()
    replay = LinearisedReplay(rollout)

    def apply(theta: np.ndarray) -> Callable:
        return lambda control, t, state: control.joint_target_q.assign(
            np.float32(policy(theta, t, state.joint_q.numpy().astype(np.float64))[0])
        )

    def change(t: int, state: novaphy.SimState, s: object) -> np.ndarray:
        _, by_theta, by_q = policy(theta, t, state.joint_q.numpy().astype(np.float64))
        return by_theta + by_q @ s.dq

    frozen, exact = (rollout.sensitivity(theta.size, exact=e) for e in (False, True))
    rollout.run(SPAN, START, apply(theta), [frozen, exact], change, replay.record)
    fd = differences(lambda x: replay.end(policy, theta, x), theta, 1e-4)
    assert agreement(result(frozen), fd)[0] < 1e-3
    fd = differences(lambda x: rollout.run(SPAN, START, apply(x)), theta, 0.02)
    assert agreement(result(exact), fd)[0] < 1e-2
    assert agreement(frozen.dq, fd[:7])[1] > 0.99


def quadruped() -> novaphy.ModelBuilder:
    """A floating box with a leg of two hinges."""
    b = novaphy.ModelBuilder()
    base = b.add_link(mass=3.0, com=(0.02, -0.01, 0.03), inertia=np.diag([0.04, 0.05, 0.06]))
    thigh = b.add_link(mass=0.8, com=(0.0, 0.0, -0.1), inertia=np.diag([0.004, 0.004, 0.001]))
    shank = b.add_link(mass=0.5, com=(0.0, 0.0, -0.1), inertia=np.diag([0.003, 0.003, 0.001]))
    turn = (0.0, 0.0, np.sin(0.3), np.cos(0.3))
    joints = [
        b.add_joint_free(base),
        b.add_joint_revolute(
            base, thigh, axis=(1.0, 0.0, 0.0), parent_xform=(0.1, 0.0, 0.0, *turn)
        ),
        b.add_joint_revolute(
            thigh,
            shank,
            axis=(0.0, 1.0, 0.0),
            parent_xform=(0.0, 0.0, -0.2, *IDENTITY),
            damping=0.05,
        ),
    ]
    b.add_articulation(joints)
    return b


def test_torques_of_a_free_root_are_exact() -> None:
    rollout = Rollout(quadruped(), 2, (0.0, 0.0, -0.2))
    start = np.array([0.1, 0.2, 1.0, 0.1, -0.2, 0.3, 0.9273618, 0.3, -0.5])
    theta = np.array([3.0, -1.0, 25.0, 0.4, -0.3, 0.2, 0.5, -0.2])

    def apply(x: np.ndarray) -> Callable:
        return lambda control, t, state: control.joint_f.assign(np.float32(x * np.cos(0.01 * t)))

    s = [rollout.sensitivity(8, kind="torque", exact=e) for e in (True, False)]
    rollout.run(150, start, apply(theta), s, lambda t, x, s: np.eye(8) * np.cos(0.01 * t))
    fd = differences(lambda x: rollout.run(150, start, apply(x)), theta, 0.02)
    point = fd[-6:]
    exact = np.concatenate([s[0].point_jacobian, s[0].point_velocity_jacobian])
    assert agreement(exact, point)[0] < 3e-3
    # Hinges and rates compare directly. The root's tangents are those of the center of mass.
    assert agreement(s[0].dq[6:], fd[7:9])[0] < 3e-3
    assert agreement(s[0].dqd, fd[9:17])[0] < 3e-3
    frozen = np.concatenate([s[1].point_jacobian, s[1].point_velocity_jacobian])
    assert agreement(frozen, point)[1] > 0.9


def test_frozen_torques_are_the_linearised_replay() -> None:
    rollout = Rollout(quadruped(), 2, (0.0, 0.0, -0.2))
    s = rollout.sensitivity(8, kind="torque", exact=False)
    dv, de = np.zeros((8, 8)), np.zeros((8, 8))

    def replay(t: int, now: novaphy.SimState, then: novaphy.SimState) -> None:
        nonlocal dv, de
        mass = novaphy.eval_mass_matrix(rollout.model, now)[0].astype(np.float64)
        damping = np.diag([0.0] * 7 + [0.05])
        dv = dv + DT * np.linalg.solve(mass + DT * damping, np.eye(8) - damping @ dv)
        factor = np.array([1.0] * 3 + [1.0 - ANGULAR_DAMPING * DT] * 5)
        w = then.joint_qd.numpy()[3:6].astype(np.float64) / (1.0 - ANGULAR_DAMPING * DT)
        y = 0.5 * DT * w
        turn = quat_matrix(np.append(y, 1.0) / np.sqrt(1.0 + y @ y))
        old = de
        de = de + DT * dv
        de[3:6] = turn @ old[3:6]
        de[3:6] += DT / (1.0 + y @ y) * (dv[3:6] + np.cross(y, dv[3:6].T).T)
        dv = factor[:, None] * dv

    def push(control: novaphy.Control, t: int, state: novaphy.SimState) -> None:
        control.joint_f.assign(np.float32([0.5, 0.0, 30.0, 0.5, -0.4, 0.3, 0.1, 0.1]))

    start = np.array([0.0, 0.0, 1.0, 0.1, -0.2, 0.3, 0.9273618, 0.3, -0.5])
    rollout.run(200, start, push, [s], lambda t, x, s: np.eye(8), replay)
    assert agreement(s.dqd, dv)[0] < 1e-3
    assert agreement(s.dq, de)[0] < 1e-3


class ContactRun:
    """A model on a ground, stepped with contacts and a sensitivity by its joint forces."""

    def __init__(self, builder: novaphy.ModelBuilder, body: int, start: np.ndarray):
        """`body`: whose origin is watched."""
        self.model = builder.finalize()
        self.solver = SolverFeatherstone(self.model, angular_damping=ANGULAR_DAMPING)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.body, self.start = body, start

    def sensitivity(self) -> FeatherstoneAnalyticControlSensitivity:
        """By all joint forces."""
        return FeatherstoneAnalyticControlSensitivity(
            self.model,
            parameter_count=self.model.joint_dof_count,
            point_body=self.body,
            kind="torque",
            contact_projection=True,
            solver=self.solver,
        )

    def run(self, steps: int, force: np.ndarray, s: object = None, each: Callable | None = None):
        """The last state."""
        self.solver.notify_model_changed(novaphy.ModelFlags.ALL)  # without impulses to start from
        control = self.model.control()
        control.joint_f.assign(np.float32(force))
        now, then = self.model.state(), self.model.state()
        now.joint_q.assign(np.float32(self.start))
        novaphy.eval_fk(self.model, now.joint_q, now.joint_qd, now)
        if s is not None:
            s.reset(now)
        for _ in range(steps):
            self.pipeline.collide(now, self.contacts)
            self.solver.step(now, then, control, self.contacts, DT)
            if s is not None:
                s.step(now, then, control, DT, np.eye(len(force)), contacts=self.contacts)
            if each is not None:
                each(now, then)
            now, then = then, now
        return now

    def normals(self, state: novaphy.SimState, links: np.ndarray) -> np.ndarray:
        """Rows {n, dofs} of the normals that push, by the bodies' Jacobians {b, 6, dofs}."""
        c, rows = self.contacts, []
        poses = state.body_q.numpy().astype(np.float64)
        of_shape, com = self.model.shape_body.numpy(), self.model.body_com.numpy()
        for i in range(int(c.rigid_contact_count.numpy()[0])):
            n = c.rigid_contact_normal.numpy()[i].astype(np.float64)
            if c.rigid_contact_force.numpy()[i] @ n <= 0.0:
                continue
            sides = []
            for side, sign in ((0, 1.0), (1, -1.0)):
                body = of_shape[getattr(c, f"rigid_contact_shape{side}").numpy()[i]]
                p = getattr(c, f"rigid_contact_point{side}").numpy()[i].astype(np.float64)
                if body >= 0:
                    p = poses[body, :3] + quat_matrix(poses[body, 3:]) @ p
                out = sign * getattr(c, f"rigid_contact_margin{side}").numpy()[i] * n
                sides.append((-sign, body, p + out))
            middle = 0.5 * (sides[0][2] + sides[1][2])
            row = np.zeros(links.shape[2])
            for sign, body, _ in sides:
                if body >= 0:
                    center = poses[body, :3] + quat_matrix(poses[body, 3:]) @ com[body]
                    at = links[body, :3] + np.cross(links[body, 3:].T, middle - center).T
                    row += sign * n @ at
            rows.append(row)
        return np.array(rows).reshape(-1, links.shape[2])


def standing_quadruped() -> novaphy.ModelBuilder:
    """The quadruped with balls at its foot and below its base, above a ground."""
    b = quadruped()
    b.add_ground_plane()
    b.add_shape_sphere(2, xform=((0.0, 0.0, -0.2), IDENTITY), radius=0.03)
    for x, y in ((-0.2, -0.1), (-0.2, 0.1), (0.2, -0.1)):
        b.add_shape_sphere(0, xform=((x, y, -0.2), IDENTITY), radius=0.05)
    return b


def test_normals_that_push_are_held_as_in_the_linearised_replay() -> None:
    start = np.array([0.0, 0.0, 0.35, 0.0, 0.0, 0.0, 1.0, 0.9, -0.5])
    run = ContactRun(standing_quadruped(), 2, start)
    s = run.sensitivity()
    dv, de, pushed = np.zeros((8, 8)), np.zeros((8, 8)), []
    jacobian = held = None

    def replay(now: novaphy.SimState, then: novaphy.SimState) -> None:
        # In double precision, with the mass matrix, Jacobian and normals of every step.
        nonlocal dv, de, jacobian, held
        mass = novaphy.eval_mass_matrix(run.model, now)[0].astype(np.float64)
        damping = np.diag([0.0] * 7 + [0.05])
        m = mass + DT * damping
        dv = dv + DT * np.linalg.solve(m, np.eye(8) - damping @ dv)
        links = novaphy.eval_jacobian(run.model, now)[0].reshape(3, 6, 8).astype(np.float64)
        held = n = run.normals(now, links)
        pushed.append(len(n))
        response = np.linalg.solve(m, n.T)
        dv -= response @ np.linalg.lstsq(n @ response, n @ dv, rcond=1e-9)[0]
        w = then.joint_qd.numpy()[3:6].astype(np.float64) / (1.0 - ANGULAR_DAMPING * DT)
        y = 0.5 * DT * w
        turn = quat_matrix(np.append(y, 1.0) / np.sqrt(1.0 + y @ y))
        old = de
        de = de + DT * dv
        de[3:6] = turn @ old[3:6]
        de[3:6] += DT / (1.0 + y @ y) * (dv[3:6] + np.cross(y, dv[3:6].T).T)
        dv = np.array([1.0] * 3 + [1.0 - ANGULAR_DAMPING * DT] * 5)[:, None] * dv
        body = novaphy.eval_jacobian(run.model, then)[0, 12:].astype(np.float64)
        pose = then.body_q.numpy()[2].astype(np.float64)
        arm = quat_matrix(pose[3:]) @ -run.model.body_com.numpy()[2]
        jacobian = body[:3] + np.cross(body[3:].T, arm).T

    force = np.array([3.0, 1.0, -5.0, 0.2, 0.1, -0.3, -0.4, 0.5])
    run.run(300, force, s, replay)
    assert s.label == "frozen"
    assert {0, 1, 2, 3} <= set(pushed)  # in flight, and on up to three feet
    expected = np.concatenate([de, dv, jacobian @ de, jacobian @ dv])
    worst, _, _ = agreement(result(s), expected)
    print(f"projected: {worst:.1e}, contacts {np.mean(pushed):.1f}")
    assert worst < 1e-3
    assert np.abs(held @ s.dqd).max() < 1e-3 * np.abs(s.dqd).max()  # to the angular damping


def test_a_contact_that_slides_on_ice_is_exact() -> None:
    b = novaphy.ModelBuilder()
    rail = b.add_link(mass=1.5, inertia=np.eye(3) * 0.1, lock_inertia=True)
    puck = b.add_link(mass=0.5, inertia=np.eye(3) * 0.1, lock_inertia=True)
    ice = novaphy.ShapeConfig(mu=0.0)
    b.add_ground_plane(cfg=ice)
    b.add_shape_sphere(puck, radius=0.1, cfg=ice)
    b.add_articulation(
        [
            b.add_joint_prismatic(-1, rail, axis=(1.0, 0.0, 0.0)),
            b.add_joint_prismatic(rail, puck, axis=(0.6, 0.0, 0.8)),
        ]
    )
    run = ContactRun(b, puck, np.array([0.0, 0.125]))
    s = run.sensitivity()
    force = np.array([2.0, -3.0])
    run.run(200, force, s)

    def end(x: np.ndarray) -> np.ndarray:
        last = run.run(200, x)
        return np.concatenate([last.joint_q.numpy(), last.joint_qd.numpy()]).astype(np.float64)

    fd = differences(end, force, 0.05)
    assert agreement(np.concatenate([s.dq, s.dqd]), fd)[0] < 1e-3
    # The point stays on the ice. Both dofs move by 0.6 m per m of the second, by the ratio of the
    # masses.
    assert np.abs(s.point_jacobian[2]).max() < 1e-6


def test_contacts_of_a_sensitivity_are_checked() -> None:
    b = standing_quadruped()
    box = b.add_body(xform=((0.0, 0.0, 0.1), IDENTITY), mass=0.5, inertia=np.eye(3) * 0.01)
    b.add_shape_sphere(box, radius=0.05)
    start = [0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 1.0, 0.9, -0.5, -0.2, -0.1, -0.5, 0.0, 0.0, 0.0, 1.0]
    run = ContactRun(b, 2, np.array(start))
    s = FeatherstoneAnalyticControlSensitivity(
        run.model,
        parameter_count=1,
        point_body=2,
        kind="torque",
        contact_projection=True,
        solver=run.solver,
    )
    now, then = run.model.state(), run.model.state()
    now.joint_q.assign(np.float32(start))
    novaphy.eval_fk(run.model, now.joint_q, now.joint_qd, now)
    run.pipeline.collide(now, run.contacts)
    run.solver.step(now, then, None, run.contacts, DT)
    s.reset(now)
    column = np.ones((8, 1))
    # With impulses that did not act, and without impulses that did.
    with pytest.raises(novaphy.Error, match="state_out: expected what .* contacts"):
        s.step(now, then, None, DT, column)
    force = run.contacts.rigid_contact_force.numpy()
    run.contacts.rigid_contact_force.assign(force * np.float32(1.01))
    with pytest.raises(novaphy.Error, match="state_out: expected what .* contacts"):
        s.step(now, then, None, DT, column, contacts=run.contacts)
    run.contacts.rigid_contact_force.assign(force)
    s.step(now, then, None, DT, column, contacts=run.contacts)
    plain = FeatherstoneAnalyticControlSensitivity(
        run.model, parameter_count=1, point_body=2, kind="torque", solver=run.solver
    )
    plain.reset(now)
    with pytest.raises(ValueError, match="contacts: expected none without contact_projection"):
        plain.step(now, then, None, DT, column, contacts=run.contacts)
    # A ball that pushes the base from below.
    start[9:12] = [-0.2, -0.1, -0.048]
    rates = now.joint_qd.numpy()
    rates[10] = 1.0
    now.joint_q.assign(np.float32(start))
    now.joint_qd.assign(rates)
    novaphy.eval_fk(run.model, now.joint_q, now.joint_qd, now)
    run.pipeline.collide(now, run.contacts)
    run.solver.step(now, then, None, run.contacts, DT)
    s.reset(now)
    with pytest.raises(NotImplementedError, match="contacts: row .* DiffFeatherstoneSolver"):
        s.step(now, then, None, DT, column, contacts=run.contacts)
    penalty = SolverFeatherstone(run.model, contact="penalty")
    with pytest.raises(ValueError, match="contact_projection: expected a solver with contact"):
        FeatherstoneAnalyticControlSensitivity(
            run.model,
            parameter_count=1,
            point_body=2,
            kind="torque",
            contact_projection=True,
            solver=penalty,
        )


def test_limits_and_clamps_hold_what_they_hold() -> None:
    for dof, effect in (
        ({"limit_lower": -0.05, "limit_upper": 0.05, "limit_ke": 1e4, "limit_kd": 100.0}, False),
        ({"effort_limit": 5.0}, False),
        ({"velocity_limit": 0.1}, False),
        ({}, True),
    ):
        rollout = Rollout(slider(**dof), 0, (0.0, 0.0, 0.0))
        s = [rollout.sensitivity(1, exact=e) for e in (False, True)]
        # Outside of the limit all the time, where the drive has no effect.
        outside = "limit_ke" in dof
        start, n = ([0.08], 10) if outside else ([0.0], 60)
        rollout.run(n, start, target([1.0]), s, lambda t, x, s: [[1.0]])
        fd = differences(
            lambda x, r=rollout, q=start, n=n: r.run(n, q, target(x)), np.ones(1), 0.02
        )
        for one in s:
            np.testing.assert_allclose(result(one), fd, atol=2e-3 * max(1.0, np.abs(fd).max()))
        assert (abs(fd[0, 0]) > 1e-2) == effect


def test_what_is_not_covered_raises() -> None:
    for add, kind in (
        (lambda b, link: b.add_joint_ball(-1, link), "torque"),
        (lambda b, link: b.add_joint_free(link), "position"),
        (
            lambda b, link: b.add_joint_d6(
                -1, link, linear_axes=[novaphy.JointDofConfig(axis=(1.0, 0.0, 0.0))]
            ),
            "torque",
        ),
        (lambda b, link: b.add_joint_distance(-1, link), "torque"),
    ):
        b = novaphy.ModelBuilder()
        link = b.add_link(mass=1.0, inertia=np.eye(3), lock_inertia=True)
        b.add_articulation([add(b, link)])
        with pytest.raises(NotImplementedError, match="joint 0"):
            FeatherstoneAnalyticControlSensitivity(
                b.finalize(), parameter_count=1, point_body=0, kind=kind
            )
    model = slider().finalize()
    with pytest.raises(NotImplementedError, match="contact_projection: .*DiffFeatherstoneSolver"):
        FeatherstoneAnalyticControlSensitivity(
            model, parameter_count=1, point_body=0, contact_projection=True, exact=True
        )
    model.body_gravcomp.fill_(0.5)
    now, then = model.state(), model.state()
    s = FeatherstoneAnalyticControlSensitivity(model, parameter_count=1, point_body=0)
    s.reset(now)
    SolverFeatherstone(model).step(now, then, None, None, DT)
    with pytest.raises(NotImplementedError, match="body_gravcomp: .*DiffFeatherstoneSolver"):
        s.step(now, then, None, DT, np.ones((1, 1)))
    model.body_gravcomp.fill_(0.0)
    model.fluid_viscosity.fill_(0.5)
    with pytest.raises(NotImplementedError, match="fluid_viscosity: .*DiffFeatherstoneSolver"):
        s.step(now, then, None, DT, np.ones((1, 1)))


def test_bad_arguments_are_named() -> None:
    model = slider().finalize()
    made = FeatherstoneAnalyticControlSensitivity
    with pytest.raises(ValueError, match="kind: expected"):
        made(model, parameter_count=1, point_body=0, kind="velocity")
    with pytest.raises(ValueError, match="parameter_count: expected a number > 0, got 0"):
        made(model, parameter_count=0, point_body=0)
    with pytest.raises(IndexError, match="point_body: expected 0 <= point_body < 1, got 3"):
        made(model, parameter_count=1, point_body=3)
    with pytest.raises(IndexError, match="articulation: expected"):
        made(model, 2, parameter_count=1, point_body=0)
    solver = SolverFeatherstone(model)
    s = made(model, parameter_count=2, point_body=0, solver=solver)
    now, then, control = model.state(), model.state(), model.control()
    with pytest.raises(novaphy.Error, match="reset"):
        s.step(now, then, control, DT, np.zeros((1, 2)))
    s.reset(now)
    control.joint_target_q.assign(np.float32([0.5]))
    solver.step(now, then, control, None, DT)
    with pytest.raises(ValueError, match=r"dcontrol: expected \{1, 2\} .*, got \{2, 1\}"):
        s.step(now, then, control, DT, np.zeros((2, 1)))
    with pytest.raises(ValueError, match=r"dcontrol\[0, 1\]: expected a finite number, got nan"):
        s.step(now, then, control, DT, [[0.0, np.nan]])
    with pytest.raises(ValueError, match="dtarget_qd: dof 0 .* has no velocity drive"):
        s.step(now, then, control, DT, np.ones((1, 2)), np.ones((1, 2)))
    # Differs from the solver's step: another dt, another control, another damping.
    with pytest.raises(novaphy.Error, match="state_out: expected what SolverFeatherstone.step"):
        s.step(now, then, control, 2 * DT, np.ones((1, 2)))
    with pytest.raises(novaphy.Error, match="state_out"):
        s.step(now, then, None, DT, np.ones((1, 2)))
    with pytest.raises(novaphy.Error, match="state_in"):
        s.step(then, now, control, DT, np.ones((1, 2)))
    np.testing.assert_array_equal(s.dq, np.zeros((1, 2)))
    s.step(now, then, control, DT, np.ones((1, 2)))
    assert np.all(s.dq > 0.0)
    free = slider(target_ke=0.0, actuator_mode=novaphy.JointTargetMode.VELOCITY).finalize()
    s = made(free, parameter_count=1, point_body=0)
    solver = SolverFeatherstone(free)
    now, then = free.state(), free.state()
    s.reset(now)
    solver.step(now, then, None, None, DT)
    with pytest.raises(ValueError, match="dcontrol: dof 0 .* has no position drive"):
        s.step(now, then, None, DT, np.ones((1, 1)))
    s.step(now, then, None, DT, np.zeros((1, 1)), np.ones((1, 1)))
    assert s.dqd[0, 0] == pytest.approx(DT * 6.0 / (2.0 + DT * 6.5), rel=1e-4)
