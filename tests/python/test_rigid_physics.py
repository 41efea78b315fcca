"""Rigid bodies against closed forms, and what their contacts keep from step to step."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import diff, solvers
from novaphy.testing import assert_same_bits

DT = 1 / 960
SURFACE = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=0.5)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Run:
    """Steps of a model with contacts that are found in each."""

    def __init__(self, model, dt=DT, **options):
        self.model, self.dt = model, dt
        pipeline = options.pop("pipeline", {})
        self.pipeline = novaphy.CollisionPipeline(model, **pipeline)
        self.solver = solvers.SolverSemiImplicit(model, **options)
        self.contacts = self.pipeline.contacts()
        self.state, self.after = model.state(), model.state()

    def steps(self, count):
        for _ in range(count):
            self.pipeline.collide(self.state, self.contacts)
            self.solver.step(self.state, self.after, None, self.contacts, self.dt)
            self.state, self.after = self.after, self.state
            yield self

    def go(self, count):
        for _ in self.steps(count):
            pass
        return self

    def features(self):
        rows = self.contacts.rigid_contacts()
        return {tuple(int(row[n]) for n in ("shape0", "shape1", "point_id")) for row in rows}


@pytest.mark.parametrize("kd", [0.0, 60.0, 200.0])
def test_a_ball_bounces_as_the_spring_with_a_one_sided_damper(kd):
    """In: a damped oscillator up to the deepest point. Out: the spring alone."""
    cfg = novaphy.ShapeConfig(density=0.0, ke=1e4, kd=kd, kf=0.0, mu=0.0)
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    builder.add_ground_plane(cfg=cfg)
    mass, speed = 2.0, 1.0
    ball = builder.add_body(xform=(0, 0, 0.1, *UPRIGHT), mass=mass, inertia=np.eye(3) * 0.01)
    builder.add_shape_sphere(ball, radius=0.1, cfg=cfg)
    builder.body_qd[ball] = (0, 0, -speed, 0, 0, 0)
    run, heights = Run(builder.finalize(), dt=1e-5), []
    for now in run.steps(6000):
        heights.append(float(now.state.body_q.numpy()[0, 2]))
    omega, zeta = np.sqrt(1e4 / mass), kd / (2 * np.sqrt(1e4 * mass))
    root = np.sqrt(1 - zeta**2)
    loss = np.exp(-zeta / root * np.arctan2(root, zeta))
    assert 0.1 - min(heights) == pytest.approx(speed / omega * loss, rel=5e-3)
    assert run.state.body_qd.numpy()[0, 2] == pytest.approx(speed * loss, rel=5e-3)


def test_a_conveyor_carries_a_box():
    """A kinematic belt moves, and friction brings what lies on it to its speed."""
    builder = novaphy.ModelBuilder()
    belt = builder.add_body(xform=(0, 0, -0.1, *UPRIGHT), is_kinematic=True)
    builder.add_shape_box(belt, hx=3, hy=0.5, hz=0.1, cfg=SURFACE)
    builder.body_qd[belt] = (0.5, 0, 0, 0, 0, 0)
    box = builder.add_body(xform=(0, 0, 0.099, *UPRIGHT))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    run = Run(builder.finalize())
    start = run.go(30).state.body_qd.numpy()[1, 0]
    assert 0.0 < start < 0.5, "it is dragged along by mu g"
    run.go(960)
    q, qd = run.state.body_q.numpy(), run.state.body_qd.numpy()
    assert qd[0, 0] == np.float32(0.5) and qd[1, 0] == pytest.approx(0.5, abs=1e-4)
    assert q[0, 0] == pytest.approx(990 * DT * 0.5, rel=1e-4)


def test_a_compound_rests_on_all_its_shapes_whatever_its_centre_of_mass():
    """Two boxes of a body, one of which is heavy: each corner carries its share."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=SURFACE)
    body = builder.add_body(xform=(0, 0, 0.1, *UPRIGHT))
    for x, density in ((-0.3, 1000.0), (0.3, 3000.0)):
        cfg = novaphy.ShapeConfig(density=density, ke=1e4, kd=300.0, kf=500.0, mu=0.5)
        builder.add_shape_box(body, xform=((x, 0, 0), UPRIGHT), hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    run = Run(builder.finalize()).go(3000)
    assert run.model.body_com.numpy()[0, 0] == pytest.approx(0.15)
    rows = run.contacts.rigid_contacts()
    assert len(rows) == 8
    assert rows["force"][:, 2].sum() == pytest.approx(32 * 9.81, rel=1e-3)
    turn = (rows["point1"][:, 0] - 0.15) @ rows["force"][:, 2]
    assert abs(turn) < 1e-2 * 32 * 9.81 * 0.3, "no moment about the center of mass"
    heavy = rows["point1"][:, 0] > 0
    assert rows["force"][heavy, 2].sum() > rows["force"][~heavy, 2].sum() * 1.5


def test_a_thousand_worlds_in_one_place_equal_one():
    one = novaphy.ModelBuilder()
    one.add_ground_plane(cfg=SURFACE)
    for x in (0.0, 0.21):
        die = one.add_body(xform=(x, 0, 0.12, *UPRIGHT))
        one.add_shape_box(die, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
        one.body_qd[die] = (0.3 - x, 0.1, 0, 1, 5, 2)
    worlds = novaphy.ModelBuilder()
    worlds.replicate(one, 1000)
    alone, all_ = Run(one.finalize()).go(60), Run(worlds.finalize()).go(60)
    for name in ("body_q", "body_qd"):
        expected = getattr(alone.state, name).numpy()
        assert_same_bits(getattr(all_.state, name).numpy(), np.tile(expected, (1000, 1)))


@pytest.mark.parametrize("shape", ["box", "convex_hull"])
def test_names_of_points_stay_while_a_box_slides(shape):
    """On a box of which it leaves the edge, 95 % of the names are those of the step before."""
    builder = novaphy.ModelBuilder()
    table = builder.add_body(xform=(0, 0, -0.5, *UPRIGHT), is_kinematic=True)
    smooth = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=0.0, mu=0.0)
    builder.add_shape_box(table, hx=0.5, hy=0.5, hz=0.5, cfg=smooth)
    angle = 0.3
    turned = (0, 0, np.sin(angle / 2), np.cos(angle / 2))
    box = builder.add_body(xform=(-0.2, 0, 0.0975, *turned))
    if shape == "box":
        builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=smooth)
    else:
        signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        builder.add_shape_convex_hull(box, vertices=0.1 * np.float32(signs), cfg=smooth)
    builder.body_qd[box] = (0.6, 0, 0, 0, 0, 0)
    run = Run(builder.finalize())
    before, kept, all_ = set(), 0, 0
    for now in run.steps(960):
        names = now.features()
        assert len(names) == len(now.contacts.rigid_contacts()) >= 3, "each name once"
        kept, all_, before = kept + len(names & before), all_ + len(names), names
    assert run.state.body_q.numpy()[1, 0] > 0.35
    assert kept > 0.95 * all_


