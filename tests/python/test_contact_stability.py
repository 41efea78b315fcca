"""Up to which dt contacts are stable: the numbers, that they are the limit, and the warning."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import novaphy
from novaphy import solvers

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def found(model, state=None):
    pipeline = novaphy.CollisionPipeline(model, contacts_per_pair=4)
    contacts = pipeline.contacts(per_contact_shape_properties=True)
    pipeline.collide(state or model.state(), contacts)
    return contacts


def limit_of(model, contacts=None, **options):
    solver = solvers.SolverSemiImplicit(model, **options)
    return solver.stable_dt(model.state(), found(model) if contacts is None else contacts)


def stack(**material):
    """Ten cubes of 8 kg with a side of 0.2 m that overlap a little."""
    cfg = novaphy.ShapeConfig(**({"ke": 0.0, "kd": 0.0, "kf": 0.0} | material))
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    for k in range(10):
        cube = builder.add_body(xform=(0, 0, 0.0999 + 0.1999 * k, *UPRIGHT))
        builder.add_shape_box(cube, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    return builder.finalize()


# Neighbors in antiphase, eight corners each: 2 dt sum k r^2/I = 2, of springs 2 dt^2 sum ke r^2/I
# = 4, with r^2 = 0.01 about a horizontal axis, 0.02 of friction about the upright one.
INERTIA = 8 * 0.04 / 6
CUBES = {
    "ke": 2 * INERTIA * 960**2 / 0.08,
    "kd": 640.0,
    "kf": 320.0,
    "stick_ke": INERTIA * 960**2 / 0.08,
}


@pytest.mark.parametrize("name", CUBES)
def test_ten_cubes_have_the_limits_of_the_closed_form(name):
    value = CUBES[name]
    if name == "stick_ke":
        limit = limit_of(stack(), stick_ke=value)
    else:
        limit = limit_of(stack(**{name: value}))
    assert limit == pytest.approx(1 / 960, rel=1e-3)


def ball(ke, kd=0.0, kf=0.0, mass=2.0):
    """A ball that the ground bears, pushed a little deeper."""
    cfg = novaphy.ShapeConfig(density=0.0, ke=ke, kd=kd, kf=kf, mu=0.5)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    depth = 1.02 * mass * 9.81 / ke
    body = builder.add_body(
        xform=(0, 0, 0.1 - depth, *UPRIGHT), mass=mass, inertia=np.eye(3) * 0.4 * mass * 0.01
    )
    builder.add_shape_sphere(body, radius=0.1, cfg=cfg)
    return builder.finalize()


def heights(model, dt, count):
    pipeline, solver = novaphy.CollisionPipeline(model), solvers.SolverSemiImplicit(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    z = []
    for _ in range(count):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        state, after = after, state
        z.append(state.body_q.numpy()[0, 2])
    return np.array(z)


@pytest.mark.filterwarnings("ignore:SolverSemiImplicit")
def test_above_the_limit_a_resting_ball_is_thrown_off_and_below_it_stays():
    model = ball(ke=1e4)
    limit = limit_of(model)
    assert limit == pytest.approx(2 / np.sqrt(1e4 / 2.0), rel=1e-5)
    rest = 0.1 - 2.0 * 9.81 / 1e4
    assert np.abs(heights(model, 0.98 * limit, 300) - rest).max() < 1e-3
    assert heights(model, 1.02 * limit, 300).max() > rest + 0.02


def closed_form(springs, dampers):
    """The dt with springs dt^2 + dampers dt = 4."""
    return 8 / (dampers + np.sqrt(dampers**2 + 16 * springs))


def test_a_ball_has_the_limit_of_its_coefficients_together():
    mobile = 1 / 2.0 + 0.01 / (0.4 * 2.0 * 0.01)  # 1/kg, at the contact point along the ground
    assert limit_of(ball(1e4, kd=100.0)) == pytest.approx(closed_form(1e4 / 2, 2 * 50), rel=1e-4)
    assert limit_of(ball(1e2, kf=500.0)) == pytest.approx(2 / (500.0 * mobile), rel=1e-2)
    assert limit_of(ball(1e2, kd=800.0, kf=500.0)) == pytest.approx(2 / (500.0 * mobile), rel=1e-2)
    model = ball(1e4)
    contacts = found(model)
    contacts.rigid_contact_stiffness.fill_(4e4)
    assert limit_of(model, contacts) == pytest.approx(np.sqrt(2.0 / 1e4), rel=1e-5)


@pytest.mark.parametrize(("ke", "kd", "kf"), [(1e4, 60, 40), (1e4, 300, 0), (5e3, 5, 300)])
def test_at_the_limit_the_steps_of_a_box_leave_the_unit_circle(ke, kd, kf):
    """Against the eigenvalues of a linear step, all 12 coordinates, in float64."""
    half, mass = np.array([0.2, 0.1, 0.05]), 3.0
    cfg = novaphy.ShapeConfig(density=0.0, ke=ke, kd=kd, kf=kf, margin=0.0)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    moments = mass / 3 * (half @ half - half**2)
    body = builder.add_body(
        xform=(0, 0, half[2] - 1e-3, *UPRIGHT), mass=mass, inertia=np.diag(moments)
    )
    builder.add_shape_box(body, hx=half[0], hy=half[1], hz=half[2], cfg=cfg)
    limit = limit_of(builder.finalize())
    springs, dampers = np.zeros((6, 6)), np.zeros((6, 6))
    for corner in [(x, y, -half[2]) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]:
        j = [np.concatenate([u, np.cross(corner, u)]) for u in np.eye(3)]
        springs += ke * np.outer(j[2], j[2])
        dampers += kd * np.outer(j[2], j[2]) + kf * (np.outer(j[0], j[0]) + np.outer(j[1], j[1]))
    inv = np.diag(1 / np.concatenate([[mass] * 3, moments]))

    def radius(dt):
        v = np.hstack([-dt * inv @ springs, np.eye(6) - dt * inv @ dampers])
        x = np.hstack([np.eye(6), np.zeros((6, 6))]) + dt * v
        return np.abs(np.linalg.eigvals(np.vstack([x, v]))).max()

    # Free directions stay on the unit circle (the plane does not turn or push along them).
    assert radius(0.995 * limit) < 1 + 1e-6
    assert radius(1.005 * limit) > 1 + 1e-3


@pytest.mark.filterwarnings("ignore:SolverSemiImplicit")
@pytest.mark.parametrize("kd", [20.0, 70.0, 200.0])
def test_a_ball_with_a_damper_is_thrown_off_where_a_step_warns(kd):
    """The damper acts on every other step, so that is kd w dt + ke w dt^2 = 4."""
    model = ball(1e4, kd=kd)
    limit, rest = closed_form(1e4 / 2, kd / 2), 0.1 - 2.0 * 9.81 / 1e4
    assert limit > limit_of(model)
    assert np.abs(heights(model, 0.98 * limit, 300) - rest).max() < 2e-3
    assert heights(model, 1.02 * limit, 600).max() > rest + 0.02
    for factor, count in ((0.98, 0), (1.02, 1)):
        assert len(said_of(lambda f=factor: heights(model, f * limit, 1))) == count


def test_contacts_that_have_overflowed_have_no_limit():
    model = stack()
    pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=4)
    contacts, state = pipeline.contacts(), model.state()
    pipeline.collide(state, contacts)
    with pytest.raises(ValueError, match="stable_dt: contacts: expected room for all rows"):
        solvers.SolverSemiImplicit(model).stable_dt(state, contacts)


def test_what_does_not_touch_has_no_limit():
    model = ball(1e4)
    state = model.state()
    state.body_q = np.float32([[0, 0, 0.15, *UPRIGHT]])
    contacts = found(model, state)
    assert contacts.rigid_contact_count.numpy()[0] == 1
    assert solvers.SolverSemiImplicit(model).stable_dt(state, contacts) == np.inf
    with pytest.raises(
        ValueError, match="stable_dt: expected a state and contacts of the solver's"
    ):
        solvers.SolverSemiImplicit(ball(1e4)).stable_dt(state, contacts)


@pytest.mark.parametrize("by_keywords", [False, True])
@pytest.mark.parametrize("kd", [0.0, 400.0])
def test_a_step_warns_once_of_a_dt_that_is_too_long(kd, by_keywords):
    model = ball(1e4, kd=kd)
    limit = closed_form(1e4 / 2, kd / 2)
    contacts, state, after = found(model), model.state(), model.state()
    for factor, expected in ((0.98, 0), (1.02, 1)):
        solver = solvers.SolverSemiImplicit(model)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for _ in range(5):
                if by_keywords:
                    solver.step(state, after, control=None, contacts=contacts, dt=factor * limit)
                else:
                    solver.step(state, after, None, contacts, factor * limit)
        assert [w.category for w in said] == [RuntimeWarning] * expected
        if expected:
            text = str(said[0].message)
            assert "contacts of body 0" in text and "stable_dt" in text


def test_a_warning_that_is_an_error_ends_the_step_before_it_writes():
    model = ball(1e4)
    contacts, state, after = found(model), model.state(), model.state()
    after.body_q = np.full((1, 7), 9.0, np.float32)
    solver = solvers.SolverSemiImplicit(model)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RuntimeWarning, match="dt: 0.1 s is longer than"):
            solver.step(state, after, None, contacts, 0.1)
    assert (after.body_q.numpy() == 9.0).all()


def with_diff(model, **config):
    pytest.importorskip("novaphy.diff")
    return solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**config))


def said_of(run):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run()
    assert all(w.category is RuntimeWarning for w in said)
    return [str(w.message) for w in said]


def test_the_differentiable_solver_has_the_limit_of_the_forward_one():
    model = stack(kd=640.0)
    contacts, state = found(model), model.state()
    limit = solvers.SolverSemiImplicit(model).stable_dt(state, contacts)
    assert with_diff(model).stable_dt(state, contacts) == limit
    with pytest.raises(ValueError, match="DiffSemiImplicitSolver.stable_dt: expected a state and"):
        with_diff(ball(1e4)).stable_dt(state, contacts)


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("how", ["step", "contacts", "pipeline"])
def test_the_differentiable_solver_warns_as_the_forward_one(how, recorded):
    diff, nova = pytest.importorskip("novaphy.diff"), pytest.importorskip("novaphy.nova")
    model = ball(1e4)
    limit = limit_of(model)

    def run(dt):
        solver, contacts = with_diff(model), found(model)
        trajectory = diff.Trajectory(model, 3)

        def steps():
            if how == "step":
                state = model.state()
                for _ in range(3):
                    solver.step(state, model.state(), None, contacts, dt)
            elif how == "contacts":
                solver.rollout(trajectory, None, contacts, dt)
            else:
                pipeline = novaphy.CollisionPipeline(model)
                solver.rollout(trajectory, None, None, dt, pipeline=pipeline)

        if not recorded:
            return steps()
        with nova.Tape():
            return steps()

    assert said_of(lambda: run(0.98 * limit)) == []
    (text,) = said_of(lambda: run(1.02 * limit))
    assert text.startswith("DiffSemiImplicitSolver: dt: ") and "contacts of body 0" in text


def test_a_rollout_is_watched_when_the_ball_has_come_down():
    diff = pytest.importorskip("novaphy.diff")
    model = ball(1e4)
    model.body_q.fill_(0)
    model.body_q[:] = [(0, 0, 0.1 + 1e-4, *UPRIGHT)]
    pipeline = novaphy.CollisionPipeline(model)
    assert pipeline.contacts().rigid_contact_max > 0
    trajectory = diff.Trajectory(model, 8)
    run = with_diff(model).rollout
    (text,) = said_of(lambda: run(trajectory, None, None, 0.05, pipeline=pipeline))
    assert "dt: 0.05 s is longer than" in text


@pytest.mark.parametrize("kd", [0.0, 400.0])
def test_static_contacts_warn_of_what_one_row_cannot_bear(kd):
    diff = pytest.importorskip("novaphy.diff")
    model = ball(1e4, kd=kd)
    limit = closed_form(1e4 / 2, kd / 2)
    for factor, count in ((0.98, 0), (1.02, 1)):
        solver = with_diff(model, enable_static_contacts=True)
        trajectory = diff.Trajectory(model, 3)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(2):
                solver.rollout(trajectory, None, None, factor * limit)
        assert len(caught) == count and all("body 0" in str(w.message) for w in caught)


def test_static_contacts_are_looked_at_again_when_materials_were_written():
    diff = pytest.importorskip("novaphy.diff")
    model = ball(1e4)
    solver = with_diff(model, enable_static_contacts=True)
    trajectory, dt = diff.Trajectory(model, 2), 0.9 * closed_form(1e4 / 2, 0)

    def run():
        solver.rollout(trajectory, None, None, dt)

    assert said_of(run) == []
    model.shape_material_ke.fill_(2e4)
    assert len(said_of(run)) == 1


@pytest.mark.parametrize("solver", ["SolverSemiImplicit", "DiffSemiImplicitSolver"])
def test_a_body_without_a_finite_pose_is_named_once(solver):
    model = ball(1e4)
    state, after = model.state(), model.state()
    state.body_q = np.float32([[np.nan, 0, 0, *UPRIGHT]])
    contacts = found(model, state)
    assert contacts.rigid_contact_count.numpy()[0] == 0
    stepper = with_diff(model) if solver.startswith("Diff") else getattr(solvers, solver)(model)
    said = said_of(lambda: [stepper.step(state, after, None, contacts, 1e-3) for _ in range(4)])
    assert len(said) == 1 and "body_q[0]: expected finite numbers" in said[0]


def test_a_capture_says_nothing():
    diff, nova = pytest.importorskip("novaphy.diff"), pytest.importorskip("novaphy.nova")
    model = ball(1e4)
    solver, contacts, trajectory = with_diff(model), found(model), diff.Trajectory(model, 3)

    def capture():
        with nova.ScopedCapture() as graph:
            solver.rollout(trajectory, None, contacts, 0.1)
        return graph

    assert said_of(capture) == []


EDGES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0)


def drop(edge, height, solver_of, dt, seconds=1.5):
    """A cube of default density and material falls on the ground: how it ends, what is said."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, edge / 2 + height), UPRIGHT))
    builder.add_shape_box(body, hx=edge / 2, hy=edge / 2, hz=edge / 2)
    model = builder.finalize()
    pipeline, solver = novaphy.CollisionPipeline(model), solver_of(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()

    def run():
        now, then = state, after
        for _ in range(int(seconds / dt)):
            pipeline.collide(now, contacts)
            solver.step(now, then, None, contacts, dt)
            now, then = then, now
        return now.body_q.numpy()[0, 2], np.abs(now.body_qd.numpy()).max()

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        return *run(), [str(w.message) for w in said]


@pytest.mark.parametrize("height", [0.0, 0.02, 0.3])
@pytest.mark.parametrize("edge", EDGES)
def test_a_cube_of_any_size_lies_or_a_step_says_why_not(edge, height):
    z, speed, said = drop(edge, height, solvers.SolverSemiImplicit, 1 / 960)
    lies = abs(z - edge / 2) < 0.1 * edge and speed < 0.05
    assert lies or any("ke" in text for text in said)
    if 0.1 <= edge <= 0.3:
        assert lies


@pytest.mark.parametrize("edge", EDGES)
def test_with_solver_featherstone_a_cube_of_any_size_lies(edge):
    z, speed, said = drop(edge, 0.1, solvers.SolverFeatherstone, 1 / 240)
    assert not said
    assert z == pytest.approx(edge / 2, abs=2e-3) and speed < 1e-3


def test_friction_that_shakes_is_said():
    """2 dt kf Minv = 4 is the limit, with 1/m + r^2/I of the point that touches."""
    for factor, count in ((0.95, 0), (1.05, 1)):
        model = ball(1e5, kf=factor * 2.0 / (1 / 960 * (1 / 2.0 + 1 / (0.4 * 2.0))))
        assert len(said_of(lambda m=model: heights(m, 1 / 960, 2))) == count


def test_what_rests_too_deep_is_said():
    """A ball of 0.1 m: its radius of gyration is 0.063 m."""
    for ke, count in ((2.0 * 9.81 / 0.012, 0), (2.0 * 9.81 / 0.02, 1)):
        said = said_of(lambda k=ke: heights(ball(k), 1 / 960, 2000))
        assert len(said) == count
        assert all("rests" in text and "SolverFeatherstone" in text for text in said)


@pytest.mark.parametrize("edge", [2.0, 5.0])
def test_a_cube_that_its_springs_cannot_carry_is_named_at_its_first_contact(edge):
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, edge / 2), UPRIGHT))
    builder.add_shape_box(body, hx=edge / 2, hy=edge / 2, hz=edge / 2)
    model = builder.finalize()
    with pytest.warns(RuntimeWarning, match=r"body 0 sinks: springs of ke 2500 N/m carry its"):
        z = heights(model, 1 / 960, 16)
    assert z.min() > edge / 2 - 0.01
