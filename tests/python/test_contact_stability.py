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
    return solver.stable_dt(model.state(), contacts or found(model))


def stack(**material):
    """Ten cubes of 8 kg with a side of 0.2 m that overlap a little."""
    cfg = novaphy.ShapeConfig(**({"ke": 0.0, "kd": 0.0, "kf": 0.0} | material))
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    for k in range(10):
        cube = builder.add_body(xform=(0, 0, 0.0999 + 0.1999 * k, *UPRIGHT))
        builder.add_shape_box(cube, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    return builder.finalize()


# Neighbours in antiphase, eight corners each: 2 dt sum k r^2/I = 2, of springs 2 dt^2 sum ke r^2/I
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


def test_each_coefficient_has_its_limit_and_the_least_holds():
    mobile = 1 / 2.0 + 0.01 / (0.4 * 2.0 * 0.01)  # of the point that touches, along the ground
    assert limit_of(ball(1e2, kf=500.0)) == pytest.approx(2 / (500.0 * mobile), rel=1e-2)
    assert limit_of(ball(1e2, kd=800.0)) == pytest.approx(2 / (800.0 / 2.0), rel=1e-5)
    assert limit_of(ball(1e2, kd=800.0, kf=500.0)) == pytest.approx(2 / (500.0 * mobile), rel=1e-2)
    model = ball(1e4)
    contacts = found(model)
    contacts.rigid_contact_stiffness.fill_(4e4)
    assert limit_of(model, contacts) == pytest.approx(np.sqrt(2.0 / 1e4), rel=1e-5)


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
@pytest.mark.parametrize(("material", "what"), [({}, "springs"), ({"kd": 400.0}, "dampers")])
def test_a_step_warns_once_of_a_dt_that_is_too_long(material, what, by_keywords):
    model = ball(1e4, **material)
    limit = limit_of(model)
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
            assert what in text and "body 0" in text and "stable_dt" in text


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
    assert (
        text.startswith("DiffSemiImplicitSolver: dt: ") and "springs" in text and "body 0" in text
    )


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


@pytest.mark.parametrize(("material", "what"), [({}, "springs"), ({"kd": 400.0}, "dampers")])
def test_static_contacts_warn_of_what_one_row_cannot_bear(material, what):
    diff = pytest.importorskip("novaphy.diff")
    model = ball(1e4, **material)
    limit = limit_of(model)
    for factor, count in ((0.98, 0), (1.02, 1)):
        solver = with_diff(model, enable_static_contacts=True)
        trajectory = diff.Trajectory(model, 3)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(2):
                solver.rollout(trajectory, None, None, factor * limit)
        said = [str(w.message) for w in caught]
        assert len(said) == count and all(what in text for text in said)


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
