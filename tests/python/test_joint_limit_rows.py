"""Limits of joints as rows: impulses that let a gap close, and no more.

Against a pendulum that is integrated between the impacts in float64, and against differences.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

G = 9.81
STOP = -0.5
MOVES = (3e-4, 1e-3)
needs_diff = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


def pendulum(worlds: int = 1, gravity: float = G, **limits: float) -> novaphy.Model:
    """A point of 1 kg at 1 m about Y, with a stop at -0.5 rad: q'' = -g sin q."""
    builder = novaphy.ModelBuilder(gravity=-gravity)
    for _ in range(worlds):
        builder.begin_world()
        link = builder.add_link(mass=1.0, inertia=np.eye(3) * 1e-6)
        joint = builder.add_joint_revolute(
            -1,
            link,
            axis=(0, 1, 0),
            child_xform=((0, 0, 1), (0, 0, 0, 1)),
            **{"limit_lower": STOP, **limits},
        )
        builder.add_articulation([joint])
        builder.end_world()
    return builder.finalize(requires_grad=novaphy.has_diff())


def truth(q: float, v: float, time: float, restitution: float, stop: float = STOP) -> np.ndarray:
    """The state of the pendulum after a time, by Runge-Kutta between the impacts."""

    def rates(x: np.ndarray) -> np.ndarray:
        return np.array([x[1], -G * np.sin(x[0])])

    def moved(x: np.ndarray, h: float) -> np.ndarray:
        a = rates(x)
        b = rates(x + h / 2 * a)
        c = rates(x + h / 2 * b)
        return x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c))

    x, left, rests = np.array([q, v]), time, False
    while left > 1e-12:
        h = min(2e-3, left)
        if rests:  # the weight pulls it off the stop
            x, rests = np.array([stop, 0.0]), False
        then = moved(x, h)
        if then[0] < stop and then[1] < 0.0:
            low, high = 0.0, h
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if moved(x, middle)[0] < stop else (middle, high)
            h = high
            then = moved(x, h)
            then = np.array([stop, -restitution * then[1]])
        x, left = then, left - h
    return x


def rows(model: novaphy.Model, restitution: float = 0.0) -> novaphy.solvers.SolverFeatherstone:
    return novaphy.solvers.SolverFeatherstone(
        model, joint_limits="row", joint_limit_restitution=restitution
    )


def steps(
    solver: novaphy.solvers.SolverBase, q: object, qd: object, count: int, dt: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    state, after = solver.model.state(), solver.model.state()
    state.joint_q.assign(np.float32(q))
    state.joint_qd.assign(np.float32(qd))
    novaphy.eval_fk(solver.model, state.joint_q, state.joint_qd, state)
    seen = []
    for _ in range(count):
        solver.step(state, after, None, None, dt)
        state, after = after, state
        seen.append((state.joint_q.numpy().copy(), state.joint_qd.numpy().copy()))
    return seen


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_a_pendulum_on_a_hard_stop_converges_to_its_motion(restitution: float) -> None:
    model, time = pendulum(), 1.2
    wanted = truth(1.0, 0.0, time, restitution)
    errors = []
    for rate in (240, 960):
        seen = steps(rows(model, restitution), [1.0], [0.0], round(time * rate), 1 / rate)
        errors.append(np.abs(np.array([seen[-1][0][0], seen[-1][1][0]]) - wanted).max())
        assert min(q[0] for q, _ in seen) > STOP - 1e-5
    assert errors[0] < 0.05 and errors[1] < 0.4 * errors[0] + 1e-3, errors


def test_a_limit_lets_its_gap_close_and_holds_against_a_force() -> None:
    """Pressed on its stop it rests there; pulled, it leaves at once."""
    model = pendulum(gravity=0.0)
    state, after, control = model.state(), model.state(), model.control()
    solver = rows(model)
    state.joint_qd.assign([-1.0])
    control.joint_f.assign([-2.0])
    for _ in range(400):
        solver.step(state, after, control, None, 2e-3)
        state, after = after, state
    assert abs(state.joint_q.numpy()[0] - STOP) < 1e-6 and abs(state.joint_qd.numpy()[0]) < 1e-6
    control.joint_f.assign([3.0])
    solver.step(state, after, control, None, 2e-3)
    assert abs(after.joint_qd.numpy()[0] - 3.0 * 2e-3) < 1e-5


def test_an_elastic_stop_inside_a_free_body_keeps_momentum_and_energy() -> None:
    """Two links in space close their hinge: what the stop does to one, it takes from the other."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    links = [builder.add_link(mass=m, inertia=np.diag([0.02, 0.03, 0.04])) for m in (2.0, 1.0)]
    root = builder.add_joint_free(parent=-1, child=links[0])
    hinge = builder.add_joint_revolute(
        links[0],
        links[1],
        axis=(0, 1, 0),
        parent_xform=((0.2, 0, 0), (0, 0, 0, 1)),
        child_xform=((-0.2, 0, 0), (0, 0, 0, 1)),
        limit_upper=0.0123,
    )
    builder.add_articulation([root, hinge])
    model = builder.finalize()
    start_q, start = model.joint_q.numpy(), np.float32([0.1, 0, 0.2, 0, 0.5, 0, 2.0])
    (q, qd), (_, then) = steps(rows(model, 1.0), start_q, start, 6, 1e-3)[-2::1][:2]
    seen = steps(rows(model, 1.0), start_q, start, 12, 1e-3)
    assert q is not None and then is not None and qd is not None
    # The hinge turns its rate, the linear momentum and that about Y stay.
    assert seen[-1][1][6] < 0.0 and abs(seen[-1][1][6] + seen[0][1][6]) < 0.02

    def momentum(at: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, float]:
        state = model.state()
        state.joint_q.assign(at[0])
        state.joint_qd.assign(at[1])
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        v, mass = state.body_qd.numpy(), model.body_mass.numpy()
        energy = novaphy.eval_energy(model, state)[0][0]
        return (v[:, :3] * mass[:, None]).sum(axis=0), float(energy)

    (before, energy), (after, left) = momentum(seen[0]), momentum(seen[-1])
    assert np.abs(before - after).max() < 1e-4 and abs(energy - left) < 2e-3 * energy


