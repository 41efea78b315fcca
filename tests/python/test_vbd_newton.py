"""Newton's method of VBD: steps at their minimum, residuals without a frame, rounding."""

import numpy as np
import pytest

import novaphy
from novaphy.solvers import DiffSolverVBD, SolverVBD


def sheet(contact=None, **options):
    builder = novaphy.ModelBuilder(gravity=options.pop("gravity", -9.81))
    given = {
        "pos": (0, 0, 0.015), "dim_x": 4, "dim_y": 3, "cell_x": 0.06, "cell_y": 0.06,
        "mass": 1e-3, "tri_ke": 300.0, "tri_ka": 300.0, "tri_kd": 1e-2, "edge_ke": 5e-3,
        "edge_kd": 1e-4, "particle_radius": 0.02,
    }  # fmt: skip
    builder.add_cloth_grid(**{**given, **options})
    config = novaphy.ShapeConfig(ke=1e4, kd=1.0, mu=0.5)
    if contact == "plane":
        builder.add_ground_plane(cfg=config)
    elif contact == "sphere":
        builder.add_shape_sphere(-1, xform=(0.12, 0.1, -0.14, 0, 0, 0, 1), radius=0.15, cfg=config)
    elif contact == "box":
        place = (0.1, 0.1, -0.1, 0, 0, 0, 1)
        builder.add_shape_box(-1, xform=place, hx=0.12, hy=0.12, hz=0.1, cfg=config)
    builder.color()
    return builder.finalize()


def crumpled(model, seed):
    random = np.random.default_rng(seed)
    state, shape = model.state(), (model.particle_count, 3)
    q = model.particle_q.numpy() + random.normal(0, 0.004, shape)
    qd = random.normal(0, 0.3, shape)
    qd += np.array([random.normal(0, 0.5), random.normal(0, 0.5), -0.3])
    state.particle_q.assign(q.astype(np.float32))
    state.particle_qd.assign(qd.astype(np.float32))
    return state


@pytest.mark.parametrize("contact", ["plane", "sphere", "box"])
def test_steps_of_cloth_in_contact_with_friction_are_solved(contact):
    model = sheet(contact)
    solver = SolverVBD(model, solve="converged")
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    for seed in range(12):
        start, end = crumpled(model, seed), model.state()
        pipeline.collide(start, contacts)
        assert contacts.soft_contact_count.numpy()[0] > 0
        solver.step(start, end, None, contacts, 1 / 120)
        residual = solver.residual()
        assert residual.relative <= max(1e-4, 2 * residual.floor)


def test_a_converged_step_is_where_sweeps_lead():
    model = sheet()
    start, sweeps, newton = crumpled(model, 3), model.state(), model.state()
    SolverVBD(model, iterations=3000).step(start, sweeps, None, None, 1 / 120)
    SolverVBD(model, iterations=5, solve="converged", tolerance=1e-6).step(
        start, newton, None, None, 1 / 120
    )
    assert np.abs(newton.particle_q.numpy() - sweeps.particle_q.numpy()).max() < 2e-6


def test_a_converged_step_keeps_the_momentum():
    model = sheet(gravity=0.0)
    start, end = crumpled(model, 5), model.state()
    SolverVBD(model, solve="converged").step(start, end, None, None, 1 / 120)
    mass = model.particle_mass.numpy().astype(float)
    before, after = (mass @ s.particle_qd.numpy().astype(float) for s in (start, end))
    assert np.linalg.norm(after - before) < 1e-4 * np.linalg.norm(before)


def test_a_converged_step_leaves_a_saddle():
    builder = novaphy.ModelBuilder(gravity=0.0)
    for x, mass in ((-1.0, 0.0), (0.0, 0.1), (1.0, 0.0)):
        builder.add_particle((x, 0, 0), (0, 0, 0), mass)
    for end in (0, 2):
        builder.add_spring(1, end, 100.0, 0.0, 0)
    builder.color()
    model = builder.finalize()
    start, end = model.state(), model.state()
    start.particle_q.assign(np.float32([[-0.5, 0, 0], [0, 0, 0], [0.5, 0, 0]]))
    h = 1.0
    SolverVBD(model, solve="converged").step(start, end, None, None, h)
    x, y, z = end.particle_q.numpy()[1]
    length = 1.0 / (1.0 + 0.1 / (2 * 100.0 * h**2))
    assert x == pytest.approx(0.0, abs=1e-3)
    assert np.hypot(y, z) == pytest.approx(np.sqrt(length**2 - 0.25), rel=1e-3)


