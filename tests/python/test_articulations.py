"""Articulations from Python: solvers, gradients, the recorder of the planar arm, functions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import novaphy

GOLDEN = Path(__file__).parents[1] / "golden"
STEPS, DT = 576, 1.0 / 960.0


def arm(**dof: float) -> novaphy.ModelBuilder:
    """Build the two-link arm of newton_2r_strict.npz, with its start."""
    b = novaphy.ModelBuilder()
    inertia = np.diag([0.0025, 1.0 / 48.0, 1.0 / 48.0])
    links = [b.add_link(mass=1.0, inertia=inertia, lock_inertia=True) for _ in range(2)]
    identity = (0.0, 0.0, 0.0, 1.0)
    joints = []
    for i, link in enumerate(links):
        joints.append(
            b.add_joint_revolute(
                i - 1 if i == 0 else links[0],
                link,
                axis=(0.0, 1.0, 0.0),
                parent_xform=(0.25 if i else 0.0, 0.0, 0.0, *identity),
                child_xform=(-0.25, 0.0, 0.0, *identity),
                **dof,
            )
        )
    b.add_articulation(joints)
    b.joint_q = [0.4, -0.6]
    b.joint_qd = [1.0, -0.5]
    return b


diff = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


def tip_loss(model: novaphy.Model, damping: float, checkpoint: int | None = None) -> tuple:
    """Roll the arm out, and pull the loss of its tip back to the start."""
    from novaphy import nova
    from novaphy.diff import Trajectory, planar_2r_tip_loss, state_joint_q_tensor

    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=damping, contact_gradient="code"
    )
    trajectory = Trajectory(model, STEPS, checkpoint=checkpoint)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT)
        last = state_joint_q_tensor(trajectory[STEPS])
        loss = planar_2r_tip_loss(model, last, 0.35, -0.75)
    tape.backward(loss)
    return loss.item(), trajectory[0].joint_qd.grad.numpy(), trajectory[0].joint_q.grad.numpy()


@diff
@pytest.mark.parametrize(
    ("damping", "loss", "gradient"),
    [(0.0, 1.09098, (0.32981, 0.11073)), (0.05, 1.06486, (0.31791, 0.10408))],
)
def test_the_rollout_has_the_exact_gradient(
    damping: float, loss: float, gradient: tuple[float, float]
) -> None:
    model = arm().finalize(requires_grad=True)
    value, qd, q = tip_loss(model, damping)
    assert value == pytest.approx(loss, abs=1e-4)
    np.testing.assert_allclose(qd, gradient, atol=1e-4)
    if damping == 0.0:  # Newton's solver, a new object per step
        reference = np.load(GOLDEN / "newton_2r_strict.npz")
        np.testing.assert_allclose(q, reference["free_adj_q"][0], atol=1e-4)
    kept = tip_loss(model, damping, checkpoint=24)
    assert kept[0] == value
    np.testing.assert_array_equal(kept[1], qd)


@diff
def test_losses_of_any_state_pull_through_the_steps_of_one_operation() -> None:
    from novaphy import nova
    from novaphy.diff import (
        Trajectory,
        model_joint_damping_tensor,
        state_body_q_tensor,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    def run(checkpoint: int | None) -> tuple[np.ndarray, ...]:
        model = arm(damping=0.3, target_ke=4.0, target_kd=0.2).finalize(requires_grad=True)
        damping = model_joint_damping_tensor(model, requires_grad=True)
        solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
        trajectory = Trajectory(model, 27, checkpoint=checkpoint)
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, 0.01)
            terms = [
                state_joint_q_tensor(trajectory[9]),
                state_joint_qd_tensor(trajectory[18]),
                state_body_q_tensor(trajectory[27]),
            ]
            loss = nova.sum(terms[0]) + nova.sum(terms[1]) + nova.sum(terms[2] * terms[2])
        if checkpoint is None:  # tangents are those of the gradient
            start = state_joint_q_tensor(trajectory[0])
            direction = nova.tensor(np.array([0.3, -0.7], np.float32))
            (along,) = tape.jvp([loss], [start], [direction])
        tape.backward(loss)
        gradients = (trajectory[0].joint_q.grad, trajectory[0].joint_qd.grad, damping.grad)
        if checkpoint is None:
            expected = float(gradients[0].numpy() @ np.array([0.3, -0.7]))
            assert along.item() == pytest.approx(expected, rel=1e-5)
        return tuple(g.numpy().copy() for g in gradients)

    for together, single in zip(run(None), run(9), strict=True):
        assert np.abs(single).min() > 1e-3
        np.testing.assert_allclose(together, single, rtol=1e-5)


@diff
def test_step_by_step_is_the_rollout() -> None:
    from novaphy import nova
    from novaphy.diff import Trajectory, planar_2r_tip_loss, state_joint_q_tensor

    model = arm().finalize(requires_grad=True)
    forward = novaphy.solvers.SolverFeatherstone(model)
    a, b = model.state(), model.state()
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    trajectory = Trajectory(model, 50)
    solver.rollout(trajectory, None, None, DT)
    states = [model.state() for _ in range(51)]
    with nova.Tape() as tape:
        for t in range(50):
            solver.step(states[t], states[t + 1], None, None, DT)
        loss = planar_2r_tip_loss(model, state_joint_q_tensor(states[50]), 0.35, -0.75)
    tape.backward(loss)
    for _ in range(50):
        forward.step(a, b, None, None, DT)
        a, b = b, a
    for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
        expected = getattr(a, name).numpy()
        np.testing.assert_array_equal(getattr(states[50], name).numpy(), expected)
        np.testing.assert_array_equal(getattr(trajectory[50], name).numpy(), expected)
    assert np.all(states[0].joint_qd.grad.numpy() != 0.0)


def recorded(model: novaphy.Model, damping: float, steps: int = STEPS, **options: object) -> tuple:
    """Run the regular solver, and record its steps in closed form."""
    from novaphy import nova
    from novaphy.diff import (
        planar_2r_tip_loss,
        record_planar_2r_featherstone_step,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=damping)
    told = options.get("told", damping)
    states = [model.state() for _ in range(steps + 1)]
    with nova.Tape() as tape:
        for old, new in zip(states[:-1], states[1:], strict=True):
            solver.step(old, new, None, None, DT)
            if options.get("record", True):
                record_planar_2r_featherstone_step(
                    model,
                    old,
                    None,
                    state_joint_q_tensor(old),
                    state_joint_qd_tensor(old),
                    state_joint_q_tensor(new),
                    state_joint_qd_tensor(new),
                    DT,
                    told,
                )
        loss = planar_2r_tip_loss(model, state_joint_q_tensor(states[-1]), 0.35, -0.75)
    tape.backward(loss)
    return loss.item(), states[0].joint_qd.grad.numpy(), states[0].joint_q.grad.numpy()


@diff
@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize("limits", [{}, {"limit_lower": -0.8, "limit_upper": 0.7}])
def test_the_recorder_has_the_gradient_of_the_general_step(damping: float, limits: dict) -> None:
    model = arm(**limits, limit_ke=1000.0, limit_kd=5.0).finalize(requires_grad=True)
    if limits:  # until a limit lets go, which the closed form does not know
        steps = 40
        model.joint_q.assign([0.69, -0.79])
    else:
        steps = STEPS
    closed = recorded(model, damping, steps)
    if not limits:
        general = tip_loss(model, damping)
        assert closed[0] == pytest.approx(general[0], abs=1e-5)
        np.testing.assert_allclose(closed[1], general[1], atol=1e-5)
        np.testing.assert_allclose(closed[2], general[2], atol=1e-5)


@diff
@pytest.mark.parametrize(
    "name", ["gravity", "body_mass", "body_com", "joint_armature", "joint_X_p", "joint_f"]
)
def test_the_recorder_refuses_gradients_that_it_has_not(name: str) -> None:
    model = arm().finalize()
    getattr(model, name).requires_grad = True
    with pytest.raises(NotImplementedError, match=f"{name}: expected requires_grad False"):
        recorded(model, 0.0, steps=2)


@diff
def test_a_forgotten_recorder_raises_and_names_both_ways_on() -> None:
    model = arm().finalize(requires_grad=True)
    with pytest.raises(novaphy.Error, match="DiffFeatherstoneSolver, or record_planar_2r"):
        recorded(model, 0.0, steps=2, record=False)


def set_to(name: str, value: float, row: int = 0) -> object:
    """Make an edit of one number of the model."""

    def edit(model: novaphy.Model) -> None:
        array = getattr(model, name)
        values = array.numpy()
        values.reshape(-1)[row] = value
        array.assign(values)

    return edit


@diff
@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (set_to("joint_damping", 0.1), "joint_damping 0"),
        (set_to("joint_target_ke", 0.2), "joint_target_ke 0"),
        (set_to("joint_target_kd", 1.0), "joint_target_kd 0"),
        (set_to("joint_f", 1e-3), "joint_f 0"),
        (set_to("joint_velocity_limit", 0.5), "qd_out|q_out"),
        (set_to("body_com", 0.01), "centers of mass"),
        (set_to("gravity", 0.5), "gravity along -Z"),
        (set_to("joint_X_c", 0.1, 1), "on the x axes of their links"),
    ],
)
def test_the_recorder_refuses_what_it_does_not_model(edit: object, message: str) -> None:
    model = arm().finalize(requires_grad=True)
    edit(model)  # type: ignore[operator]
    with pytest.raises(novaphy.Error, match=message):
        recorded(model, 0.05, steps=2)


def set_row(name: str, row: int, values: list) -> object:
    """Make an edit of one row of the model."""

    def edit(model: novaphy.Model) -> None:
        array = getattr(model, name)
        now = array.numpy()
        now[row] = values
        array.assign(now)

    return edit


@diff
@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (set_to("joint_friction", 0.1, 1), "joint_friction 0, got 0.1"),
        (set_row("joint_axis", 1, [1.0, 0.0, 0.0]), r"axes of exactly \+Y"),
        (set_row("joint_X_p", 1, [0.25, 0, 0, 0, 1, 0, 0]), "joint frames without rotation"),
        (set_to("joint_X_p", 0.1, 8), "the second joint on the first link's x axis"),
    ],
)
def test_the_recorder_refuses_joints_of_another_kind(edit: object, message: str) -> None:
    model = arm().finalize(requires_grad=True)
    edit(model)  # type: ignore[operator]
    with pytest.raises(novaphy.Error, match=message):
        recorded(model, 0.05, steps=2)


def third_link(builder: novaphy.ModelBuilder) -> None:
    """An arm beside the arm."""
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    builder.add_articulation([builder.add_joint_revolute(-1, link)])


@diff
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (third_link, "one articulation"),
        (lambda builder: builder.add_constraint_mimic(1, 0), "joints that follow no other"),
    ],
)
def test_the_recorder_refuses_other_mechanisms(change: object, message: str) -> None:
    builder = arm()
    change(builder)  # type: ignore[operator]
    with pytest.raises(novaphy.Error, match=message):
        recorded(builder.finalize(requires_grad=True), 0.05, steps=2)


def of_joints(*kinds: str, **last: float) -> novaphy.ModelBuilder:
    """A chain of joints of these kinds about +Y; `last` of the last link's body and joint."""
    builder, parent, joints = novaphy.ModelBuilder(), -1, []
    for k, kind in enumerate(kinds):
        own = last if k == len(kinds) - 1 else {}
        body = {"mass": 1.0, "inertia": np.eye(3)} if own.get("mass", 1.0) > 0.0 else {}
        link = builder.add_link(**body)
        add = getattr(builder, f"add_joint_{kind}")
        joints.append(add(parent, link, axis=(0, 1, 0), armature=own.get("armature", 0.0)))
        parent = link
    builder.add_articulation(joints)
    return builder


