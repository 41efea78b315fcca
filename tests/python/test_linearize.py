"""diff.linearize: the derivative of a step against closed forms and against differences."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers

diff = pytest.importorskip("novaphy.diff")
DT = 0.01


def slider(worlds: int = 1, mass: float = 2.0) -> novaphy.Model:
    one = novaphy.ModelBuilder(gravity=0.0)
    body = one.add_link(mass=mass, inertia=np.eye(3))
    one.add_articulation([one.add_joint_prismatic(-1, body, axis=(1, 0, 0))])
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.replicate(one, worlds)
    return builder.finalize()


def walker() -> novaphy.Model:
    """A free body, a ball, a hinge with a drive: every kind of joint that has tangents."""
    builder = novaphy.ModelBuilder()
    previous, joints = -1, []
    for kind in ("free", "ball", "revolute"):
        body = builder.add_link(mass=1.5, inertia=np.diag([0.2, 0.3, 0.4]), com=(0.05, -0.02, 0.1))
        add = getattr(builder, f"add_joint_{kind}")
        options = {} if previous < 0 else {"parent_xform": ((0, 0, 0.4), (0, 0, 0, 1))}
        if kind == "revolute":
            options |= {"axis": (0, 1, 0), "target_ke": 30.0, "target_kd": 2.0}
        joints.append(
            add(child=body, **options) if kind == "free" else add(previous, body, **options)
        )
        previous = body
    builder.add_articulation(joints)
    return builder.finalize()


def turned(q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """exp(r) q, in float64."""
    angle = np.linalg.norm(r)
    v, w = 0.5 * np.sinc(angle / (2 * np.pi)) * r, np.cos(angle / 2)
    return np.array([*(w * q[:3] + q[3] * v + np.cross(v, q[:3])), w * q[3] - v @ q[:3]])


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The small r with b = exp(r) a."""
    d = np.array(
        [*(a[3] * b[:3] - b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] + a[:3] @ b[:3]]
    )
    return 2 * d[:3] * np.sign(d[3])


def moved(x: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """Coordinates of the walker (p, q, ball, hinge) moved by ten tangents."""
    return np.array(
        [*(x[:3] + dx[:3]), *turned(x[3:7], dx[3:6]), *turned(x[7:11], dx[6:9]), x[11] + dx[9]]
    )


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array(
        [*(b[:3] - a[:3]), *between(a[3:7], b[3:7]), *between(a[7:11], b[7:11]), b[11] - a[11]]
    )


def test_a_slider_is_a_double_integrator_in_every_world():
    model = slider(worlds=3, mass=2.0)
    solver = solvers.DiffFeatherstoneSolver(model)
    a, b = diff.linearize(solver, model.state(), None, DT)
    assert a.shape == (3, 2, 2) and b.shape == (3, 2, 1) and a.dtype == b.dtype == np.float32
    np.testing.assert_allclose(a, [[[1, DT], [0, 1]]] * 3, rtol=1e-6)
    np.testing.assert_allclose(b, [[[DT * DT / 2.0], [DT / 2.0]]] * 3, rtol=1e-5)


@pytest.mark.parametrize("inputs", ["joint_f", "joint_target_q", "joint_target_qd"])
def test_it_agrees_with_differences_of_the_step(inputs):
    model, random = walker(), np.random.default_rng(3)
    solver = solvers.DiffFeatherstoneSolver(model, angular_damping=0.0)
    state, control = model.state(), model.control()
    q = random.normal(size=12)
    for turn in (slice(3, 7), slice(7, 11)):
        q[turn] /= np.linalg.norm(q[turn])
    state.joint_q.assign(q)
    state.joint_qd.assign(random.normal(size=10))
    control.joint_f.assign(random.normal(size=10))
    before = state.joint_q.numpy()
    a, b = diff.linearize(solver, state, control, DT, inputs=inputs)
    np.testing.assert_array_equal(state.joint_q.numpy(), before)
    u0 = getattr(control, inputs).numpy()
    assert a.shape == (1, 20, 20) and b.shape == (1, 20, u0.size)

    def step(dx, du):
        now, after, changed = state.clone(), model.state(), control.clone()
        now.joint_q.assign(moved(before, dx[:10]))
        now.joint_qd.assign(state.joint_qd.numpy() + dx[10:])
        getattr(changed, inputs).assign(u0 + du)
        solver.step(now, after, changed, None, DT)
        return after.joint_q.numpy().astype(float), after.joint_qd.numpy().astype(float)

    size, columns = 2e-2, []
    for k in range(20 + u0.size):
        d = np.zeros(20 + u0.size)
        d[k] = size
        (q0, v0), (q1, v1) = step(-d[:20], -d[20:]), step(d[:20], d[20:])
        columns.append(np.concatenate([difference(q0, q1), v1 - v0]) / (2 * size))
    differences = np.array(columns).T
    both = np.concatenate([a, b], axis=2)[0]
    rows = np.abs(differences).max(axis=1, keepdims=True)
    assert np.abs(both - differences).max() < 2e-3 * np.abs(differences).max()
    assert (np.abs(both - differences) < 1e-2 * np.maximum(rows, 1e-2)).all()


def test_what_is_refused():
    model = slider()
    with pytest.raises(
        TypeError, match="expected a DiffFeatherstoneSolver, got SolverFeatherstone"
    ):
        diff.linearize(solvers.SolverFeatherstone(model), model.state(), None, DT)
    with pytest.raises(ValueError, match="inputs: expected one of joint_f, .* got 'joint_act'"):
        diff.linearize(
            solvers.DiffFeatherstoneSolver(model), model.state(), None, DT, inputs="joint_act"
        )
    builder = novaphy.ModelBuilder()
    for count in (1, 2):
        world = novaphy.ModelBuilder()
        joints, previous = [], -1
        for _ in range(count):
            body = world.add_link(mass=1.0, inertia=np.eye(3))
            joints.append(world.add_joint_revolute(previous, body, axis=(0, 1, 0)))
            previous = body
        world.add_articulation(joints)
        builder.add_world(world)
    unlike = builder.finalize()
    with pytest.raises(ValueError, match="worlds of the same joints"):
        diff.linearize(solvers.DiffFeatherstoneSolver(unlike), unlike.state(), None, DT)
