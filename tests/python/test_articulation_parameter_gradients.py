"""Gradients of a step of articulations by gravity, materials of shapes and dry friction."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contact_gradients import CASES, ball, walker

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT = 0.01
# The change of each for a difference.
EPS = {
    "gravity": 0.05,
    "joint_friction": 0.1,
    "shape_material_mu": 5e-3,
    "shape_material_restitution": 1e-2,
    "shape_material_ke": 50.0,
    "shape_material_kd": 2.0,
}


def arm(friction: float = 0.0, child_friction: float = 0.0):
    """Two hinges with dry friction, the second on a slide, and nothing that touches."""
    builder = novaphy.ModelBuilder()
    links = [
        builder.add_link(mass=1.0, com=(0.1, 0.02, 0.0), inertia=np.diag([0.02, 0.03, 0.04]))
        for _ in range(3)
    ]
    at = {"child_xform": ((-0.3, 0.0, 0.0), UPRIGHT)}
    hinge = {"axis": (0.0, 1.0, 0.0), **at}
    joints = [
        builder.add_joint_revolute(-1, links[0], friction=friction, **hinge),
        builder.add_joint_prismatic(links[0], links[1], axis=(1.0, 0.0, 0.0), **at),
        builder.add_joint_revolute(links[1], links[2], friction=child_friction, **hinge),
    ]
    builder.add_articulation(joints)
    builder.joint_q[0:3] = [0.3, 0.05, -0.4]
    builder.joint_qd[0:3] = [0.4, 0.1, 0.002]
    return builder


def walker_with_friction(hip: float):
    """The walker, whose hips have dry friction."""
    builder = walker()
    builder.joint_friction[6:8] = [hip, hip]
    return builder


def value(model, solver, contacts, weights) -> float:
    """The weighted sum of the state after a step."""
    now, then = model.state(), model.state()
    solver.step(now, then, None, contacts, DT)
    q, qd = (x.numpy().astype(float) for x in (then.joint_q, then.joint_qd))
    return float(q @ weights[0] + qd @ weights[1])


def compare(model, names: list[str], options: dict) -> dict:
    """Compare the gradients by arrays of the model with differences; the gradients."""
    from novaphy import nova
    from novaphy.diff import state_joint_q_tensor, state_joint_qd_tensor

    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=5000, **options, contact_gradient="code"
    )
    state, after = model.state(requires_grad=True), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = None
    if model.shape_count > 0:
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
    rng = np.random.default_rng(5)
    weights = [rng.normal(size=n) for n in (model.joint_coord_count, model.joint_dof_count)]
    for name in names:
        getattr(model, name).requires_grad = True
        if getattr(model, name).grad is not None:
            getattr(model, name).grad.zero_()
    with nova.Tape() as tape:
        solver.step(state, after, None, contacts, DT)
        of_q, of_qd = (nova.tensor(w.astype(np.float32)) for w in weights)
        loss = nova.sum(state_joint_q_tensor(after) * of_q)
        loss = loss + nova.sum(state_joint_qd_tensor(after) * of_qd)
    tape.backward(loss)
    info = solver.gradient_info()
    gradients = {name: getattr(model, name).grad.numpy().ravel() for name in names}
    gradients |= {name: getattr(state, name).grad.numpy() for name in ("joint_q", "joint_qd")}
    for name in names:
        array = getattr(model, name)
        array.requires_grad = False
        before = array.numpy()
        expected = np.zeros(before.size)
        eps = EPS[name]
        rows = [k for k in range(before.size) if name != "joint_friction" or before.flat[k] > 0.0]
        for k in rows:
            low, high = before.copy(), before.copy()
            low.flat[k] -= eps if name == "gravity" else min(eps, before.flat[k])
            high.flat[k] += eps
            values = []
            for numbers in (low, high):
                array.assign(numbers)
                values.append(value(model, solver, contacts, weights))
            expected[k] = (values[1] - values[0]) / (high.flat[k] - low.flat[k])
        array.assign(before)
        scale = max(np.abs(expected).max(), 2e-5 / eps)
        np.testing.assert_allclose(
            gradients[name][rows], expected[rows], atol=3e-3 * scale, err_msg=f"{name} {info}"
        )
    return {**gradients, "info": info}


MATERIALS = ["gravity", "shape_material_mu"]


@pytest.mark.parametrize("case", list(CASES))
def test_by_gravity_and_materials_with_contacts(case: str) -> None:
    build, options, branches = CASES[case]
    springs = ["shape_material_ke", "shape_material_kd"] if case == "spring" else []
    bounces = ["shape_material_restitution"] if "bouncing" in case else []
    found = compare(build().finalize(), [*MATERIALS, *springs, *bounces], options)
    info = found["info"]
    assert (info["breaking"], info["sticking"], info["sliding"]) == branches, info
    assert info["label"] == "exact of the code", info
    moves = np.abs(found["shape_material_mu"]).max()
    assert (moves > 1e-3) == (branches[2] > 0)
    for name in springs:
        assert np.abs(found[name]).max() > 0.0
    for name in bounces:
        assert np.abs(found[name]).max() > 0.1


def test_the_label_falls_by_restitution_where_the_law_jumps() -> None:
    """Without restitution the gap closes; with any, the approach is turned at once."""
    from novaphy import nova

    model = ball((0.0, 0.0, -0.5, 0.0, 0.0, 0.0)).finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state = model.state(requires_grad=True)
    pipeline.collide(state, contacts)
    labels = []
    for asked in (False, True):
        model.shape_material_restitution.requires_grad = asked
        solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
        with nova.Tape():
            solver.step(state, model.state(), None, contacts, DT)
        labels.append(solver.gradient_info()["label"])
    assert labels == ["exact of the code", "surrogate"]


def test_by_friction_of_a_ball_that_slides_without_it() -> None:
    model = ball((1.0, 0.3, -0.4, 0.2, -0.3, 0.4)).finalize()
    model.shape_material_mu.assign(np.zeros(model.shape_count, np.float32))
    found = compare(model, ["shape_material_mu"], {})
    assert np.abs(found["shape_material_mu"]).max() > 1e-2


def test_by_gravity_without_contacts() -> None:
    found = compare(arm().finalize(), ["gravity"], {})
    assert found["info"]["contact_steps"] == 0
    assert np.abs(found["gravity"]).max() > 1e-3


@pytest.mark.parametrize(
    "friction, child",
    [(0.3, 0.0), (0.3, 5.0), (0.0, 5.0)],
    ids=["slides", "slides and sticks", "sticks"],
)
def test_by_dry_friction_of_joints(friction: float, child: float) -> None:
    found = compare(arm(friction, child).finalize(), ["joint_friction", "gravity"], {})
    info = found["info"]
    assert info["label"] == "exact of the code" and info["contact_steps"] == 1
    gradient = found["joint_friction"]
    assert (gradient[2] == 0.0) == (child > 0.0)  # stiction holds the dof
    assert abs(gradient[0]) > 1e-3


def test_by_dry_friction_that_is_not_there() -> None:
    """The derivative to the side of friction, of dofs that move."""
    model = arm(1e-5).finalize()
    expected = compare(model, ["joint_friction"], {})["joint_friction"]
    model.joint_friction.zero_()
    found = compare(model, ["joint_friction"], {})["joint_friction"]
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert np.abs(found).min() > 1e-4


@pytest.mark.parametrize("hip", [0.2, 200.0], ids=["slides", "sticks"])
def test_by_dry_friction_beside_contacts(hip: float) -> None:
    found = compare(walker_with_friction(hip).finalize(), ["joint_friction", *MATERIALS], {})
    assert hip > 1.0 or found["info"]["label"] == "exact of the code"
    assert (np.abs(found["joint_friction"][6:8]).max() > 1e-4) == (hip < 1.0)


@pytest.mark.parametrize("friction, child", [(0.3, 5.0), (0.3, 0.0)])
def test_states_pass_their_gradient_through_dry_friction(friction: float, child: float) -> None:
    model = arm(friction, child).finalize()
    found = compare(model, [], {})
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=5000, contact_gradient="code"
    )
    rng = np.random.default_rng(5)
    weights = [rng.normal(size=n) for n in (model.joint_coord_count, model.joint_dof_count)]
    for name, eps in (("joint_q", 2e-3), ("joint_qd", 1e-3)):
        start = getattr(model, name)
        before = start.numpy()
        expected = []
        for k in range(before.size):
            values = []
            for change in (-eps, eps):
                numbers = before.copy()
                numbers[k] += change
                start.assign(numbers)
                values.append(value(model, solver, None, weights))
            expected.append((values[1] - values[0]) / (2 * eps))
        start.assign(before)
        np.testing.assert_allclose(found[name], expected, atol=3e-3 * np.abs(expected).max())


def test_gravity_of_worlds_in_a_rollout_is_the_loop_of_steps() -> None:
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_q_tensor

    builder = novaphy.ModelBuilder()
    builder.replicate(arm(), 9)
    model = builder.finalize()
    model.gravity.requires_grad = True
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    steps = 11
    weight = nova.tensor(
        np.random.default_rng(1).normal(size=model.joint_coord_count).astype(np.float32)
    )
    states = [model.state() for _ in range(steps + 1)]
    with nova.Tape() as tape:
        for t in range(steps):
            solver.step(states[t], states[t + 1], None, None, DT)
        loss = nova.sum(state_joint_q_tensor(states[-1]) * weight)
    tape.backward(loss)
    expected = model.gravity.grad.numpy()
    assert np.abs(expected[:9]).min(axis=0).max() > 1e-3
    for checkpoint in (None, 4):
        model.gravity.grad.zero_()
        trajectory = Trajectory(model, steps, checkpoint=checkpoint)
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, DT)
            loss = nova.sum(state_joint_q_tensor(trajectory[steps]) * weight)
        tape.backward(loss)
        np.testing.assert_array_equal(model.gravity.grad.numpy(), expected)
