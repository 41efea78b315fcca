"""Bodies that sleep: what keeps its bits, what wakes it, and that nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import nova
from novaphy.solvers import SolverFeatherstone, SolverSemiImplicit
from novaphy.testing import assert_same_bits

KINDS = {"semi-implicit": (SolverSemiImplicit, 1e-3), "featherstone": (SolverFeatherstone, 1 / 240)}
HALF = 0.1
SLEEP = novaphy.SleepConfig(speed=0.02, spin=0.2, after=0.1)
SURFACE = novaphy.ShapeConfig(ke=2e4, kd=200.0, kf=200.0, mu=0.5, gap=0.005)


class Run:
    """Towers of boxes that start where their contacts carry them, stepped with the search."""

    def __init__(
        self, towers, kind="semi-implicit", sleep=SLEEP, phase="sap", worlds=1, floor=False, high=3
    ):
        make, self.dt = KINDS[kind]
        self.in_joints = kind == "featherstone"
        one = novaphy.ModelBuilder()
        weight = 0.0 if self.in_joints else SURFACE.density * (2 * HALF) ** 3 * 9.81
        self.boxes = {}
        for name, (x, y) in towers.items():
            z = 0.0
            for k in range(high):
                z += 2 * HALF if k else HALF
                z -= weight * (high - k) / (4 * SURFACE.ke)
                body = one.add_body(xform=(x, y, z, 0.0, 0.0, 0.0, 1.0))
                one.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=SURFACE)
                self.boxes.setdefault(name, []).append(body)
        if floor:
            self.floor = one.add_body(xform=(0.0, 0.0, -0.5, 0, 0, 0, 1), is_kinematic=True)
            one.add_shape_box(self.floor, hx=1.5, hy=1.5, hz=0.5, cfg=SURFACE)
        self.ball = one.add_body(xform=(0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 1.0))
        one.add_shape_sphere(self.ball, radius=HALF, cfg=SURFACE)
        builder = novaphy.ModelBuilder()
        if not floor:
            builder.add_ground_plane(cfg=SURFACE)
        if worlds > 1:
            builder.replicate(one, worlds)
        else:
            builder.add_builder(one)
        self.model = builder.finalize()
        self.pipeline = novaphy.CollisionPipeline(
            self.model, broad_phase=phase, rigid_contact_max=4000
        )
        self.solver = make(self.model, sleep=sleep)
        self.contacts = self.pipeline.contacts()
        self.now, self.then = self.model.state(), self.model.state()

    def step(self, count=1, control=None):
        for _ in range(count):
            self.pipeline.collide(self.now, self.contacts, dt=self.dt)
            self.solver.step(self.now, self.then, control, self.contacts, self.dt)
            self.then.body_f.assign(self.now.body_f.numpy())
            self.now, self.then = self.then, self.now

    def settle(self):
        self.step(round(0.7 / self.dt))
        assert all(self.sleeps(name) for name in self.boxes)
        return self

    def sleeps(self, name):
        marks = self.now.body_sleep.numpy()[self.boxes[name], 0] < 0
        assert marks.all() or not marks.any(), "an island sleeps as a whole"
        return bool(marks.all())

    def bits(self, name):
        rows = self.boxes[name]
        return self.now.body_q.numpy()[rows], self.now.body_qd.numpy()[rows]

    def put(self, field, row, values):
        rows = getattr(self.now, field).numpy()
        rows[row] = values
        getattr(self.now, field).assign(rows)
        if self.in_joints:
            novaphy.eval_ik(self.model, self.now, self.now.joint_q, self.now.joint_qd)


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def test_a_tower_that_sleeps_keeps_its_bits(kind):
    run = Run({"tower": (0.0, 0.0)}, kind).settle()
    q, qd = run.bits("tower")
    assert not qd.any()
    run.step(50)
    for mine, theirs in zip(run.bits("tower"), (q, qd), strict=True):
        assert_same_bits(mine, theirs)
    assert run.contacts.active_rigid_contact_count == 0, "nothing near what moves"


def test_without_sleep_the_state_says_so(kind):
    run = Run({"tower": (0.0, 0.0)}, kind, sleep=None)
    run.step(round(0.7 / run.dt))
    assert run.solver.sleep is None and not run.now.body_sleep.numpy().any()


def launch(run, at, velocity):
    run.put("body_q", run.ball, [*at, 0.0, 0.0, 0.0, 1.0])
    run.put("body_qd", run.ball, [*velocity, 0.0, 0.0, 0.0])


def test_only_what_a_ball_strikes_wakes_and_it_does_in_that_step(kind):
    run = Run({"near": (0.0, 0.0), "far": (2.0, 0.0)}, kind).settle()
    near, far = run.bits("near"), run.bits("far")
    launch(run, (-2 * HALF - 0.03, 0.0, 3 * HALF), (3.0, 0.0, 0.0))
    for _ in range(40):
        before = run.now.body_qd.numpy()[run.ball, 0]
        run.step()
        if run.now.body_qd.numpy()[run.ball, 0] < before - 0.01:
            break
        assert run.sleeps("near"), "a ball that flies past wakes nothing"
        for mine, theirs in zip(run.bits("near"), near, strict=True):
            assert_same_bits(mine, theirs)
    assert not run.sleeps("near") and run.bits("near")[1][1, 0] > 0.0
    run.step(30)
    for mine, theirs in zip(run.bits("far"), far, strict=True):
        assert_same_bits(mine, theirs)


def momentum(run):
    model = run.model
    return (model.body_mass.numpy()[:, None] * run.now.body_qd.numpy()[:, :3]).sum(axis=0)


def test_a_ball_gives_a_sleeping_tower_the_momentum_that_it_gives_one_awake(kind):
    runs = [Run({"tower": (0.0, 0.0)}, kind, sleep=sleep) for sleep in (SLEEP, None)]
    for run in runs:
        run.step(round(0.7 / run.dt))
    assert runs[0].sleeps("tower")
    for run in runs:
        launch(run, (-2 * HALF - 0.02, 0.0, 3 * HALF), (3.0, 0.0, 0.0))
        run.step(round(0.04 / run.dt))
    asleep, awake = (run.now.body_qd.numpy() for run in runs)
    assert abs(awake[runs[0].ball, 0]) < 2.5, "the ball struck"
    np.testing.assert_allclose(momentum(runs[0]), momentum(runs[1]), atol=0.05)
    np.testing.assert_allclose(asleep, awake, atol=0.03)


CAUSES = {
    "a force acts": lambda run, box: run.put("body_f", box, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]),
    "its velocity is written": lambda run, box: run.put("body_qd", box, [0.1, 0, 0, 0, 0, 0]),
    "its pose is written": lambda run, box: run.put("body_q", box, [0.3, 0, 0.7, 0, 0, 0, 1]),
    "gravity is written": lambda run, box: run.model.gravity.assign(
        run.model.gravity.numpy() + np.float32(0.01)
    ),
    "a mass is written": lambda run, box: run.model.body_mass.assign(run.model.body_mass.numpy()),
    "a material is written": lambda run, box: run.model.shape_material_mu.assign(
        run.model.shape_material_mu.numpy() * np.float32(0.5)
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("phase", ["sap", "nxn"])
def test_a_tower_wakes_when(cause, phase, kind):
    run = Run({"tower": (0.0, 0.0), "far": (2.0, 0.0)}, kind, phase=phase).settle()
    far = run.bits("far")
    CAUSES[cause](run, run.boxes["tower"][2])
    run.step()
    assert not run.sleeps("tower")
    assert run.sleeps("far") == cause.startswith(("a force", "its"))
    if run.sleeps("far"):
        for mine, theirs in zip(run.bits("far"), far, strict=True):
            assert_same_bits(mine, theirs)


def test_what_lay_on_a_box_that_was_taken_away_falls(kind):
    run = Run({"tower": (0.0, 0.0)}, kind).settle()
    top = run.boxes["tower"][2]
    height = run.now.body_q.numpy()[top, 2]
    run.put("body_q", run.boxes["tower"][1], [5.0, 0.0, HALF, 0.0, 0.0, 0.0, 1.0])
    run.step(round(0.1 / run.dt))
    assert run.now.body_q.numpy()[top, 2] < height - 0.04


@pytest.mark.parametrize("how", ["moves", "is put elsewhere"])
def test_a_tower_wakes_when_the_floor_under_it(how, kind):
    run = Run({"tower": (0.0, 0.0)}, kind, floor=True).settle()
    if how == "moves":
        run.put("body_qd", run.floor, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    else:
        run.put("body_q", run.floor, [0.0, 0.0, -5.0, 0.0, 0.0, 0.0, 1.0])
    height = run.bits("tower")[0][2, 2]
    run.step()
    assert not run.sleeps("tower")
    run.step(round(0.06 / run.dt))
    q, qd = run.bits("tower")
    assert qd[0, 0] > 0.1 if how == "moves" else q[2, 2] < height - 0.01


def test_a_joint_force_of_the_control_wakes_a_body(kind):
    make, dt = KINDS[kind]
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=SURFACE)
    body = builder.add_link(xform=(0.0, 0.0, HALF - 0.001, 0.0, 0.0, 0.0, 1.0))
    builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=SURFACE)
    builder.add_articulation([builder.add_joint_free(body)])
    model = builder.finalize()
    solver = make(model, sleep=SLEEP)
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap")
    contacts, control = pipeline.contacts(), model.control()
    now, then = model.state(), model.state()
    for _ in range(700):
        pipeline.collide(now, contacts)
        solver.step(now, then, control, contacts, dt)
        now, then = then, now
    assert now.body_sleep.numpy()[0, 0] < 0
    mass = float(model.body_mass.numpy()[0])
    control.joint_f.assign(np.array([0, 0, 20.0 * mass, 0, 0, 0], dtype=np.float32))
    pipeline.collide(now, contacts)
    solver.step(now, then, control, contacts, dt)
    assert then.body_sleep.numpy()[0, 0] >= 0
    push = 20.0 if kind == "semi-implicit" else 20.0 - 9.81
    np.testing.assert_allclose(then.body_qd.numpy()[0, 2], push * dt, rtol=1e-5)


@pytest.fixture
def threads():
    before = novaphy.num_threads()
    yield novaphy.set_num_threads
    novaphy.set_num_threads(before)


def test_the_broad_phase_and_the_threads_change_no_bit(threads, kind):
    results = []
    for phase, count in (("sap", 1), ("sap", 2), ("nxn", 1), ("explicit", 1)):
        threads(count)
        towers = {"a": (0.0, 0.0), "b": (0.5, 0.3), "c": (2.0, 0.0)}
        run = Run(towers, kind, phase=phase).settle()
        launch(run, (-2 * HALF - 0.03, 0.0, 3 * HALF), (3.0, 0.5, 0.0))
        run.step(round(0.3 / run.dt))
        results.append([f.numpy() for f in (run.now.body_q, run.now.body_qd, run.now.body_sleep)])
    for other in results[1:]:
        for mine, theirs in zip(results[0], other, strict=True):
            assert_same_bits(mine, theirs)


def test_a_clone_and_a_solver_of_its_own_sleep_on(kind):
    run = Run({"tower": (0.0, 0.0), "far": (2.0, 0.0)}, kind).settle()
    launch(run, (-2 * HALF - 0.5, 0.0, 3 * HALF), (3.0, 0.0, 0.0))
    run.step(2)
    now, then = run.now.clone(), run.model.state()
    pipeline = novaphy.CollisionPipeline(run.model, broad_phase="sap", rigid_contact_max=4000)
    solver, contacts = type(run.solver)(run.model, sleep=SLEEP), pipeline.contacts()
    for _ in range(round(0.3 / run.dt)):
        run.step()
        pipeline.collide(now, contacts, dt=run.dt)
        solver.step(now, then, None, contacts, run.dt)
        now, then = then, now
    for name in ("body_q", "body_qd", "body_sleep"):
        assert_same_bits(getattr(now, name).numpy(), getattr(run.now, name).numpy())
    assert run.sleeps("far") and not run.sleeps("tower")


def test_one_state_for_both_sides_of_a_step_sleeps_too(kind):
    run, other = (Run({"tower": (0.0, 0.0)}, kind) for _ in range(2))
    state = run.model.state()
    for _ in range(round(0.7 / run.dt)):
        run.pipeline.collide(state, run.contacts, dt=run.dt)
        run.solver.step(state, state, None, run.contacts, run.dt)
    other.settle()
    assert (state.body_sleep.numpy()[other.boxes["tower"], 0] < 0).all()
    assert_same_bits(state.body_q.numpy(), other.now.body_q.numpy())


def test_worlds_that_are_reset_wake_and_others_sleep_on(kind):
    run = Run({"tower": (0.0, 0.0)}, kind, worlds=4).settle()
    bodies = run.model.body_count // 4
    start, q = run.model.state().body_q.numpy(), run.now.body_q.numpy()
    before = q.copy()
    q[bodies : 2 * bodies] = start[bodies : 2 * bodies] + np.float32([0, 0, 0.01, 0, 0, 0, 0])
    run.put("body_q", slice(None), q)
    run.step(20)
    asleep = run.now.body_sleep.numpy()[:, 0].reshape(4, bodies)[:, :3] < 0
    assert asleep.all(axis=1).tolist() == [True, False, True, True]
    after = run.now.body_q.numpy().reshape(4, bodies, 7)[[0, 2, 3], :3]
    assert_same_bits(after, before.reshape(4, bodies, 7)[[0, 2, 3], :3])


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"speed": np.nan}, r"sleep\.speed: expected a finite number >= 0, got nan"),
        ({"spin": -0.1}, r"sleep\.spin: expected a finite number >= 0, got -0\.1"),
        ({"speed": np.inf}, r"sleep\.speed: expected a finite number >= 0, got inf"),
        ({"after": 0.0}, r"sleep\.after: expected a finite number > 0 and at most 1000 s, got 0"),
        ({"after": np.nan}, r"sleep\.after: expected a finite number > 0"),
        ({"after": 1e4}, r"sleep\.after: expected a finite number > 0 and at most 1000 s"),
    ],
)
def test_bad_numbers_are_refused_by_name(values, match):
    with pytest.raises(ValueError, match=match):
        novaphy.SleepConfig(**values)


def test_a_config_says_what_it_is():
    assert repr(novaphy.SleepConfig()) == "SleepConfig(speed=0.01, spin=0.05, after=0.5)"
    assert novaphy.SleepConfig(after=1.0) == novaphy.SleepConfig(after=1.0) != SLEEP


def test_a_tape_refuses_sleep_by_name(kind):
    run = Run({"tower": (0.0, 0.0)}, kind)
    with nova.Tape(), pytest.raises(novaphy.Error, match="on an active Tape: sleep"):
        run.solver.step(run.now, run.then, None, None, run.dt)


def test_contacts_by_penalty_refuse_sleep_in_joints():
    model = Run({"tower": (0.0, 0.0)}).model
    with pytest.raises(NotImplementedError, match='sleep: expected None with contact "penalty"'):
        SolverFeatherstone(model, contact="penalty", sleep=SLEEP)


def test_a_body_with_a_pose_that_is_no_number_never_sleeps():
    run = Run({"tower": (0.0, 0.0), "far": (2.0, 0.0)}).settle()
    run.put("body_q", run.ball, np.full(7, np.nan))
    run.step(200)
    assert run.sleeps("tower") and run.now.body_sleep.numpy()[run.ball, 0] >= 0
