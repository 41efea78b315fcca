"""Gradients by the limits of joints, and stops that other bounds of a rate cut.

Slides without gravity have closed forms; else differences.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 1e-3


def slide(worlds: int = 1, **limits: float) -> novaphy.Model:
    """A mass of 1 kg on a rail, without gravity."""
    one = novaphy.ModelBuilder(gravity=0.0)
    link = one.add_link(mass=1.0, inertia=np.eye(3))
    one.add_articulation([one.add_joint_prismatic(-1, link, axis=(0, 0, 1), **limits)])
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.replicate(one, worlds)
    model = builder.finalize(requires_grad=True)
    for name in ("joint_limit_lower", "joint_limit_upper", "joint_velocity_limit"):
        getattr(model, name).requires_grad = True
    return model


class Run:
    """A rollout of one dof, the gradients of w . (q, qd) at its end, and a tangent along all."""

    def __init__(
        self,
        model: novaphy.Model,
        start: tuple[float, float],
        steps: int,
        weights: tuple[float, float] = (1.0, 0.0),
        dt: float = DT,
        **options: Any,
    ) -> None:
        from novaphy import diff, nova

        self.solver = novaphy.solvers.DiffFeatherstoneSolver(model, **options)
        path = diff.Trajectory(model, steps)
        for array, value in zip((path[0].joint_q, path[0].joint_qd), start, strict=True):
            array.assign(np.full(array.shape, value, np.float32))
        self.inputs = {
            "q": path[0].joint_q,
            "qd": path[0].joint_qd,
            "lower": model.joint_limit_lower,
            "upper": model.joint_limit_upper,
            "speed": model.joint_velocity_limit,
        }
        for array in self.inputs.values():
            if array.grad is not None:
                array.grad.zero_()
        with nova.Tape() as tape:
            self.solver.rollout(path, None, None, dt)
            loss = nova.sum(diff.state_joint_q_tensor(path[steps])) * weights[0]
            loss = loss + nova.sum(diff.state_joint_qd_tensor(path[steps])) * weights[1]
            tape.backward(loss)
            self.of = {name: float(a.grad.numpy().sum()) for name, a in self.inputs.items()}
            along = {name: 0.3 + 0.2 * k for k, name in enumerate(self.inputs)}
            tensors = [nova.from_device_array(a) for a in self.inputs.values()]
            moves = [
                nova.tensor(np.full(t.shape, x, np.float32))
                for t, x in zip(tensors, along.values(), strict=True)
            ]
            self.tangent = tape.jvp([loss], tensors, moves)[0].item()
        self.adjoint = sum(along[name] * self.of[name] for name in along)
        end = path[steps]
        self.q = np.array([s.joint_q.numpy()[0] for s in (path[k] for k in range(steps + 1))])
        self.end = np.array([end.joint_q.numpy()[0], end.joint_qd.numpy()[0]], float)
        self.loss = float(np.dot(weights, self.end))
        self.info = self.solver.gradient_info()


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_the_time_of_a_bounce_moves_with_the_limit(side: str) -> None:
    """q = L - e (v T - (L - q0)): its derivative by L is 1 + e."""
    sign = 1.0 if side == "upper" else -1.0
    limits = {f"limit_{side}": sign * 0.1}
    rows = {"joint_limits": "row", "joint_limit_restitution": 0.7, "contact_gradient": "motion"}
    run = Run(slide(**limits), (0.0, sign), 180, **rows)
    assert abs(run.of[side] - 1.7) < 1e-4 and abs(run.of["q"] + 0.7) < 1e-4
    assert abs(run.tangent - run.adjoint) < 1e-5 * abs(run.adjoint)
    assert run.info.label == "exact of the motion", run.info.reason
    code = Run(slide(**limits), (0.0, sign), 180, **{**rows, "contact_gradient": "code"})
    assert abs(code.of[side]) < 1e-6, "the code keeps the step of the bounce"


def test_a_limit_has_its_gradient_where_the_start_has_none() -> None:
    from novaphy import diff, nova

    model = slide(worlds=4, limit_upper=0.1)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, joint_limits="row", joint_limit_restitution=0.7, contact_gradient="motion"
    )
    path = diff.Trajectory(model, 2, requires_grad=False)
    path[0].joint_q.assign(np.full(4, 0.0995, np.float32))
    path[0].joint_qd.assign(np.ones(4, np.float32))
    with nova.Tape() as tape:
        solver.rollout(path, None, None, DT)
        tape.backward(nova.sum(diff.state_joint_q_tensor(path[2])))
    np.testing.assert_allclose(model.joint_limit_upper.grad.numpy(), 1.7, atol=1e-4)


def test_the_time_of_a_stop_has_a_gradient_by_its_limit() -> None:
    """t = (L - q) / v, and behind the bounce (L - q) / v + (L - L') / (e v)."""
    from novaphy import diff, nova

    model = slide(limit_upper=0.0503, limit_lower=-0.0202)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, joint_limits="row", joint_limit_restitution=0.5, contact_gradient="motion"
    )
    path = diff.Trajectory(model, 240)
    path[0].joint_qd.assign(np.float32([1.0]))
    with nova.Tape() as tape:
        solver.rollout(path, None, None, DT)
        times = diff.event_times(path)
        tape.backward(times[1])
    np.testing.assert_allclose(times.numpy(), [0.0503, 0.0503 + 0.0705 / 0.5], atol=4e-3)
    assert abs(model.joint_limit_upper.grad.numpy()[0] - 3.0) < 1e-3
    assert abs(model.joint_limit_lower.grad.numpy()[0] + 2.0) < 1e-3
    assert abs(path[0].joint_q.grad.numpy()[0] + 1.0) < 1e-3


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("kd", [0.0, 20.0])
def test_the_time_of_a_spring_moves_with_its_limit(side: str, kd: float) -> None:
    """A slide and its spring move together: dq/dL + dq/dq0 is 1, and dq/dq0 is -speed out / in."""
    sign = 1.0 if side == "upper" else -1.0
    model = slide(**{f"limit_{side}": sign * 0.1003}, limit_ke=1e4, limit_kd=kd)
    run = Run(model, (0.0, sign), 200, contact_gradient="motion")
    out = abs(run.end[1])
    assert 0.5 < out < 1.0 and len(run.info.event_list) == 1
    assert abs(run.of["q"] + out) < 0.02
    assert abs(run.of[side] - (1.0 - run.of["q"])) < 1e-3 * run.of[side]
    assert abs(run.tangent - run.adjoint) < 1e-5 * abs(run.adjoint)