def test_worlds_and_threads_have_the_same_bits() -> None:
    one = steps(rows(pendulum(), 0.5), [1.0], [0.0], 300, 1 / 300)
    many = steps(rows(pendulum(9), 0.5), [1.0] * 9, [0.0] * 9, 300, 1 / 300)
    for (q, qd), (all_q, all_qd) in zip(one, many, strict=True):
        assert np.array_equal(all_q, np.repeat(q, 9)) and np.array_equal(all_qd, np.repeat(qd, 9))


def test_bad_options_are_refused_by_name() -> None:
    model = pendulum()
    with pytest.raises(ValueError, match='joint_limits: expected "spring" or "row", got "hard"'):
        novaphy.solvers.SolverFeatherstone(model, joint_limits="hard")
    with pytest.raises(ValueError, match='expected 0 without joint_limits="row", got 0.5'):
        novaphy.solvers.SolverFeatherstone(model, joint_limit_restitution=0.5)
    with pytest.raises(ValueError, match="joint_limit_restitution: expected 0 to 1, got 1.5"):
        rows(model, 1.5)
    builder = novaphy.ModelBuilder()
    joints, parent = [], -1
    for _ in range(2):
        link = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
        joints.append(builder.add_joint_revolute(parent, link, axis=(0, 1, 0), limit_upper=1.0))
        parent = link
    builder.add_articulation(joints)
    builder.add_constraint_mimic(joints[1], joints[0], 0.0, 1.0)
    with pytest.raises(NotImplementedError, match="limits of joint 1 .*follows joint 0"):
        rows(builder.finalize())