@diff
@pytest.mark.parametrize(
    ("builder", "message"),
    [
        (of_joints("revolute"), "two joints and two bodies"),
        (of_joints("revolute", "revolute", "revolute"), "two joints and two bodies"),
        (of_joints("revolute", "prismatic"), "REVOLUTE joints"),
        (of_joints("revolute", "revolute", mass=0.0, armature=0.1), "bodies with mass"),
    ],
)
def test_the_recorder_refuses_other_chains(builder: novaphy.ModelBuilder, message: str) -> None:
    with pytest.raises(novaphy.Error, match=f"recor.*: expected {message}"):
        recorded(builder.finalize(requires_grad=True), 0.05, steps=2)


@diff
@pytest.mark.parametrize("case", ["body_f", "joint_act", "dt", "size", "another state"])
def test_the_recorder_names_what_it_is_given_wrong(case: str) -> None:
    from novaphy import nova
    from novaphy.diff import (
        record_planar_2r_featherstone_step,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    model = arm().finalize(requires_grad=True)
    solver = novaphy.solvers.SolverFeatherstone(model)
    old, new, control = model.state(), model.state(), model.control()
    error, message = {
        "body_f": (novaphy.Error, "expected body_f 0, got 0.5 at body 1"),
        "joint_act": (novaphy.Error, "expected joint_act 0, got 0.5 at 0"),
        "dt": (ValueError, "dt: expected a finite number > 0, got 0"),
        "size": (ValueError, r"q: expected \{2\} on the cpu, got \{3\}"),
        "another state": (novaphy.Error, "expected q and qd to be state_in's"),
    }[case]
    with nova.Tape():
        solver.step(old, new, control, None, DT)
        q = state_joint_q_tensor(new if case == "another state" else old)
        if case == "size":
            q = nova.tensor(np.zeros(3, np.float32))
        if case == "body_f":
            wrenches = np.zeros((2, 6), np.float32)
            wrenches[1, 2] = 0.5
            old.body_f.assign(wrenches)
        if case == "joint_act":
            control.joint_act.fill_(0.5)
        with pytest.raises(error, match=message):
            record_planar_2r_featherstone_step(
                model,
                old,
                control,
                q,
                state_joint_qd_tensor(old),
                state_joint_q_tensor(new),
                state_joint_qd_tensor(new),
                0.0 if case == "dt" else DT,
                0.05,
            )


@diff
def test_the_recorder_refuses_another_angular_damping() -> None:
    model = arm().finalize(requires_grad=True)
    with pytest.raises(novaphy.Error, match="qd_out"):
        recorded(model, 0.05, steps=2, told=0.0)


def test_functions_agree_with_each_other() -> None:
    model = arm(armature=0.01).finalize()
    state = model.state()
    tau = np.array([0.3, -0.2], np.float32)
    qdd = novaphy.eval_forward_dynamics(model, state, tau)
    np.testing.assert_allclose(
        novaphy.eval_inverse_dynamics(model, state, qdd), tau, rtol=1e-5, atol=1e-6
    )
    h = novaphy.eval_mass_matrix(model, state)
    assert h.shape == (1, 2, 2)
    bias = novaphy.eval_bias(model, state)
    np.testing.assert_allclose(h[0] @ qdd + bias, tau, atol=1e-5)
    bare = novaphy.eval_mass_matrix(model, state, include_armature=False)
    np.testing.assert_allclose(h[0] - bare[0], np.diag([0.01, 0.01]), atol=1e-7)
    dq, dqd, inverse = novaphy.eval_forward_dynamics_derivatives(model, state, tau)
    np.testing.assert_allclose(inverse[0] @ h[0], np.eye(2), atol=1e-5)
    for matrix, name in ((dq, "joint_q"), (dqd, "joint_qd")):
        for k in range(2):
            moved = []
            for sign in (1.0, -1.0):
                other = model.state()
                values = getattr(other, name).numpy()
                values[k] += sign * 1e-2
                getattr(other, name).assign(values)
                moved.append(novaphy.eval_forward_dynamics(model, other, tau))
            fd = (moved[0] - moved[1]) / 2e-2
            np.testing.assert_allclose(matrix[0][:, k], fd, rtol=2e-3, atol=2e-3)
    jacobian = novaphy.eval_jacobian(model, state)
    assert jacobian.shape == (1, 12, 2)
    solver = novaphy.solvers.SolverFeatherstone(model)
    after = model.state()
    solver.step(state, after, None, None, 1e-3)
    twist = novaphy.eval_jacobian(model, after)[0] @ after.joint_qd.numpy()
    np.testing.assert_allclose(after.body_qd.numpy().reshape(-1), twist, atol=1e-6)
    com = novaphy.eval_center_of_mass(model, after)
    np.testing.assert_allclose(com[0], after.body_q.numpy()[:, :3].mean(axis=0), atol=1e-6)
    kinetic = 0.5 * state.joint_qd.numpy() @ bare[0] @ state.joint_qd.numpy()
    assert novaphy.eval_energy(model, state)[0, 0] == pytest.approx(kinetic, rel=1e-5)


def test_functions_name_wrong_sizes() -> None:
    model = arm().finalize()
    with pytest.raises(ValueError, match="qdd"):
        novaphy.eval_inverse_dynamics(model, model.state(), [1.0])


def walker_builder() -> novaphy.ModelBuilder:
    """Build a free body with a ball, a hinge with a drive, and a D6 on it."""
    b = novaphy.ModelBuilder()
    inertia = np.diag([0.02, 0.03, 0.04])
    root, ball, hinge, last = (
        b.add_link(mass=1.0 + 0.2 * k, com=(0.02, 0.01 * k, 0.0), inertia=inertia) for k in range(4)
    )
    turned = (0.0, 0.1736482, 0.0, 0.9848078)
    joints = [
        b.add_joint_free(root, child_xform=(0.1, 0.0, 0.0, *turned)),
        b.add_joint_ball(root, ball, parent_xform=(0.2, 0.0, 0.1, *turned), damping=0.1),
        b.add_joint_revolute(
            root,
            hinge,
            axis=(0.0, 0.6, 0.8),
            parent_xform=(-0.2, 0.1, 0.0, *turned),
            target_q=0.3,
            target_ke=20.0,
            target_kd=0.5,
            limit_lower=-0.3,
            limit_upper=0.3,
            armature=0.01,
        ),
        b.add_joint_d6(
            hinge,
            last,
            linear_axes=[novaphy.JointDofConfig(axis=(1.0, 0.0, 0.0), target_ke=50.0)],
            angular_axes=[novaphy.JointDofConfig(axis=(0.0, 1.0, 0.0), damping=0.05)],
            parent_xform=(0.0, 0.0, -0.3, *turned),
        ),
    ]
    b.add_articulation(joints)
    b.joint_qd = [0.3, -0.2, 0.1, 1.0, -0.5, 0.7, 0.4, -0.8, 0.6, 1.5, 0.2, -0.9]
    return b


def walker() -> novaphy.Model:
    """Its model, with gradients."""
    return walker_builder().finalize(requires_grad=True)


def walk(model: novaphy.Model, steps: int = 20) -> tuple:
    """Roll out; a weighted sum of the last poses, velocities and coordinates, {1}."""
    from novaphy import diff, nova

    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    trajectory = diff.Trajectory(model, steps)
    solver.rollout(trajectory, model.control(), None, 0.01)
    end = trajectory[steps]
    terms = [
        diff.state_body_q_tensor(end),
        diff.state_body_qd_tensor(end),
        diff.state_joint_q_tensor(end),
        diff.state_joint_qd_tensor(end),
    ]
    loss = None
    for k, term in enumerate(terms):
        weights = np.cos(np.arange(term.size, dtype=np.float32) + k).reshape(term.shape)
        part = nova.sum(term * nova.tensor(weights.astype(np.float32)))
        loss = part if loss is None else loss + part
    return loss, trajectory


@diff
@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("body_mass", 1e-2),
        ("body_com", 1e-3),
        ("joint_armature", 1e-3),
        ("joint_damping", 1e-2),
        ("joint_target_ke", 0.2),
        ("joint_limit_ke", 100.0),
    ],
)
def test_gradients_of_the_model_equal_central_differences(name: str, step: float) -> None:
    from novaphy import nova

    model = walker()
    array = getattr(model, name)
    free = {"joint_damping": 6, "joint_target_ke": 9}.get(name, 0)  # the first dof that has one
    values = array.numpy()
    values.reshape(-1)[free:] += np.float32(step)  # less is negative where there is nothing
    array.assign(values)
    array.requires_grad = True
    with nova.Tape() as tape:
        loss, _ = walk(model)
    tape.backward(loss)
    gradient = array.grad.numpy().reshape(-1)
    worst, scale = 0.0, float(np.abs(gradient).max())
    for k in range(free, values.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved.reshape(-1)[k] += np.float32(sign * step)
            array.assign(moved)
            ends.append(walk(model)[0].item())
        array.assign(values)
        worst = max(worst, abs((ends[0] - ends[1]) / (2.0 * step) - gradient[k]))
    assert scale > 0.0
    assert worst < 1e-2 * scale


@diff
def test_gradients_of_worlds_in_lanes_are_those_of_the_worlds_alone() -> None:
    from novaphy import diff, nova

    worlds, steps = 19, 11
    arrays = ("joint_damping", "joint_target_ke", "joint_limit_ke", "body_mass", "body_inertia")
    rng = np.random.default_rng(3)
    start = np.array(walker_builder().joint_qd) + rng.normal(0, 1.0, (worlds, 12))

    def run(first: int, count: int) -> dict[str, np.ndarray]:
        builder = novaphy.ModelBuilder()
        builder.replicate(walker_builder(), count)
        model = builder.finalize(requires_grad=True)
        for name in arrays:
            getattr(model, name).requires_grad = True
        solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
        trajectory = diff.Trajectory(model, steps)
        now = trajectory[0]
        now.joint_qd.assign(start[first : first + count].ravel().astype(np.float32))
        with nova.Tape() as tape:
            solver.rollout(trajectory, model.control(), None, 0.01)
            loss = nova.sum(diff.state_body_q_tensor(trajectory[steps]))
            loss = loss + nova.sum(diff.state_joint_qd_tensor(trajectory[5]))
        tape.backward(loss)
        found = {name: getattr(model, name).grad.numpy() for name in arrays}
        found |= {"q": now.joint_q.grad.numpy(), "qd": now.joint_qd.grad.numpy()}
        found |= {"end": trajectory[steps].body_qd.numpy()}
        return {k: v.reshape(count, -1) for k, v in found.items()}

    together = run(0, worlds)
    for world in range(worlds):
        for name, alone in run(world, 1).items():
            np.testing.assert_array_equal(together[name][world], alone[0], err_msg=name)
    assert all(np.abs(v).max() > 0.0 for v in together.values())


@diff
def test_gradients_of_the_start_equal_central_differences() -> None:
    from novaphy import nova

    model = walker()
    with nova.Tape() as tape:
        loss, trajectory = walk(model)
    tape.backward(loss)
    for name, step in (("joint_q", 1e-3), ("joint_qd", 1e-2)):
        gradient = getattr(trajectory[0], name).grad.numpy()
        array = getattr(model, name)
        values = array.numpy()
        fd = np.zeros_like(gradient)
        for k in range(values.size):
            ends = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[k] += np.float32(sign * step)
                array.assign(moved)
                ends.append(walk(model)[0].item())
            array.assign(values)
            fd[k] = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(fd - gradient).max() < 1e-2 * np.abs(gradient).max()


@diff
def test_arrays_without_a_gradient_refuse_one() -> None:
    from novaphy import nova

    model = walker()
    model.joint_X_p.requires_grad = True
    with nova.Tape(), pytest.raises(NotImplementedError, match=r"model\.joint_X_p"):
        walk(model)


def test_singular_models_are_refused_by_name() -> None:
    model = arm().finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    model.body_mass.zero_()
    model.body_inertia.zero_()
    with pytest.raises(novaphy.Error, match=r"dof 1 \(joint 'joint_1'\)"):
        solver.step(model.state(), model.state(), None, None, DT)


@diff
@pytest.mark.parametrize("per_step", [False, True])
def test_body_forces_of_a_rollout_act_and_have_a_gradient(per_step: bool) -> None:
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_qd_tensor

    model, steps = arm().finalize(), 3
    rng = np.random.default_rng(5)
    shape = (steps, 2, 6) if per_step else (2, 6)
    given = rng.normal(size=shape).astype(np.float32)
    forces = nova.tensor(given, requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    trajectory = Trajectory(model, steps)

    def end(values: object) -> np.ndarray:
        solver.rollout(trajectory, None, None, DT, body_forces=values)
        return trajectory[steps].joint_qd.numpy().astype(np.float64)

    plain, state, after = novaphy.solvers.SolverFeatherstone(model), model.state(), model.state()
    for k in range(steps):
        state.body_f.assign(given[k] if per_step else given)
        plain.step(state, after, None, None, DT)
        state, after = after, state
    np.testing.assert_array_equal(state.joint_qd.numpy(), end(forces).astype(np.float32))

    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT, body_forces=forces)
        tape.backward(nova.sum(state_joint_qd_tensor(trajectory[steps])))
    change = rng.normal(size=shape).astype(np.float32)
    up, down = (end(nova.tensor(given + sign * change)).sum() for sign in (np.float32(1), -1))
    expected = (up - down) / 2
    assert expected != 0
    assert float((forces.grad.numpy() * change).sum()) == pytest.approx(expected, rel=1e-3)


@diff
def test_a_pipeline_is_refused_without_a_way_of_contact() -> None:
    from novaphy.diff import Trajectory

    builder = arm()
    builder.add_shape_sphere(1, radius=0.1)
    builder.add_ground_plane()
    model = builder.finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact=None, contact_gradient="code")
    with pytest.raises(ValueError, match="contacts: expected none"):
        pipeline = novaphy.CollisionPipeline(model)
        solver.rollout(Trajectory(model, 1), None, None, DT, pipeline=pipeline)