def test_a_converged_step_is_refused_by_name_in_a_capture():
    nova = pytest.importorskip("novaphy.nova")
    model = sheet()
    solver = SolverVBD(model, solve="converged")
    assert (solver.solve, SolverVBD(model).solve) == ("converged", "iterations")
    state, after = model.state(), model.state()
    with pytest.raises(NotImplementedError, match="solve: expected"), nova.ScopedCapture():
        solver.step(state, after, None, None, 1 / 60)
    with pytest.raises(ValueError, match="solve: expected"):
        SolverVBD(model, solve="best")


@pytest.mark.parametrize("speed", [-0.6, -3.0])
def test_damping_acts_on_the_motion_inside_the_overlap(speed):
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.0, ke=2e3, kd=30.0))
    builder.add_particle((0, 0, 0.021), (0, 0, speed), 0.1, radius=0.02)
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 2e3, 30.0, 0.0
    start, end = model.state(), model.state()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(start, contacts)
    h = 0.01
    DiffSolverVBD(model, gradient="implicit").step(start, end, None, contacts, h)
    inertia, contact = 0.1 / h**2, 2e3 + 30.0 / h
    expected = (inertia * (0.021 + h * speed) + contact * 0.02) / (inertia + contact)
    assert expected < 0.02  # the particle begins to touch in this step, and ends in the overlap
    assert end.particle_q.numpy()[0, 2] == pytest.approx(expected, abs=2e-7)


def test_the_residual_does_not_depend_on_the_frame():
    model = sheet(gravity=0.0)
    found = []
    for speed in (0.0, 100.0):
        start, end = model.state(), model.state()
        start.particle_q.assign(model.particle_q.numpy() * np.float32([1.1, 1.0, 1.0]))
        start.particle_qd.assign(np.tile(np.float32([speed, 0, 0]), (model.particle_count, 1)))
        solver = SolverVBD(model, iterations=5)
        solver.step(start, end, None, None, 1 / 120)
        found.append(solver.residual())
    at_rest, moving = found
    assert moving.scale == pytest.approx(at_rest.scale, rel=1e-3)
    assert moving.relative == pytest.approx(at_rest.relative, rel=1e-2)


def test_a_linear_system_that_stands_still_is_not_told_to_sweep_more():
    diff = pytest.importorskip("novaphy.diff")
    from novaphy import nova

    builder = novaphy.ModelBuilder()
    builder.add_soft_grid(
        pos=(0, 0, 0), rot=(0, 0, 0, 1), vel=(0, 0, 0), dim_x=8, dim_y=2, dim_z=2, cell_x=0.05,
        cell_y=0.05, cell_z=0.05, density=1000.0, k_mu=1.2e4, k_lambda=1.7e4, k_damp=0.0,
        fix_left=True,
    )  # fmt: skip
    builder.color()
    model = builder.finalize()
    model.particle_tet_material.requires_grad = True
    solver = DiffSolverVBD(
        model, iterations=60, gradient="implicit", gradient_sweeps=5000, gradient_tolerance=1e-7
    )
    trajectory = diff.Trajectory(model, 1)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 0.3)
        q = diff.state_particle_q_tensor(trajectory[1])
        loss = nova.sum(q * q)
    try:
        tape.backward(loss)
    except novaphy.Error as error:
        assert "more sweeps do not help" in str(error)
    else:
        assert solver.gradient_info().linear_sweeps < 5000


def test_the_adaptive_guess_with_the_coarse_step_makes_no_energy():
    model = sheet(
        pos=(0, 0, 0), dim_x=8, dim_y=8, cell_x=0.05, cell_y=0.05, fix_left=True, tri_ke=200.0,
        tri_ka=200.0, edge_ke=1e-3, edge_kd=1e-5,
    )  # fmt: skip
    mass = model.particle_mass.numpy().astype(float)
    solver = SolverVBD(model, initial_guess="adaptive", coarse="auto")
    state, after, highest = model.state(), model.state(), -np.inf
    for _ in range(100):
        solver.step(state, after, None, None, 1 / 60)
        state, after = after, state
        q, v = (a.numpy().astype(float) for a in (state.particle_q, state.particle_qd))
        highest = max(highest, 9.81 * (mass @ q[:, 2]) + 0.5 * (mass @ (v * v).sum(1)))
    assert highest < 0.02 * (0.2 * 9.81 * mass.sum())  # a part of the released energy