class Run:
    """A rollout, the loss w . (q, qd) at its end, its gradients, and a tangent."""

    def __init__(
        self,
        model: novaphy.Model,
        mode: str,
        q: float,
        v: float,
        count: int,
        dt: float,
        *,
        restitution: float = 0.0,
        weights: tuple[float, float] = (1.0, 0.0),
        along: tuple[float, float] = (1.0, 0.0),
        checkpoint: int | None = None,
    ) -> None:
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffFeatherstoneSolver(
            model, contact_gradient=mode, joint_limits="row", joint_limit_restitution=restitution
        )
        path = diff.Trajectory(model, count, checkpoint=checkpoint)
        path[0].joint_q.assign(np.float32([q]))
        path[0].joint_qd.assign(np.float32([v]))
        novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
        for array in (model.joint_limit_lower, model.joint_limit_upper):
            array.requires_grad = True
            if array.grad is not None:
                array.grad.zero_()
        with nova.Tape() as tape:
            solver.rollout(path, None, None, dt)
            loss = nova.sum(diff.state_joint_q_tensor(path[count])) * weights[0]
            loss = loss + nova.sum(diff.state_joint_qd_tensor(path[count])) * weights[1]
            tape.backward(loss)
            start = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
            tangents = [nova.tensor(np.float32([x])) for x in along]
            self.along = tape.jvp([loss], start, tangents)[0].item()
        self.of_q = float(path[0].joint_q.grad.numpy()[0])
        self.of_qd = float(path[0].joint_qd.grad.numpy()[0])
        self.of_lower = float(model.joint_limit_lower.grad.numpy()[0])
        self.of_upper = float(model.joint_limit_upper.grad.numpy()[0])
        end = path[count]
        self.end = np.array([end.joint_q.numpy()[0], end.joint_qd.numpy()[0]])
        self.loss = float(np.dot(weights, self.end.astype(float)))
        self.info = solver.gradient_info()


@needs_diff
@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_gradients_of_the_code_are_those_of_differences(restitution: float) -> None:
    """Small moves keep the step in which the stop is met."""
    weights, dt = (0.7, -0.4), 1 / 200
    how = {"restitution": restitution, "weights": weights, "along": (0.6, -0.8)}
    # Some phases: the step closes the gap, or bounces, behind smooth ones.
    for start in (-0.4533, -0.4613, -0.4727):
        run = Run(pendulum(), "code", start, -1.0, 40, dt, **how)
        assert run.info.label == "exact of the code"
        assert abs(run.along - (0.6 * run.of_q - 0.8 * run.of_qd)) < 1e-5
        scale = abs(run.of_q) + abs(run.of_qd) + abs(run.of_lower)
        e = 2e-4
        for found, change in ((run.of_q, (e, 0.0)), (run.of_qd, (0.0, e))):
            ends = [
                Run(pendulum(), "code", start + s * change[0], -1.0 + s * change[1], 40, dt, **how)
                for s in (1, -1)
            ]
            assert abs((ends[0].loss - ends[1].loss) / (2 * e) - found) < 5e-3 * scale
        ends = [
            Run(pendulum(limit_lower=STOP + s * e), "code", start, -1.0, 40, dt, **how)
            for s in (1, -1)
        ]
        assert abs((ends[0].loss - ends[1].loss) / (2 * e) - run.of_lower) < 5e-3 * scale


@needs_diff
@pytest.mark.parametrize(
    ("restitution", "time", "rates", "wanted"),
    [
        (0.6, 2.6, (120, 240, 480), (0.24, 0.054, 0.012)),
        (0.0, 1.2, (120, 240, 480), (0.15, 0.083, 0.047)),
    ],
)
def test_gradients_of_the_motion_converge_to_those_of_the_pendulum(
    restitution: float, time: float, rates: tuple[int, ...], wanted: tuple[float, ...]
) -> None:
    """Two hits, or a landing that swings back, by the start, its rate and the stop.

    Relative to the largest derivative by the start and its rate, or by the stop.
    """
    e = 1e-6
    columns = []
    for q, v, stop in np.eye(3) * e:
        ends = [truth(1.0 + s * q, s * v, time, restitution, STOP + s * stop) for s in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2 * e))
    size = np.abs(columns[:2]).max()
    sizes = np.array([[size], [size], [np.abs(columns[2]).max()]])
    for rate, most in zip(rates, wanted, strict=True):
        errors = {}
        for mode in ("code", "motion"):
            found = []
            for weights in ((1.0, 0.0), (0.0, 1.0)):
                run = Run(
                    pendulum(),
                    mode,
                    1.0,
                    0.0,
                    round(time * rate),
                    1 / rate,
                    restitution=restitution,
                    weights=weights,
                    along=(0.6, -0.8),
                )
                found.append([run.of_q, run.of_qd, run.of_lower])
                ours = 0.6 * run.of_q - 0.8 * run.of_qd
                assert abs(run.along - ours) < 1e-3 * size, (run.along, ours)
            errors[mode] = (np.abs(np.array(found).T - columns) / sizes).max()
        assert errors["motion"] < most and errors["code"] > 0.5, (rate, errors)
        assert {row["kind"] for row in run.info.event_list} == {"limit"}
        assert all(row["joint"] == 0 for row in run.info.event_list)
        assert run.info.label == "exact of the motion", run.info.reason


