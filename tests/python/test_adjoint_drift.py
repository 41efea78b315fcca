"""h_drift of GradientInfo: the adjoint times the rates is kept in steps without events."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 1 / 400


def arm() -> novaphy.Model:
    """Two links with damped hinges in gravity."""
    builder = novaphy.ModelBuilder()
    inertia, parent, joints = np.diag([0.01, 0.02, 0.02]), -1, []
    for k in range(2):
        link = builder.add_link(mass=1.0 - 0.3 * k, inertia=inertia)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=(0, 1, 0),
                parent_xform=((0.25 * k, 0, 0), (0, 0, 0, 1)),
                child_xform=((-0.25, 0, 0), (0, 0, 0, 1)),
                damping=0.3,
            )
        )
        parent = link
    builder.add_articulation(joints)
    return builder.finalize(requires_grad=True)


def drift(torque: np.ndarray, *, running: bool = True) -> novaphy.solvers.GradientInfo:
    """With the torques {steps, 2} and a loss of all states, or of the last one."""
    from novaphy import diff, nova

    model, steps = arm(), len(torque)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="motion")
    path = diff.Trajectory(model, steps)
    path[0].joint_qd.assign([0.5, -1.0])
    controls = []
    for k in range(steps):
        same = k > 0 and np.array_equal(torque[k], torque[k - 1])
        controls.append(controls[-1] if same else model.control())
        controls[-1].joint_f.assign(torque[k].astype(np.float32))
    with nova.Tape() as tape:
        solver.rollout(path, controls, None, DT)
        read = range(1, steps + 1) if running else [steps]
        loss = nova.tensor([0.0])
        for k in read:
            q = diff.state_joint_q_tensor(path[k])
            loss = loss + nova.sum(q * q) * DT
        tape.backward(nova.sum(loss))
    info = solver.gradient_info()
    assert info.h_drift == tape.gradient_info().h_drift
    assert info.h_skipped == 0 and 0 <= info.h_step < steps - 1
    assert info.label == "exact of the motion"
    return info


def test_a_driven_damped_arm_keeps_it_under_any_control() -> None:
    """Also where the control jumps in every step, and with a loss of all states."""
    time = DT * np.arange(200)[:, None]
    smooth = np.concatenate([2 * np.sin(7 * time), np.cos(11 * time)], axis=1)
    noise = np.random.default_rng(0).normal(size=(200, 2))
    constant = np.ones((200, 2))
    found = [drift(x).h_drift for x in (constant, smooth, noise)]
    assert found[0] < 2e-4 and found[1] < 5e-4 and found[2] < 4e-3, found
    assert drift(smooth, running=False).h_drift < 5e-4


def falling(kind: str, mode: str = "motion") -> novaphy.solvers.GradientInfo:
    """A box that lands on a plane and rolls on, or a plank that tips over a ridge."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.4, restitution=0.3, density=500.0, gap=0.05)
    steps = 500 if kind == "box" else 400
    if kind == "box":
        body = builder.add_body(xform=((0.0, 0.0, 0.4), (0.2, 0.3, 0.1, 0.927)))
        builder.add_shape_box(body, hx=0.1, hy=0.07, hz=0.05, cfg=surface)
        builder.add_ground_plane(cfg=surface)
    else:
        body = builder.add_body(xform=((0.1, 0.0, 0.12), (0.0, 0.0, 0.0, 1.0)))
        builder.add_shape_box(body, hx=0.4, hy=0.05, hz=0.02, cfg=surface)
        ridge = np.float32([[x, y, z] for x in (-0.02, 0.02) for y in (-1, 1) for z in (-1, 0.1)])
        builder.add_shape_convex_hull(-1, vertices=ridge, cfg=surface)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )
    path = diff.Trajectory(model, steps)
    if kind == "box":
        path[0].joint_qd.assign([1.0, 0.3, 0.0, 2.0, 1.0, 3.0])
    novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1e-3, pipeline=novaphy.CollisionPipeline(model))
        tape.backward(nova.sum(diff.state_joint_q_tensor(path[steps])[:3]))
    return solver.gradient_info()


def test_it_is_kept_between_the_impacts_of_a_box() -> None:
    info = falling("box")
    assert len(info.event_list) > 0 and info.h_drift < 2e-3, (info.h_drift, info.h_step)


def test_a_normal_that_is_held_shows() -> None:
    """The edges of the ridge cross the sides of the plank: such points have no closed form."""
    info = falling("plank")
    assert info.label == "frozen" and info.h_drift > 8e-3


def test_without_a_backward_or_with_gradients_of_the_code_there_is_none() -> None:
    solver = novaphy.solvers.DiffFeatherstoneSolver(arm(), contact_gradient="motion")
    info = solver.gradient_info()
    assert info.h_drift is None and info.h_step is None and info.h_skipped == 0
    assert falling("box", "code").h_drift is None


def test_a_state_that_is_written_and_another_dt_are_left_out() -> None:
    from novaphy import diff, nova

    model = arm()
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="motion")
    path = diff.Trajectory(model, 30)
    with nova.Tape() as tape:
        solver.rollout(path, None, None, DT, stop=10)
        solver.rollout(path, None, None, DT / 2, start=10)
        tape.backward(nova.sum(diff.state_joint_q_tensor(path[30])))
    info = solver.gradient_info()
    assert info.h_skipped == 1 and info.h_drift < 5e-3
