"""The coarse correction of SolverVBD: what it solves, what it keeps, and what it refuses."""

import numpy as np
import pytest

import novaphy
from novaphy.solvers import DiffSolverVBD, SolverVBD


def advance(solver, state, steps, dt, pipeline=None):
    after = solver.model.state()
    contacts = pipeline.contacts() if pipeline else None
    for _ in range(steps):
        if pipeline:
            pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        state, after = after, state
    return state


def hanging_sheet(worlds=1):
    sheet = novaphy.ModelBuilder()
    sheet.add_cloth_grid(
        dim_x=12,
        dim_y=12,
        cell_x=0.4 / 12,
        cell_y=0.4 / 12,
        mass=0.081 / 169,
        fix_left=True,
        tri_ke=200.0,
        tri_ka=200.0,
        tri_kd=0.01,
        edge_ke=1e-3,
        edge_kd=1e-5,
    )
    scene = novaphy.ModelBuilder()
    scene.replicate(sheet, worlds)
    scene.color()
    return scene.finalize()


def test_five_iterations_solve_a_hanging_sheet():
    model = hanging_sheet()
    start = advance(SolverVBD(model, iterations=30, coarse="auto"), model.state(), 25, 1 / 60)
    before = start.particle_q.numpy()

    def end(iterations, coarse):
        after = model.state()
        solver = SolverVBD(model, iterations=iterations, coarse=coarse)
        solver.step(start, after, None, None, 1 / 60)
        return after.particle_q.numpy()

    solution = end(200, "auto")
    motion = np.linalg.norm(solution - before)
    assert np.linalg.norm(end(5, "auto") - solution) < 1e-3 * motion
    assert np.linalg.norm(end(20, "auto") - solution) < 2e-5 * motion
    assert np.linalg.norm(end(20, None) - solution) > 0.05 * motion


def test_a_chain_of_springs_hangs_at_its_length():
    builder, mass, stiffness = novaphy.ModelBuilder(), 0.1, 1e4
    for k in range(21):
        builder.add_particle((0, 0, -0.05 * k), (0, 0, 0), mass if k else 0.0)
    for k in range(20):
        builder.add_spring(k, k + 1, stiffness, 1.0, 0)
    builder.color()
    model = builder.finalize()
    state = advance(SolverVBD(model, iterations=10, coarse="auto"), model.state(), 600, 1 / 60)
    law = mass * 9.81 * sum(range(1, 21)) / stiffness
    assert -state.particle_q.numpy()[-1, 2] - 1.0 == pytest.approx(law, rel=1e-3)


def test_a_weight_on_a_free_sheet_keeps_its_momentum():
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_cloth_grid(
        pos=(0, 0, 0),
        dim_x=10,
        dim_y=10,
        cell_x=0.05,
        cell_y=0.05,
        mass=0.14 / 121,
        tri_ke=500.0,
        tri_ka=500.0,
        tri_kd=1e-2,
        edge_ke=1e-3,
        edge_kd=1e-5,
    )
    mass = np.array(builder.particle_mass)
    mass[60] = 5.0
    builder.particle_mass = mass
    builder.color()
    model = builder.finalize()
    state = model.state()
    velocity = np.zeros((121, 3), np.float32)
    velocity[60, 2] = -1.0
    state.particle_qd.assign(velocity)
    state = advance(SolverVBD(model, iterations=10, coarse="auto"), state, 60, 1 / 120)
    momentum = mass @ state.particle_qd.numpy().astype(float)
    np.testing.assert_allclose(momentum, [0, 0, -5.0], atol=5.0 * 3e-5)  # roundings of 60 steps


def test_a_sheet_slides_down_a_slope():
    angle, mu = np.deg2rad(35.0), 0.5
    builder = novaphy.ModelBuilder(gravity=(9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)))
    builder.add_cloth_grid(
        pos=(0, 0, 0.01),
        dim_x=8,
        dim_y=8,
        cell_x=0.05,
        cell_y=0.05,
        mass=1e-3,
        tri_ke=500.0,
        tri_ka=500.0,
        tri_kd=1e-2,
        edge_ke=1e-3,
        edge_kd=1e-5,
        particle_radius=0.01,
    )
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(ke=1e4, kd=1.0, mu=mu))
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e4, 1.0, mu
    solver = SolverVBD(model, iterations=10, coarse="auto")
    state = advance(solver, model.state(), 240, 1 / 240, novaphy.CollisionPipeline(model))
    slid = (state.particle_q.numpy() - model.particle_q.numpy())[:, 0].mean()
    law = 0.5 * 9.81 * (np.sin(angle) - mu * np.cos(angle))
    assert slid == pytest.approx(law, rel=0.02)


def test_worlds_and_threads_change_no_bit():
    one, three = hanging_sheet(), hanging_sheet(3)
    ends = []
    for model, threads in ((one, 1), (three, 1), (three, 2)):
        before = novaphy.num_threads()
        novaphy.set_num_threads(threads)
        try:
            solver = SolverVBD(model, iterations=4, coarse="auto")
            ends.append(advance(solver, model.state(), 3, 1 / 60).particle_q.numpy())
        finally:
            novaphy.set_num_threads(before)
    np.testing.assert_array_equal(np.tile(ends[0], (3, 1)), ends[1])
    np.testing.assert_array_equal(ends[1], ends[2])


def test_options_that_do_not_fit_are_refused():
    model = hanging_sheet()
    assert SolverVBD(model).coarse is None
    assert SolverVBD(model, coarse="auto").coarse == "auto"
    with pytest.raises(ValueError, match='coarse: expected "auto" or None, got "fine"'):
        SolverVBD(model, coarse="fine")
    for other in ({"acceleration": 0.5}, {"safeguard": True}):
        with pytest.raises(ValueError, match="coarse: expected"):
            SolverVBD(model, coarse="auto", **other)
    with pytest.raises(NotImplementedError, match="coarse.*implicit"):
        DiffSolverVBD(model, coarse="auto")


def test_an_implicit_step_has_the_same_solution():
    model = hanging_sheet()
    ends = []
    for coarse in (None, "auto"):
        after = model.state()
        solver = DiffSolverVBD(model, iterations=20, gradient="implicit", coarse=coarse)
        solver.step(model.state(), after, None, None, 1 / 240)
        ends.append(after.particle_q.numpy())
    np.testing.assert_allclose(*ends, atol=1e-6)