@needs_diff
def test_a_capture_replays_the_same_bits() -> None:
    from novaphy import diff, nova

    model = pendulum()
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, joint_limits="row", joint_limit_restitution=0.6
    )
    path = diff.Trajectory(model, 60)

    def once() -> None:
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 1 / 60)
            tape.backward(nova.sum(diff.state_joint_q_tensor(path[60])))

    path[0].joint_q.assign([1.0])
    with nova.ScopedCapture() as capture:
        once()
    capture.graph.launch()
    run = Run(model, "code", 1.0, 0.0, 60, 1 / 60, restitution=0.6)
    assert path[60].joint_q.numpy()[0] == run.end[0]
    assert path[0].joint_q.grad.numpy()[0] == np.float32(run.of_q)


@needs_diff
@pytest.mark.parametrize("mode", ["code", "motion"])
def test_the_tangent_of_a_chain_on_its_stops_is_the_transpose_of_its_adjoint(mode: str) -> None:
    """Three links that fall into their stops, whose impulses reach each other."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    parent, joints = -1, []
    for k in range(3):
        link = builder.add_link(mass=1.0 + 0.5 * k, inertia=np.diag([0.01, 0.02, 0.02]))
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=(0, 1, 0.3 * k),
                parent_xform=((0.2 if k else 0.0, 0, 0), (0, 0, 0, 1)),
                child_xform=((-0.2, 0, 0), (0, 0, 0, 1)),
                limit_lower=-0.2 - 0.05 * k,
                limit_upper=0.3 + 0.1 * k,
            )
        )
        parent = link
    builder.add_articulation(joints)
    model, rng, steps, dt = builder.finalize(requires_grad=True), np.random.default_rng(4), 40, 4e-3
    weights, along = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))

    def run(start: np.ndarray, gradient: bool = False) -> tuple[float, float, float]:
        solver = novaphy.solvers.DiffFeatherstoneSolver(
            model, contact_gradient=mode, joint_limits="row", joint_limit_restitution=0.4
        )
        path = diff.Trajectory(model, steps)
        path[0].joint_q.assign(start[0].astype(np.float32))
        path[0].joint_qd.assign(start[1].astype(np.float32))
        novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
        with nova.Tape() as tape:
            solver.rollout(path, None, None, dt)
            end = [
                diff.state_joint_q_tensor(path[steps]),
                diff.state_joint_qd_tensor(path[steps]),
            ]
            loss = nova.sum(end[0] * nova.tensor(weights[0].astype(np.float32)))
            loss = loss + nova.sum(end[1] * nova.tensor(weights[1].astype(np.float32)))
            value = sum(
                float(w @ x.numpy().astype(float)) for w, x in zip(weights, end, strict=True)
            )
            if not gradient:
                return value, 0.0, 0.0
            tape.backward(loss)
            x = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
            tangents = [nova.tensor(a.astype(np.float32)) for a in along]
            tangent = tape.jvp([loss], x, tangents)[0].item()
        found = [path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()]
        adjoint = sum(float(g.astype(float) @ a) for g, a in zip(found, along, strict=True))
        if mode == "motion":
            assert len(solver.gradient_info().event_list) >= 2
        return value, adjoint, tangent

    start = np.array([[0.1, -0.05, 0.2], [1.0, -2.0, 1.5]])
    _, adjoint, tangent = run(start, gradient=True)
    assert abs(adjoint - tangent) < 1e-4 * max(1.0, abs(adjoint)), (adjoint, tangent)
    if mode == "code":  # MOVES are above the rounding, and do not move a stop to another step
        slopes = [(run(start + e * along)[0] - run(start - e * along)[0]) / (2 * e) for e in MOVES]
        assert np.abs(np.array(slopes) - adjoint).min() < 5e-3 * abs(adjoint), (slopes, adjoint)


@needs_diff
@pytest.mark.parametrize("worlds", [1, 4])
def test_a_bounce_off_a_stop_has_its_time_in_every_number_of_worlds(worlds: int) -> None:
    """A slide of 1 m/s that leaves its stop with 0.7 of it: dq/dq0 is -0.7."""
    from novaphy import diff, nova

    one = novaphy.ModelBuilder(gravity=0.0)
    link = one.add_link(mass=1.0, inertia=np.eye(3))
    joint = one.add_joint_prismatic(-1, link, axis=(0, 0, 1), limit_lower=-1.0, limit_upper=0.1)
    one.add_articulation([joint])
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.replicate(one, worlds)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, contact_gradient="motion", joint_limits="row", joint_limit_restitution=0.7
    )
    path = diff.Trajectory(model, 180)
    path[0].joint_qd.assign(np.ones(worlds, np.float32))
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1e-3)
        tape.backward(nova.sum(diff.state_joint_q_tensor(path[180])))
    np.testing.assert_allclose(path[0].joint_q.grad.numpy(), -0.7, atol=1e-4)
    assert len(solver.gradient_info().event_list) == worlds


@needs_diff
@pytest.mark.parametrize("bound", ["row", "velocity"])
def test_a_contact_that_bounces_beside_a_held_dof_has_one_derivative(bound: str) -> None:
    """Two links, of which one is held in the step in which their ball leaves the ground."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.0, restitution=0.5, gap=0.05)
    held = {"limit_lower": -0.0097} if bound == "row" else {"velocity_limit": 0.5}
    upper = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.02, 0.02]))
    lower = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.02, 0.02]))
    turn, end = (0, 0, 0, 1), ((-0.25, 0, 0), (0, 0, 0, 1))
    joints = [
        builder.add_joint_revolute(
            -1, upper, axis=(0, 1, 0), parent_xform=((0, 0, 0.1995), turn), child_xform=end
        ),
        builder.add_joint_revolute(
            upper, lower, axis=(0, 1, 0), parent_xform=((0.25, 0, 0), turn), child_xform=end, **held
        ),
    ]
    builder.add_shape_sphere(lower, radius=0.1, xform=((0.25, 0, 0), turn), cfg=surface)
    builder.add_articulation(joints)
    builder.add_ground_plane(cfg=surface)
    model = builder.finalize(requires_grad=True)
    options = {"joint_limits": "row"} if bound == "row" else {}
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, pgs_slop=0.0, pgs_erp=1.0, **options)
    path = diff.Trajectory(model, 1)
    path[0].joint_q.assign(np.float32([0.1, -0.0047]))
    path[0].joint_qd.assign(np.float32([2.88, 1.615]))
    novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
    states = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 0.01, pipeline=novaphy.CollisionPipeline(model))
        loss = nova.sum(diff.state_joint_qd_tensor(path[1])[0:1])
        tape.backward(loss)
        tangents = []
        for row in np.eye(4, dtype=np.float32):
            moved = [nova.tensor(row[:2]), nova.tensor(row[2:])]
            tangents.append(tape.jvp([loss], states, moved)[0].item())
    gradient = np.r_[path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()]
    np.testing.assert_allclose(gradient, tangents, atol=1e-4)
    # The ball leaves with half of the rate of both links: of v0 twice as far away as of v1.
    np.testing.assert_allclose(gradient[2:], [-0.5, -0.25], atol=1e-4)
