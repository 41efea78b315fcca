"""Gradients of steps of articulations at and beyond limits and clamps, against differences."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 0.01
LIMITS = {"limit_lower": -0.3, "limit_upper": 0.3, "limit_ke": 200.0, "limit_kd": 4.0}
DRIVE = {"target_ke": 200.0, "target_kd": 2.0, "target_q": 1.0}
# Settings of both hinges, the start, options of the solver.
CASES = {
    "beyond": (LIMITS, (0.35, -0.4), (0.5, 0.1), {}),
    "leaving": (LIMITS, (0.32, -0.31), (-6.0, 8.0), {}),
    "equal": (LIMITS | {"limit_lower": 0.1, "limit_upper": 0.1}, (0.3, -0.3), (0.5, 0.1), {}),
    "without springs": (LIMITS | {"limit_ke": 0.0}, (0.4, -0.4), (0.5, 0.1), {}),
    "no effort": (DRIVE | {"effort_limit": 0.0}, (0.35, -0.2), (0.5, 0.1), {}),
    "no velocity": ({"velocity_limit": 0.0}, (0.35, -0.2), (0.5, 0.1), {}),
    "explicit": (LIMITS | DRIVE, (0.35, -0.2), (0.5, 0.1), {"implicit_drives": False}),
    "all": (
        LIMITS | DRIVE | {"effort_limit": 0.3, "velocity_limit": 0.45, "friction": 0.5},
        (0.35, -0.25),
        (0.3, 0.1),
        {"angular_damping": 0.3, "pgs_iterations": 2000},
    ),
}


def hinges(dof: dict) -> novaphy.Model:
    """Two links on hinges about +Y."""
    builder = novaphy.ModelBuilder()
    inertia = np.diag([0.02, 0.03, 0.04])
    links = [builder.add_link(mass=1.0, com=(0.1, 0.02, 0.0), inertia=inertia) for _ in range(2)]
    at = {"child_xform": ((-0.3, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}
    joints = [
        builder.add_joint_revolute(parent, link, axis=(0.0, 1.0, 0.0), **at, **dof)
        for parent, link in zip((-1, links[0]), links, strict=True)
    ]
    builder.add_articulation(joints)
    return builder.finalize()


def start(model: novaphy.Model, x: np.ndarray, requires_grad: bool = False) -> novaphy.State:
    """The state of (q, qd)."""
    state = model.state(requires_grad=requires_grad)
    state.joint_q.assign(x[:2].astype(np.float32))
    state.joint_qd.assign(x[2:].astype(np.float32))
    return state


def gradient_and_value(dof: dict, options: dict, x: np.ndarray, steps: int):
    """The gradient by (q, qd) of a weighted sum of the last state, and that sum as a function."""
    from novaphy import nova
    from novaphy.diff import state_joint_q_tensor, state_joint_qd_tensor

    model = hinges(dof)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, **options, contact_gradient="code")
    weights = np.array([0.7, -1.1, 0.4, 0.9], np.float32)

    def value(at: np.ndarray) -> float:
        states = [start(model, at)] + [model.state() for _ in range(steps)]
        for now, then in zip(states, states[1:], strict=False):
            solver.step(now, then, None, None, DT)
        last = np.concatenate([states[-1].joint_q.numpy(), states[-1].joint_qd.numpy()])
        return float(last.astype(float) @ weights)

    states = [start(model, x, True)] + [model.state() for _ in range(steps)]
    with nova.Tape() as tape:
        for now, then in zip(states, states[1:], strict=False):
            solver.step(now, then, None, None, DT)
        loss = nova.dot(state_joint_q_tensor(states[-1]), nova.tensor(weights[:2]))
        loss = loss + nova.dot(state_joint_qd_tensor(states[-1]), nova.tensor(weights[2:]))
    tape.backward(loss)
    both = [states[0].joint_q.grad.numpy(), states[0].joint_qd.grad.numpy()]
    return np.concatenate(both), value


@pytest.mark.parametrize("name", CASES)
def test_the_gradient_of_a_branch_is_that_of_differences(name: str) -> None:
    dof, q, qd, options = CASES[name]
    x = np.array([*q, *qd])
    gradient, value = gradient_and_value(dof, options, x, 3)
    eps = 2e-3
    fd = [(value(x + eps * e) - value(x - eps * e)) / (2.0 * eps) for e in np.eye(4)]
    np.testing.assert_allclose(gradient, fd, rtol=1e-2, atol=3e-3)


def test_exactly_at_a_limit_the_gradient_is_that_of_inside() -> None:
    x = np.array([0.3, -0.3, 0.0, 0.0])
    gradient, value = gradient_and_value(LIMITS, {}, x, 1)
    eps = np.array([-2e-4, 2e-4])
    fd = [(value(x + h * e) - value(x)) / h for h, e in zip(eps, np.eye(4)[:2], strict=True)]
    np.testing.assert_allclose(gradient[:2], fd, rtol=1e-2, atol=5e-3)