@pytest.mark.parametrize(
    ("turn", "per_pair"), [(0.0, 4), (0.0, 8), (0.3, 8)], ids=["aligned-4", "aligned-8", "turned-8"]
)
def test_the_contacts_of_a_stack_that_rests_do_not_flicker(turn, per_pair):
    """Every step of half a second has the same points, and each bears the same force."""
    cfg = novaphy.ShapeConfig(ke=2e5, kd=300.0, kf=200.0, mu=0.5, gap=0.02)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    for k in range(4):
        half = 0.5 * turn * (k % 2)
        pose = (0, 0, 0.1 + 0.2 * k, 0, 0, np.sin(half), np.cos(half))
        builder.add_shape_box(builder.add_body(xform=pose), hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    run = Run(builder.finalize(), pipeline={"contacts_per_pair": per_pair}).go(3000)
    names = run.features()
    assert len(names) == 4 + 3 * (4 if turn == 0.0 else per_pair)
    forces = run.contacts.rigid_contacts()["force"]
    for now in run.steps(480):
        assert now.features() == names
        np.testing.assert_allclose(
            now.contacts.rigid_contacts()["force"], forces, atol=0.02 * np.abs(forces).max()
        )


def test_bodies_spawned_in_one_point_part_with_finite_numbers():
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    for k in range(150):
        body = builder.add_body(xform=(0, 0, 1, *UPRIGHT))
        if k % 2:
            builder.add_shape_sphere(body, radius=0.1, cfg=SURFACE)
        else:
            builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    model = builder.finalize()
    run = Run(model, pipeline={"broad_phase": "sap"})
    with pytest.warns(RuntimeWarning, match="contacts of body"):
        run.go(1)
    count = run.contacts.rigid_contact_count.numpy()[0]
    assert count >= 150 * 149 / 2 and run.contacts.overflowed == (
        count > run.contacts.rigid_contact_max
    )
    run.go(200)
    assert np.isfinite(run.state.body_q.numpy()).all()
    assert np.isfinite(run.state.body_qd.numpy()).all()


BAD_EDITS = [
    ("body_mass", 1, np.nan, r"body_mass\[1\]: expected a finite number > 0 of a dyn.*, got nan"),
    ("body_mass", 0, -1.0, r"body_mass\[0\]"),
    ("body_mass", 0, 0.0, r"body_mass\[0\]"),
    ("body_inertia", 1, np.inf, r"body_inertia\[1\]"),
    ("body_com", 0, np.nan, r"body_com\[0\]: expected finite numbers"),
    ("shape_material_ke", 2, np.nan, r"shape_material_ke\[2\]: expected a finite number >= 0"),
    ("shape_material_kd", 1, -1.0, r"shape_material_kd\[1\]"),
    ("shape_material_kf", 1, -1.0, r"shape_material_kf\[1\]"),
    ("shape_material_ka", 1, np.nan, r"shape_material_ka\[1\]"),
    ("shape_material_mu", 0, -0.5, r"shape_material_mu\[0\].*got -0.5"),
    ("shape_gap", 1, -0.5, r"shape_gap\[1\]"),
    ("shape_margin", 1, np.inf, r"shape_margin\[1\]: expected a finite number, got inf"),
]


@pytest.mark.parametrize("solver", ["SolverSemiImplicit", "DiffSemiImplicitSolver"])
@pytest.mark.parametrize(("array", "row", "value", "message"), BAD_EDITS)
def test_a_bad_number_that_is_written_to_the_model_is_named(solver, array, row, value, message):
    """Before anything is written, and the model works again when it is mended."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=SURFACE)
    for k in range(2):
        body = builder.add_body(xform=(k, 0, 0.1, *UPRIGHT))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    pipeline.collide(state, contacts)
    step = getattr(solvers, solver)(model).step
    good = getattr(model, array).numpy()
    bad = good.copy()
    bad[row] = value
    setattr(model, array, bad)
    after.body_q = np.full((2, 7), 9.0, np.float32)
    with pytest.raises(ValueError, match=f"{solver}: model.{message}"):
        step(state, after, None, contacts, DT)
    assert (after.body_q.numpy() == 9.0).all()
    setattr(model, array, good)
    step(state, after, None, contacts, DT)
    assert np.isfinite(after.body_q.numpy()).all() and not (after.body_q.numpy() == 9.0).any()


def on_slope(angle, **options):
    """A box at rest on a plane that falls along x."""
    turn = (0, np.sin(angle / 2), 0, np.cos(angle / 2))
    builder = novaphy.ModelBuilder()
    builder.add_shape_plane(xform=((0, 0, 0), turn), width=0, length=0, cfg=SURFACE)
    up = np.float64([np.sin(angle), 0, np.cos(angle)])
    depth = 32.0 * 9.81 * np.cos(angle) / (4 * 1e4)  # at which the ground bears it
    box = builder.add_body(xform=(*((0.1 - depth) * up), *turn))
    builder.add_shape_box(box, hx=0.2, hy=0.2, hz=0.1, cfg=SURFACE)
    return Run(builder.finalize(), **options)


def along(run, angle):
    q, qd = run.state.body_q.numpy()[0], run.state.body_qd.numpy()[0]
    down = np.float64([np.cos(angle), 0, -np.sin(angle)])
    return q[:3] @ down, qd[:3] @ down


def test_with_a_stick_spring_a_box_below_the_cone_rests():
    """Where the law alone creeps; above the cone it slides as without."""
    load = 32.0 * 9.81 * np.sin(0.2)
    run = on_slope(0.2, stick_ke=1e5).go(2000)
    place, speed = along(run, 0.2)
    assert abs(speed) < 1e-6 and load / (4 * 1e5) <= place < 1e-3
    assert along(run.go(2000), 0.2)[0] == pytest.approx(place, abs=1e-6)
    uphill = np.float64([-np.cos(0.2), 0, np.sin(0.2)])
    assert (run.contacts.rigid_contacts()["force"] @ uphill).sum() == pytest.approx(load, rel=1e-3)
    creeping = on_slope(0.2).go(2000)
    assert along(creeping, 0.2)[1] == pytest.approx(load / (4 * 500), rel=0.01)
    run, before = on_slope(0.7, stick_ke=1e5), on_slope(0.7)
    speeds = [along(r.go(480), 0.7)[1] for r in (run, before)]
    assert speeds[0] == pytest.approx(speeds[1], rel=2e-2)


@pytest.mark.parametrize("kf", [100.0, 1000.0])
@pytest.mark.parametrize("stick_ke", [0.0, 100.0, 2e3, 1e5])
def test_a_stick_spring_takes_no_friction_from_what_slides(stick_ke, kf):
    """The law of Coulomb, v^2/(2 mu g), whatever the spring and the damper are."""
    surface = novaphy.ShapeConfig(mu=0.3, kf=kf)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=(0, 0, 0.0922, *UPRIGHT))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    builder.body_qd[body] = (2, 0, 0, 0, 0, 0)
    run = Run(builder.finalize(), stick_ke=stick_ke)
    farthest = max(float(now.state.body_q.numpy()[0, 0]) for now in run.steps(960))
    assert farthest == pytest.approx(2.0**2 / (2 * 0.3 * 9.81), rel=0.02)


def grazing(law, balls=2, **cfg):
    """Balls that spin and graze each other in a row; how much their angular momentum changes."""
    surface = novaphy.ShapeConfig(**({"ke": 2e4, "kd": 0.0, "kf": 20.0, "mu": 0.5} | cfg))
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    for k in range(balls):
        side = 1 - 2 * (k % 2)
        x = 0.3 * (k - (balls - 1) / 2) * 2
        body = builder.add_body(xform=((x, 0.06 * side, 0.01 * k), UPRIGHT))
        builder.add_shape_sphere(body, radius=0.1, cfg=surface)
        builder.body_qd[body] = (-2 * np.sign(x), 0, 0, 3 * side, 5, 30)
    model = builder.finalize()
    run = Run(model, dt=1 / 2000, friction_law=law, angular_damping=0.0)
    mass = model.body_mass.numpy().astype(float)[:, None]
    inertia = model.body_inertia.numpy()[0, 0, 0].astype(float)

    def parts(state):
        q, v = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
        return mass * np.cross(q[:, :3], v[:, :3]) + inertia * v[:, 3:]

    before = parts(run.state)
    moved = run.go(800)
    assert np.abs(moved.state.body_qd.numpy()[:, 1]).max() > 0.1, "they have met"
    return np.abs((parts(moved.state) - before).sum(axis=0)).max() / np.abs(before).sum()


@pytest.mark.parametrize("cfg", [{}, {"ke": 2e3}, {"kd": 50.0, "kf": 200.0}])
@pytest.mark.parametrize("balls", [2, 5])
@pytest.mark.parametrize("law", ["viscous", "huber"])
def test_contacts_keep_the_angular_momentum_of_bodies(law, balls, cfg):
    assert grazing(law, balls, **cfg) < 1e-4


def test_newtons_law_of_friction_makes_a_couple():
    """Each ball gets it at its own surface, as far apart as they overlap."""
    assert grazing("newton18") > 5e-3


@pytest.mark.parametrize(("law", "gain"), [("viscous", 0.0), ("newton18", 8e-4)])
def test_a_ball_keeps_its_spin_to_the_bit_but_in_newtons_rounding(law, gain):
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    body = builder.add_body()
    builder.add_shape_sphere(body, radius=0.1)
    builder.body_qd[body] = (0, 0, 0, 3, 5, 30)
    run = Run(builder.finalize(), dt=1 / 2000, friction_law=law, angular_damping=0.0)
    spin = run.go(4000).state.body_qd.numpy()[0, 3:].astype(float)
    assert np.linalg.norm(spin) / np.linalg.norm((3, 5, 30)) - 1 == pytest.approx(gain, rel=0.5)


def offset_stack():
    cfg = novaphy.ShapeConfig(ke=2e5, kd=300.0, kf=200.0, mu=0.5)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    random = np.random.default_rng(3)
    for k in range(10):
        x, y = random.uniform(-0.003, 0.003, 2)
        body = builder.add_body(xform=(x, y, 0.1 + 0.2 * k, *UPRIGHT))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    return builder.finalize()


def test_with_stick_springs_ten_cubes_that_are_not_aligned_stand_for_ten_seconds():
    run = Run(offset_stack(), stick_ke=1e5, pipeline={"contacts_per_pair": 4})
    start = run.state.body_q.numpy()
    run.go(9600)
    q = run.state.body_q.numpy()
    assert np.abs(q[:, :2] - start[:, :2]).max() < 2e-3
    assert np.abs(run.state.body_qd.numpy()).max() < 1e-2


def test_stick_springs_start_anew_from_a_state_of_their_own():
    """So a run has the same bits whatever the solver did before, on any number of threads."""
    model = offset_stack()
    run = Run(model, stick_ke=1e5)
    ends = []
    threads = novaphy.num_threads()
    try:
        for count in (1, 1, 2):
            novaphy.set_num_threads(count)
            run.state, run.after = model.state(), model.state()
            ends.append(run.go(300).state.body_q.numpy())
    finally:
        novaphy.set_num_threads(threads)
    assert_same_bits(ends[1], ends[0])
    assert_same_bits(ends[2], ends[0])
    trajectory = diff.Trajectory(model, 300)
    run.solver.rollout(trajectory, None, None, DT, pipeline=run.pipeline)
    assert_same_bits(trajectory[300].body_q.numpy(), ends[0])


def test_stick_springs_are_refused_with_other_laws():
    model = offset_stack()
    with pytest.raises(ValueError, match='stick_ke: expected 0 with a friction law other than "v'):
        solvers.SolverSemiImplicit(model, friction_law="huber", stick_ke=1.0)
    with pytest.raises(ValueError, match="stick_ke: expected a finite number >= 0, got -1"):
        solvers.SolverSemiImplicit(model, stick_ke=-1.0)
    assert solvers.SolverSemiImplicit(model, stick_ke=2.0).stick_ke == 2.0


def test_a_kinematic_body_may_have_no_mass():
    builder = novaphy.ModelBuilder()
    body = builder.add_body(xform=(0, 0, 1, *UPRIGHT), is_kinematic=True)
    builder.body_qd[body] = (1, 0, 0, 0, 0, 0)
    model = builder.finalize()
    model.body_mass = np.float32([0.0])
    state, after = model.state(), model.state()
    solvers.SolverSemiImplicit(model).step(state, after, None, None, 0.5)
    assert after.body_q.numpy()[0, 0] == 0.5