def test_a_pendulum_on_its_spring_has_the_derivative_by_the_limit() -> None:
    """Differences of 0.02 rad, more than a step's way, of 480 steps per second."""

    def ends(limit: float) -> np.ndarray:
        builder = novaphy.ModelBuilder()
        link = builder.add_link(mass=1.0, inertia=np.eye(3) * 1e-6)
        joint = builder.add_joint_revolute(
            -1,
            link,
            axis=(0, 1, 0),
            child_xform=((0, 0, 1), (0, 0, 0, 1)),
            limit_lower=limit,
            limit_ke=1e4,
            limit_kd=10.0,
        )
        builder.add_articulation([joint])
        return builder.finalize(requires_grad=True)

    model = ends(-0.5)
    model.joint_limit_lower.requires_grad = True
    model.joint_limit_upper.requires_grad = True
    model.joint_velocity_limit.requires_grad = True
    options = {"dt": 1 / 1920, "contact_gradient": "motion"}
    run = Run(model, (1.0, 0.0), 1920, **options)
    assert abs(run.tangent - run.adjoint) < 1e-5 * (abs(run.adjoint) + 1.0)
    moved = []
    for change in (0.02, -0.02):
        other = ends(-0.5 + change)
        for name in ("joint_limit_lower", "joint_limit_upper", "joint_velocity_limit"):
            getattr(other, name).requires_grad = True
        moved.append(Run(other, (1.0, 0.0), 1920, **options).loss)
    slope = (moved[0] - moved[1]) / 0.04
    assert abs(run.of["lower"] - slope) < 0.1 * abs(slope), (run.of, slope)


CUTS = {
    # A fast dof between near stops closes the gap to the other one, and no more.
    "other limit": ({"limit_lower": -0.004, "limit_upper": 0.003}, (0.001, 9.0), "lower"),
    "velocity": ({"limit_upper": 0.002, "velocity_limit": 2.0}, (0.001, 6.0), "speed"),
    # Outside of its limits: it comes back at most with its velocity limit.
    "return": ({"limit_upper": 0.003, "velocity_limit": 0.04}, (0.01, 0.0), "speed"),
}