def light_beside_heavy(light=True, heavy=True):
    """A hanging sheet of 0.5 g beside a swinging soft body of 200 kg, without an element between
    them, and the rows of the sheet."""
    builder, rows = novaphy.ModelBuilder(), 0
    if light:
        builder.add_cloth_grid(
            pos=(0, 0, 2), dim_x=5, dim_y=5, cell_x=0.05, cell_y=0.05, mass=5e-4 / 36,
            fix_left=True, tri_ke=5.0, tri_ka=5.0, tri_kd=1e-3, edge_ke=1e-5, edge_kd=1e-7,
        )  # fmt: skip
        rows = builder.particle_count
    if heavy:
        builder.add_soft_grid(
            pos=(2, 0, 0), dim_x=2, dim_y=2, dim_z=2, cell_x=0.3, cell_y=0.3, cell_z=0.3,
            density=1000.0, k_mu=1e5, k_lambda=1e5, k_damp=1.0, fix_left=True,
        )  # fmt: skip
    builder.color()
    return builder.finalize(), slice(0, rows)


@pytest.mark.parametrize("kind", ["converged", "tolerance", "implicit"])
def test_a_light_sheet_beside_a_heavy_body_ends_at_its_own_solution(kind):
    def end(model):
        if kind == "implicit":
            solver = DiffSolverVBD(model, gradient="implicit", gradient_tolerance=1e-3)
        elif kind == "converged":
            solver = SolverVBD(model, solve="converged", tolerance=1e-2)
        else:
            solver = SolverVBD(model, iterations=200, tolerance=1e-2)
        after = model.state()
        solver.step(model.state(), after, None, None, 1 / 60)
        if kind != "implicit":
            residual = solver.residual()
            assert residual.relative <= max(1e-2, 2 * residual.floor)
        return after.particle_q.numpy()

    (alone, rows), (beside, _) = light_beside_heavy(heavy=False), light_beside_heavy()
    both, sheet_alone = end(beside), end(alone)
    np.testing.assert_array_equal(both[rows], sheet_alone)
    np.testing.assert_array_equal(both[rows.stop :], end(light_beside_heavy(light=False)[0]))
    if kind == "tolerance":
        return  # a small residual leaves smooth errors
    exact = alone.state()
    solver = SolverVBD(alone, solve="converged", tolerance=1e-6)
    solver.step(alone.state(), exact, None, None, 1 / 60)
    motion = np.linalg.norm(exact.particle_q.numpy() - alone.particle_q.numpy())
    assert np.linalg.norm(both[rows] - exact.particle_q.numpy()) < 1e-2 * motion


# Pull and press are relative, tri_ke and tri_ka in N/m, edge_ke in N, and the step in s. Each case
# needs more than 30 iterations of Newton's method.
@pytest.mark.parametrize(
    ("cells", "pull", "press", "ke", "ka", "bend", "dt"),
    [
        (14, 0.05, 0.17, 127.0, 34.0, 3.5e-3, 1 / 120),
        (8, 0.07, 0.22, 801.0, 5875.0, 0.0, 1 / 240),
    ],
)
def test_steps_of_pressed_sheets_are_solved(cells, pull, press, ke, ka, bend, dt):
    model = sheet(
        pos=(0, 0, 0), dim_x=cells, dim_y=cells, cell_x=0.05, cell_y=0.05, tri_ke=ke, tri_ka=ka,
        tri_kd=0.0, edge_ke=bend, edge_kd=0.0, fix_left=True, fix_right=True,
    )  # fmt: skip
    random, start, end = np.random.default_rng(0), model.state(), model.state()
    middle = 0.025 * cells
    q = model.particle_q.numpy() - (middle, middle, 0.0)
    q = q * (1 + pull, 1 - press, 1) + (middle, middle, 0.0)
    free = model.particle_mass.numpy() > 0
    q[free] += random.normal(0, 3e-4, (free.sum(), 3))
    start.particle_q.assign(q.astype(np.float32))
    solver = SolverVBD(model, solve="converged")
    solver.step(start, end, None, None, dt)
    residual = solver.residual()
    assert residual.relative <= max(1e-4, 2 * residual.floor)
