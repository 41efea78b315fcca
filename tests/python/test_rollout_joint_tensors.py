"""joint_f, joint_target_q and joint_target_qd of a rollout as tensors {n} or {steps, n}."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers
from novaphy.testing import assert_same_bits

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")
DT, STEPS = 1 / 240, 70
FIELDS = ("joint_f", "joint_target_q", "joint_target_qd")
RANDOM = np.random.default_rng(5)


def arm() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    joints, previous = [], -1
    for _ in range(2):
        body = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.02, 0.02]))
        at = ((0.0 if previous < 0 else 0.25, 0, 0), (0, 0, 0, 1))
        joints.append(
            builder.add_joint_revolute(
                previous, body, axis=(0, 1, 0), parent_xform=at, target_ke=20.0, target_kd=1.0,
                child_xform=((-0.25, 0, 0), (0, 0, 0, 1)),
            )
        )  # fmt: skip
        previous = body
    builder.add_articulation(joints)
    builder.joint_q = [0.4, -0.6]
    return builder.finalize()


def values(*shape: int) -> np.ndarray:
    return RANDOM.normal(size=shape).astype(np.float32)


def last(trajectory) -> np.ndarray:
    return np.concatenate([trajectory[STEPS].joint_q.numpy(), trajectory[STEPS].joint_qd.numpy()])


@pytest.mark.parametrize("name", ["SolverFeatherstone", "DiffFeatherstoneSolver"])
def test_tensors_have_the_bits_of_a_control_for_every_step(name):
    model = arm()
    given = {field: values(STEPS, 2) for field in FIELDS}
    controls = []
    for t in range(STEPS):
        control = model.control()
        for field in FIELDS:
            getattr(control, field).assign(given[field][t])
        controls.append(control)
    by_list, by_tensor, by_array = (diff.Trajectory(model, STEPS) for _ in range(3))
    solver = getattr(solvers, name)(model)
    solver.rollout(by_list, controls, None, DT)
    solver.rollout(by_tensor, None, None, DT, **{f: nova.tensor(v) for f, v in given.items()})
    arrays = {f: novaphy.DeviceArray(v) for f, v in given.items()}
    solver.rollout(by_array, None, None, DT, **arrays)
    assert_same_bits(last(by_tensor), last(by_list))
    assert_same_bits(last(by_array), last(by_list))


def test_what_is_not_given_is_of_the_control_or_the_model():
    model = arm()
    model.joint_f.assign([0.3, -0.2])
    target = values(STEPS, 2)
    one = diff.Trajectory(model, STEPS)
    other = diff.Trajectory(model, STEPS)
    solver = solvers.SolverFeatherstone(model)
    for control in (None, model.control()):
        if control is not None:
            control.joint_f.assign([-1.0, 0.5])
        each = []
        for t in range(STEPS):
            each.append(model.control())
            if control is not None:
                each[-1].assign(control)
            each[-1].joint_target_q.assign(target[t])
        solver.rollout(one, control, None, DT, joint_target_q=nova.tensor(target))
        solver.rollout(other, each, None, DT)
        assert_same_bits(last(one), last(other))
    same = nova.tensor([0.1, 0.2])
    solver.rollout(one, None, None, DT, joint_f=same)
    solver.rollout(other, None, None, DT, joint_f=nova.tensor(np.tile(same.numpy(), (STEPS, 1))))
    assert_same_bits(last(one), last(other))


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("checkpoint", [None, 16])
def test_gradients_are_those_of_controls(field, checkpoint):
    model, data = arm(), values(STEPS, 2)

    def loss(trajectory):
        return nova.sum(diff.state_joint_q_tensor(trajectory[STEPS]) * nova.tensor([1.0, -2.0]))

    whole = nova.tensor(data, requires_grad=True)
    trajectory = diff.Trajectory(model, STEPS, checkpoint=checkpoint)
    solver = solvers.DiffFeatherstoneSolver(model)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT, **{field: whole})
        tape.backward(loss(trajectory))
    controls = [model.control(requires_grad=True) for _ in range(STEPS)]
    rows = []
    for t, control in enumerate(controls):
        getattr(control, field).assign(data[t])
        rows.append(getattr(diff, f"control_{field}_tensor")(control, requires_grad=True))
    with nova.Tape() as tape:
        solver.rollout(trajectory, controls, None, DT)
        tape.backward(loss(trajectory))
    expected = np.stack([row.grad.numpy() for row in rows])
    assert np.abs(expected[:-1]).max() > 0
    assert_same_bits(whole.grad, expected)
    with nova.Tape() as tape:  # one row for all steps: the sum
        one = nova.tensor(data[0], requires_grad=True)
        solver.rollout(trajectory, None, None, DT, **{field: one})
        tape.backward(loss(trajectory))
    repeated = nova.tensor(np.tile(data[0], (STEPS, 1)), requires_grad=True)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT, **{field: repeated})
        tape.backward(loss(trajectory))
    np.testing.assert_allclose(one.grad.numpy(), repeated.grad.numpy().sum(axis=0), rtol=1e-5)


def test_a_computed_tensor_passes_its_gradient_on():
    model, data = arm(), values(STEPS, 2)
    solver, trajectory = solvers.DiffFeatherstoneSolver(model), diff.Trajectory(model, STEPS)

    def loss(x):
        solver.rollout(trajectory, None, None, DT, joint_f=nova.tanh(x) * 2.0)
        return nova.sum(diff.state_joint_q_tensor(trajectory[STEPS]))

    result = nova.gradcheck(loss, [nova.tensor(data)], epsilon=2e-2, rtol=2e-2)
    assert result.ok, result


def test_joint_forces_reach_the_joints_of_bodies_too():
    model = arm()
    solver = solvers.DiffSemiImplicitSolver(model)
    given = nova.tensor(values(20, 2), requires_grad=True)
    trajectory = diff.Trajectory(model, 20)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1e-3, joint_f=given)
        tape.backward(nova.sum(diff.state_body_qd_tensor(trajectory[20])))
    assert (np.abs(given.grad.numpy()).max(axis=0) > 0).all()


def test_a_part_of_a_trajectory_takes_its_own_rows_and_recompute_runs_them_again():
    model, data = arm(), values(STEPS, 2)
    solver, whole = solvers.DiffFeatherstoneSolver(model), diff.Trajectory(model, STEPS)
    parts = diff.Trajectory(model, STEPS, checkpoint=10)
    solver.rollout(whole, None, None, DT, joint_f=nova.tensor(data))
    solver.rollout(parts, None, None, DT, joint_f=nova.tensor(data[:40]), stop=40)
    solver.rollout(parts, None, None, DT, joint_f=nova.tensor(data[40:]), start=40)
    assert_same_bits(last(parts), last(whole))
    assert_same_bits(parts.recompute(55).joint_q, whole[55].joint_q.numpy())


def test_a_capture_reads_the_tensor_of_its_launch():
    model = arm()
    solver, trajectory = solvers.DiffFeatherstoneSolver(model), diff.Trajectory(model, STEPS)
    eager = diff.Trajectory(model, STEPS)
    given = nova.tensor(values(STEPS, 2), requires_grad=True)
    with nova.ScopedCapture() as capture, nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT, joint_f=given)
        tape.backward(nova.sum(diff.state_joint_q_tensor(trajectory[STEPS])))
    for _ in range(2):
        given.assign(values(STEPS, 2))
        given.zero_grad()
        capture.graph.launch()
        found = given.grad.numpy()
        solver.rollout(eager, None, None, DT, joint_f=given.detach())
        assert_same_bits(last(trajectory), last(eager))
        again = nova.tensor(given.numpy(), requires_grad=True)
        with nova.Tape() as tape:
            solver.rollout(eager, None, None, DT, joint_f=again)
            tape.backward(nova.sum(diff.state_joint_q_tensor(eager[STEPS])))
        assert_same_bits(found, again.grad.numpy())


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        (
            {"joint_f": [1.0, 2.0]},
            TypeError,
            "joint_f: expected a Tensor or a DeviceArray, got list",
        ),
        ({"joint_f": "short"}, ValueError, r"expected float32 \{2\} or \{70, 2\}, got"),
        ({"joint_target_q": "wide"}, ValueError, r"rollout, joint_target_q: expected float32"),
        ({"joint_target_qd": "list"}, ValueError, "expected one Control or None beside it"),
    ],
)
def test_what_is_refused(options, error, match):
    model = arm()
    tensors = {"short": nova.zeros((STEPS - 1, 2)), "wide": nova.zeros(3), "list": nova.zeros(2)}
    control = [model.control()] if "list" in options.values() else None
    options = {k: tensors.get(v, v) if isinstance(v, str) else v for k, v in options.items()}
    with pytest.raises(error, match=match):
        solvers.SolverFeatherstone(model).rollout(
            diff.Trajectory(model, STEPS), control, None, DT, **options
        )
