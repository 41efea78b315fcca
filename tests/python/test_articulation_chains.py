"""Long chains: accelerations against a recursion in double precision, and swings."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

GRAVITY = 9.81
LENGTHS = (10, 11, 30, 60, 100, 200)
# Hinges with drives at their effort limits, some of which move at their velocity limits.
TIGHT = {
    "target_ke": 100.0,
    "target_kd": 1.0,
    "target_q": 0.3,
    "effort_limit": 20.0,
    "velocity_limit": 1.0,
}


class Chain:
    """Hinges in a row: `straight` equal rods, `bent` ones, or links at random."""

    def __init__(self, kind: str, count: int) -> None:
        rng = np.random.default_rng(count)
        if kind == "random":
            self.offset = rng.normal(size=(count, 3)) * 0.05
            self.com = rng.normal(size=(count, 3)) * 0.02
            self.mass = rng.uniform(0.02, 0.5, count)
            half = rng.normal(size=(count, 3, 3)) * 0.01
            self.inertia = half @ half.transpose(0, 2, 1) * self.mass[:, None, None]
            self.inertia += np.trace(self.inertia, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            self.axis = rng.normal(size=(count, 3))
            self.turn = rng.normal(size=(count, 4))
            self.q, self.qd = rng.uniform(-1, 1, count), rng.normal(size=count)
        else:
            length, mass = 0.05, 0.05
            self.offset = np.tile([length, 0.0, 0.0], (count, 1))
            self.com = self.offset / 2
            self.mass = np.full(count, mass)
            rod = np.diag([1e-5, mass * length**2 / 12, mass * length**2 / 12])
            self.inertia = np.tile(rod, (count, 1, 1))
            self.axis = np.tile([0.0, 1.0, 0.0], (count, 1))
            self.turn = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
            bent = kind == "bent"
            self.q = rng.normal(size=count) * (0.3 if bent else 0.0)
            self.qd = rng.normal(size=count) * (3.0 if bent else 0.0)
            self.q[0] = 0.7
        self.axis /= np.linalg.norm(self.axis, axis=1)[:, None]
        self.turn /= np.linalg.norm(self.turn, axis=1)[:, None]

    def model(self) -> novaphy.Model:
        one = novaphy.ModelBuilder(gravity=-GRAVITY)
        joints, parent = [], -1
        for k in range(len(self.q)):
            link = one.add_link(mass=self.mass[k], com=self.com[k], inertia=self.inertia[k])
            start = self.offset[k] if k else np.zeros(3)
            joints.append(
                one.add_joint_revolute(
                    parent, link, axis=self.axis[k], parent_xform=(start, self.turn[k])
                )
            )
            parent = link
        one.add_articulation(joints)
        one.joint_q, one.joint_qd = self.q.tolist(), self.qd.tolist()
        return one.finalize()


def snake(depth: float = 0.002, mu: float = 0.5, **hinge: float):
    """Twelve hinges in a row, which have no mass matrix, with three round feet on the ground."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=mu, density=0.0)
    builder.add_ground_plane(cfg=surface)
    link = {"mass": 1.0, "inertia": np.diag([0.02, 0.03, 0.04]), "com": (0.06, 0.01, 0.02)}
    parent = builder.add_link(xform=((0.0, 0.0, 0.1 - depth), (0.0, 0.0, 0.0, 1.0)), **link)
    joints = [builder.add_joint_free(parent)]
    for k in range(12):
        if k % 4 == 0:
            foot = ((0.0, 0.05 * (-1) ** (k // 4), -0.05), (0.0, 0.0, 0.0, 1.0))
            builder.add_shape_sphere(parent, xform=foot, radius=0.05, cfg=surface)
        child = builder.add_link(**link)
        axis, place = (
            ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))[k % 2],
            ((0.12, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        )
        joints.append(
            builder.add_joint_revolute(parent, child, axis=axis, parent_xform=place, **hinge)
        )
        parent = child
    builder.add_articulation(joints)
    builder.joint_qd[0:6] = [0.3, 0.1, -0.2, 0.1, 0.2, 0.1]
    builder.joint_qd[6:18] = [0.2 * (-1) ** (k // 2) * (1 + k % 3) for k in range(12)]
    return builder


def cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.cross(v, np.eye(3)).T


def rotation(quaternion: np.ndarray) -> np.ndarray:
    v, w = cross_matrix(quaternion[:3]), quaternion[3]
    return np.eye(3) + 2 * w * v + 2 * v @ v


def accelerations(
    model: novaphy.Model, tau: np.ndarray, q: np.ndarray, qd: np.ndarray
) -> np.ndarray:
    """Of a chain of hinges in float64, as Featherstone (2008), table 7.1: in the links' axes."""
    count = model.joint_count
    frames = model.joint_X_p.numpy().astype(float)
    axis, com = model.joint_axis.numpy().astype(float), model.body_com.numpy().astype(float)
    mass, inertia = model.body_mass.numpy().astype(float), model.body_inertia.numpy().astype(float)
    moves, axes, articulated, bias, gains = [], [], [], [], []
    velocity, apparent = [np.zeros(6)], []
    for k in range(count):
        hinge = rotation(np.append(axis[k] * np.sin(q[k] / 2), np.cos(q[k] / 2)))
        back = (rotation(frames[k, 3:] / np.linalg.norm(frames[k, 3:])) @ hinge).T
        shift = cross_matrix(frames[k, :3])
        # Motions are (v, w) about the joint: v moves along by w x offset.
        move = np.block([[back, -back @ shift], [np.zeros((3, 3)), back]])
        s = np.append(np.zeros(3), axis[k])
        c = cross_matrix(com[k])
        y = np.block(
            [[mass[k] * np.eye(3), -mass[k] * c], [mass[k] * c, inertia[k] - mass[k] * c @ c]]
        )
        v = move @ velocity[-1] + s * qd[k]
        turning = np.block(
            [
                [cross_matrix(v[3:]), cross_matrix(v[:3])],
                [np.zeros((3, 3)), cross_matrix(v[3:])],
            ]
        )
        velocity.append(v)
        apparent.append(turning @ s * qd[k])
        moves.append(move)
        axes.append(s)
        articulated.append(y)
        bias.append(-turning.T @ y @ v)
    for k in reversed(range(count)):
        force = articulated[k] @ axes[k]
        pivot = axes[k] @ force
        left = tau[k] - axes[k] @ bias[k]
        gains.append((force, pivot, left))
        if k == 0:
            break
        y = articulated[k] - np.outer(force, force) / pivot
        f = bias[k] + y @ apparent[k] + force * left / pivot
        articulated[k - 1] = articulated[k - 1] + moves[k].T @ y @ moves[k]
        bias[k - 1] = bias[k - 1] + moves[k].T @ f
    a, qdd = np.array([0.0, 0.0, GRAVITY, 0.0, 0.0, 0.0]), []
    for k, (force, pivot, left) in enumerate(reversed(gains)):
        a = moves[k] @ a + apparent[k]
        qdd.append((left - force @ a) / pivot)
        a = a + axes[k] * qdd[-1]
    return np.array(qdd)


def start(model: novaphy.Model) -> tuple[np.ndarray, np.ndarray]:
    return model.joint_q.numpy().astype(float), model.joint_qd.numpy().astype(float)


@pytest.mark.parametrize("count", LENGTHS)
@pytest.mark.parametrize("kind", ["straight", "bent", "random"])
def test_accelerations_are_those_of_a_recursion_in_double_precision(kind: str, count: int) -> None:
    model = Chain(kind, count).model()
    tau = np.random.default_rng(1).normal(size=count).astype(np.float32) * 1e-2
    expected = accelerations(model, tau.astype(float), *start(model))
    state = model.state()
    found = np.ravel(novaphy.eval_forward_dynamics(model, state, tau))
    assert np.abs(found - expected).max() <= 2e-6 * np.abs(expected).max()
    # A step without damping moves by the same.
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    control = model.control()
    control.joint_f.assign(tau)
    after = model.state()
    solver.step(state, after, control, None, 1.0)
    found = after.joint_qd.numpy() - state.joint_qd.numpy()
    assert np.abs(found - expected).max() <= 4e-6 * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["straight", "bent", "random"])
def test_derivatives_are_differences_of_the_recursion(kind: str) -> None:
    count = 60
    model = Chain(kind, count).model()
    q, qd = start(model)
    tau = np.zeros(count)
    columns = novaphy.eval_forward_dynamics_derivatives(
        model, model.state(), tau.astype(np.float32)
    )

    def difference(at: int, k: int, h: float) -> np.ndarray:
        ends = []
        for sign in (1, -1):
            inputs = [tau.copy(), q.copy(), qd.copy()]
            inputs[at][k] += sign * h
            ends.append(accelerations(model, *inputs))
        return (ends[0] - ends[1]) / (2 * h)

    for found, at, tolerance in zip(columns, (1, 2, 0), (2e-3, 5e-3, 1e-5), strict=True):
        found = np.asarray(found)[0]
        for k in (0, count - 1):
            scale = np.abs(found).max() + 1e-3
            assert np.abs(found[:, k] - difference(at, k, 1e-5)).max() <= tolerance * scale


@pytest.mark.parametrize(("count", "dt"), [(10, 1e-3), (60, 2e-3), (200, 2e-3)])
def test_a_chain_swings(count: int, dt: float) -> None:
    """For 10 s. The energy that it falls with stays, but for the error of the scheme."""
    model = Chain("straight", count).model()
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    state, after = model.state(), model.state()
    weight = model.body_mass.numpy().sum() * GRAVITY
    rest = -weight * 0.05 * count / 2
    start = np.asarray(novaphy.eval_energy(model, state)).sum() - rest
    for step in range(1, round(10 / dt) + 1):
        solver.step(state, after, None, None, dt)
        state, after = after, state
        if step % 500 == 0:
            energy = np.asarray(novaphy.eval_energy(model, state)).sum() - rest
            assert abs(energy / start - 1) < 0.25
    assert np.abs(state.joint_q.numpy()).max() > 0.1


def test_a_mass_matrix_that_joints_need_names_its_condition() -> None:
    count = 80
    chain = Chain("straight", count)
    b = novaphy.ModelBuilder()
    joints, parent = [], -1
    for k in range(count + 1):
        link = b.add_link(mass=chain.mass[0], com=chain.com[0], inertia=chain.inertia[0])
        frame = (chain.offset[0] if k else np.zeros(3), (0.0, 0.0, 0.0, 1.0))
        on = 0 if k == count else parent
        joints.append(b.add_joint_revolute(on, link, axis=(0.0, 1.0, 0.0), parent_xform=frame))
        parent = link
    b.add_articulation(joints)
    b.add_constraint_mimic(joints[-1], joints[0])
    model = b.finalize()
    state = model.state()
    with pytest.raises(novaphy.Error, match=r"whose condition is \d\.\de\+\d\d"):
        novaphy.eval_forward_dynamics(model, state, np.zeros(count + 1, np.float32))
    solver = novaphy.solvers.SolverFeatherstone(model)
    with pytest.raises(novaphy.Error, match=r"whose condition is .*float32 holds 1e7"):
        solver.step(state, model.state(), None, None, 1e-3)


@pytest.mark.parametrize("exact", [False, True])
def test_the_sensitivity_of_a_chain_is_that_of_its_steps(exact: bool) -> None:
    """Some of its hinges come to their velocity limits on the way."""
    model = snake(velocity_limit=0.4).finalize()
    along = np.linspace(0.2, 1.0, model.joint_dof_count).astype(np.float32)
    solver = novaphy.solvers.SolverFeatherstone(model)

    def walk(force: float, sensitivity: object = None) -> np.ndarray:
        control, now, after = model.control(), model.state(), model.state()
        control.joint_f.assign(force * along)
        if sensitivity is not None:
            sensitivity.reset(now)
        for _ in range(6):
            solver.step(now, after, control, None, 2e-3)
            if sensitivity is not None:
                sensitivity.step(now, after, control, 2e-3, along[:, None])
            now, after = after, now
        return now.joint_qd.numpy().astype(float)

    found = novaphy.solvers.FeatherstoneAnalyticControlSensitivity(
        model, parameter_count=1, point_body=0, kind="torque", exact=exact, solver=solver
    )
    held = np.abs(np.abs(walk(1.0, found)) - 0.4) < 1e-2
    assert 3 <= held.sum() <= 9
    expected = (walk(1.01) - walk(0.99)) / 0.02
    np.testing.assert_allclose(found.dqd[:, 0], expected, atol=5e-3 * np.abs(expected).max())