@pytest.mark.parametrize("cut", CUTS)
def test_a_stop_obeys_the_other_bounds_of_its_rate(cut: str) -> None:
    limits, (q, v), by = CUTS[cut]
    rows = {"joint_limits": "row", "joint_limit_restitution": 0.8, "contact_gradient": "code"}
    rows["weights"] = (0.6, 0.2)
    run = Run(slide(**limits), (q, v), 1, **rows)
    wanted = {"other limit": -5.0, "velocity": -2.0, "return": -0.04}[cut]
    assert abs(run.end[1] - wanted) < 1e-5 * abs(wanted)
    assert run.end[0] > limits.get("limit_lower", -np.inf) - 1e-7
    assert abs(run.of[by]) > 1e-4
    assert abs(run.tangent - run.adjoint) < 1e-5 * max(1.0, abs(run.adjoint))
    assert run.info.label == "exact of the code"
    e = {"q": 2e-4, "qd": 1e-2, "lower": 2e-4, "upper": 2e-4, "speed": 2e-3}
    arguments = {"lower": "limit_lower", "upper": "limit_upper", "speed": "velocity_limit"}
    for name, step in e.items():
        if name in arguments and arguments[name] not in limits:
            continue
        ends = []
        for side in (step, -step):
            moved = dict(limits)
            if name in arguments:
                moved[arguments[name]] += side
            at = (q + side * (name == "q"), v + side * (name == "qd"))
            ends.append(Run(slide(**moved), at, 1, **rows).loss)
        slope = (ends[0] - ends[1]) / (2 * step)
        assert abs(slope - run.of[name]) < 2e-3 * max(1.0, abs(slope)), (name, slope, run.of)


def test_a_dof_between_near_stops_stays_there() -> None:
    """10 m/s between stops 5 mm apart, in steps of 1 ms, until the bounces have died out."""
    model = slide(limit_lower=-0.002, limit_upper=0.003)
    rows = {"joint_limits": "row", "joint_limit_restitution": 0.9}
    run = Run(model, (0.0, 10.0), 200, **rows)
    assert run.q.min() > -0.002 - 1e-6 and run.q.max() < 0.003 + 1e-6
    assert abs(run.tangent - run.adjoint) < 1e-5 * max(1.0, abs(run.adjoint))


def test_a_bounce_that_ends_at_the_other_limit_has_no_gradient_of_the_motion() -> None:
    model = slide(limit_lower=-0.004, limit_upper=0.003)
    run = Run(
        model,
        (0.001, 9.0),
        3,
        joint_limits="row",
        joint_limit_restitution=0.8,
        contact_gradient="motion",
    )
    assert run.info.label == "surrogate" and run.info.several >= 1


def test_limits_of_followers_that_are_written_later_are_refused() -> None:
    builder = novaphy.ModelBuilder()
    joints, parent = [], -1
    for _ in range(2):
        link = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
        joints.append(builder.add_joint_revolute(parent, link, axis=(0, 1, 0)))
        parent = link
    builder.add_articulation(joints)
    builder.add_constraint_mimic(joints[1], joints[0], 0.0, 1.0)
    for kind in ("SolverFeatherstone", "DiffFeatherstoneSolver"):
        model = builder.finalize()
        solver = getattr(novaphy.solvers, kind)(model, joint_limits="row")
        state, after = model.state(), model.state()
        solver.step(state, after, None, None, DT)
        model.joint_limit_upper.assign([0.5, 1e30])  # the leader's limit
        solver.step(state, after, None, None, DT)
        model.joint_limit_upper.assign([0.5, 0.7])
        with pytest.raises(NotImplementedError, match="limits of joint 1 .*follows joint 0.*0.7"):
            solver.step(state, after, None, None, DT)
        model.joint_limit_upper.assign([0.5, 1e30])
        solver.step(state, after, None, None, DT)


def stop_and_ball() -> novaphy.Model:
    """An arm on its stop, whose ball strikes the ground and a free ball: one island."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.4, restitution=0.3, gap=0.05)
    turn = (0, 0, 0, 1)
    upper = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.02, 0.02]))
    lower = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.02, 0.02]))
    joints = [
        builder.add_joint_revolute(
            -1,
            upper,
            axis=(0, 1, 0),
            parent_xform=((0, 0, 0.2), turn),
            child_xform=((-0.25, 0, 0), turn),
        ),
        builder.add_joint_revolute(
            upper,
            lower,
            axis=(0, 1, 0),
            parent_xform=((0.25, 0, 0), turn),
            child_xform=((-0.25, 0, 0), turn),
            limit_lower=-0.01,
            limit_upper=0.4,
        ),
    ]
    builder.add_shape_sphere(lower, radius=0.1, xform=((0.25, 0, 0), turn), cfg=surface)
    builder.add_articulation(joints)
    ball = builder.add_body(xform=((1.197, 0, 0.1003), turn), mass=0.5, inertia=np.eye(3) * 2e-3)
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    return builder.finalize(requires_grad=True)


@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_a_stop_beside_contacts_has_the_derivative_of_the_code(restitution: float) -> None:
    """VJP against JVP along every input, and against differences."""
    from novaphy import diff, nova

    model, steps = stop_and_ball(), 3
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model,
        joint_limits="row",
        joint_limit_restitution=restitution,
        pgs_slop=0.0,
        pgs_erp=1.0,
        contact_gradient="code",
    )
    rng = np.random.default_rng(3)
    q0, qd0 = model.joint_q.numpy(), model.joint_qd.numpy()
    q0[:2] = 0.1, -0.004
    qd0[:] = np.r_[2.4, -3.2, -0.5, 0, -0.5, 0, 0, 0]
    weights = rng.normal(size=len(qd0)).astype(np.float32)

    def run(q: np.ndarray, qd: np.ndarray, gradient: bool = False) -> Any:
        path = diff.Trajectory(model, steps)
        path[0].joint_q.assign(q)
        path[0].joint_qd.assign(qd)
        novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
        states = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 2e-3, pipeline=novaphy.CollisionPipeline(model))
            loss = nova.sum(diff.state_joint_qd_tensor(path[steps]) * nova.tensor(weights))
            if not gradient:
                return float(weights @ path[steps].joint_qd.numpy().astype(float))
            tape.backward(loss)
            tangents = []
            for row in np.eye(len(q) + len(qd), dtype=np.float32):
                moves = [nova.tensor(row[: len(q)]), nova.tensor(row[len(q) :])]
                tangents.append(tape.jvp([loss], states, moves)[0].item())
        return np.r_[path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()], tangents

    gradient, tangents = run(q0, qd0, gradient=True)
    np.testing.assert_allclose(gradient, tangents, atol=1e-5 * np.abs(gradient).max())
    e = 1e-4
    for k, row in enumerate(np.eye(len(q0) + len(qd0))):
        if 5 <= k < 9:  # quaternions have unit length
            continue
        d = (e * row).astype(np.float32)
        ends = [run(q0 + s * d[: len(q0)], qd0 + s * d[len(q0) :]) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * e)
        assert abs(slope - gradient[k]) < 0.02 * np.abs(gradient).max(), (k, slope, gradient[k])


def test_a_capture_of_stops_and_contacts_has_the_gradient_of_steps() -> None:
    from novaphy import diff, nova

    model, steps = stop_and_ball(), 12
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, joint_limits="row", pgs_slop=0.0, pgs_erp=1.0, contact_gradient="code"
    )
    model.joint_limit_lower.requires_grad = True
    path, pipeline = diff.Trajectory(model, steps), novaphy.CollisionPipeline(model)
    q0 = model.joint_q.numpy()
    q0[:2] = 0.1, -0.004
    path[0].joint_q.assign(q0)
    path[0].joint_qd.assign(np.float32([2.4, -3.2, -0.5, 0, -0.5, 0, 0, 0]))
    novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])

    def once() -> None:
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 2e-3, pipeline=pipeline)
            tape.backward(nova.sum(diff.state_joint_q_tensor(path[steps])[0:2]))

    def seen() -> list[np.ndarray]:
        arrays = [path[steps].joint_qd, path[0].joint_q.grad, path[0].joint_qd.grad]
        return [a.numpy().copy() for a in (*arrays, model.joint_limit_lower.grad)]

    once()
    wanted = seen()
    assert np.abs(wanted[3]).max() > 0.0, "the stop acts"
    with nova.ScopedCapture() as capture:
        once()
    for array in (path[0].joint_q.grad, path[0].joint_qd.grad, model.joint_limit_lower.grad):
        array.zero_()
    capture.graph.launch()
    for mine, theirs in zip(seen(), wanted, strict=True):
        assert np.array_equal(mine, theirs)


def test_the_label_of_bodies_says_that_limits_do_not_move() -> None:
    """Limits of joints between bodies are springs whose times gradients of the motion hold."""
    from novaphy import diff, nova

    model = slide(limit_upper=0.1, limit_ke=1e4, limit_kd=10.0)
    model.joint_velocity_limit.requires_grad = False  # not of joints between bodies
    config = novaphy.solvers.DiffSolverConfig(contact_gradient="motion")
    for steps, label in ((80, "exact of the motion"), (180, "exact of the code")):
        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
        path = diff.Trajectory(model, steps)
        path[0].body_qd.assign(np.float32([[0, 0, 1, 0, 0, 0]]))
        with nova.Tape() as tape:
            solver.rollout(path, None, None, DT)
            tape.backward(nova.sum(diff.state_body_q_tensor(path[steps])[0, 2:3]))
        assert solver.gradient_info().label == label == tape.gradient_info().label
        assert ("limits of joints" in solver.gradient_info().reason) == (steps == 180)
