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


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_sheet_on_a_sphere_is_solved_and_has_smooth_gradients(friction):
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e3, kd=1e-2, mu=friction)
    builder.add_shape_sphere(-1, radius=0.3)
    builder.add_cloth_grid(
        pos=(-0.6, -0.6, 0.31),
        dim_x=20,
        dim_y=20,
        cell_x=0.06,
        cell_y=0.06,
        mass=8e-4,
        particle_radius=0.01,
        tri_ke=1e3,
        tri_ka=1e3,
        tri_kd=1e-2,
        edge_ke=1e-3,
        edge_kd=1e-5,
    )
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e3, 1e-2, friction
    pipeline, dt = novaphy.CollisionPipeline(model), 1 / 240
    state = advance(SolverVBD(model, iterations=10, coarse="auto"), model.state(), 89, dt, pipeline)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    solver = SolverVBD(model, iterations=100, coarse="auto")
    solver.step(state, model.state(), None, contacts, dt)
    assert solver.residual().relative < 1e-3

    rng = np.random.default_rng(1)
    weights = rng.normal(size=(441, 3)).astype(np.float32)
    velocity = state.particle_qd.numpy()
    solver = DiffSolverVBD(model, iterations=10, coarse="auto")
    trajectory = diff.Trajectory(model, 1)
    trajectory[0].particle_q.assign(state.particle_q.numpy())
    leaf = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)

    def end(start):
        leaf.assign(start.astype(np.float32))
        solver.rollout(trajectory, None, contacts, dt)
        return diff.state_particle_q_tensor(trajectory[1])

    with nova.Tape() as tape:
        loss = nova.sum(end(velocity) * nova.tensor(weights))
    tape.backward(loss)
    along = leaf.grad.numpy().astype(float)
    along /= np.sqrt(np.mean(along * along))
    sides = [end(velocity + size * along).numpy().astype(float) for size in (1e-3, -1e-3)]
    difference = ((sides[0] - sides[1]) * weights).sum() / 2e-3
    assert (leaf.grad.numpy() * along).sum() == pytest.approx(difference, rel=0.02)


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


def test_the_step_is_off_where_it_is_not_supported():
    model = hanging_sheet()
    assert SolverVBD(model).coarse is None
    assert SolverVBD(model, coarse="auto").coarse == "auto"
    with pytest.raises(ValueError, match='coarse: expected "auto" or None, got "fine"'):
        SolverVBD(model, coarse="fine")
    ends = {}
    for name, other in (
        ("acceleration", {"acceleration": 0.5}),
        ("safeguard", {"safeguard": True}),
        (
            "self-contact",
            {"particle_enable_self_contact": True, "particle_self_contact_radius": 0.01},
        ),
    ):
        for coarse in (None, "auto"):
            solver = SolverVBD(model, iterations=3, coarse=coarse, **other)
            assert solver.coarse is None, name
            ends[coarse] = advance(solver, model.state(), 2, 1 / 60).particle_q.numpy()
        np.testing.assert_array_equal(ends[None], ends["auto"], name)


@pytest.mark.parametrize(
    ("touches", "slides", "iterations"), [(False, 1.0, 3), (True, 1.0, 1), (True, 0.0, 1)]
)
def test_unrolled_derivatives_of_free_sheets_are_those_of_differences(touches, slides, iterations):
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    sheet = novaphy.ModelBuilder(gravity=-9.81 if touches else 0.0)
    sheet.add_cloth_grid(
        pos=(0, 0, 0.005),
        dim_x=5,
        dim_y=5,
        cell_x=0.05,
        cell_y=0.05,
        mass=1e-3,
        tri_ke=300.0,
        tri_ka=300.0,
        tri_kd=1e-2,
        edge_ke=1e-3,
        edge_kd=1e-5,
        particle_radius=0.01,
    )
    if touches:
        sheet.add_ground_plane(cfg=novaphy.ShapeConfig(ke=1e3, kd=0.1, mu=0.5))
    builder = novaphy.ModelBuilder()
    builder.replicate(sheet, 2)
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e3, 0.1, 0.5
    solver = DiffSolverVBD(model, iterations=iterations, coarse="auto")
    trajectory = diff.Trajectory(model, 2)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(trajectory[0], contacts)
    rng = np.random.default_rng(1)
    velocity, weights, along = rng.normal(size=(3, 72, 3)).astype(np.float32)
    velocity = slides * (0.2 * velocity + np.float32([0.3, 0.0, -0.2]))
    leaf = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)

    def end(scale):
        leaf.assign(velocity + np.float32(scale) * along)
        solver.rollout(trajectory, None, contacts, 1 / 120)
        return diff.state_particle_q_tensor(trajectory[2])

    sides = [end(scale).numpy().astype(float) for scale in (1e-3, -1e-3)]
    difference = (sides[0] - sides[1]) / 2e-3
    with nova.Tape() as tape:
        last = end(0.0)
        loss = nova.sum(last * nova.tensor(weights))
    tape.backward(loss)
    backwards = (leaf.grad.numpy().astype(float) * along).sum()
    assert solver.gradient_info().label.startswith("exact")
    tangent = tape.jvp([last], [leaf], [nova.tensor(along)])[0].numpy().astype(float)
    size = np.linalg.norm(difference)
    assert np.isfinite(leaf.grad.numpy()).all() and np.isfinite(tangent).all()
    if slides:  # at rest friction and damping are not smooth
        assert np.linalg.norm(tangent - difference) < 0.02 * size
    assert backwards == pytest.approx((tangent * weights).sum(), abs=1e-5 * size * 72)


def test_worlds_threads_and_replays_change_no_bit_of_gradients():
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    weights = np.random.default_rng(2).normal(size=(169, 3)).astype(np.float32)

    def gradient(worlds, threads, replays):
        model = hanging_sheet(worlds)
        solver = DiffSolverVBD(model, iterations=3, coarse="auto")
        trajectory = diff.Trajectory(model, 2)
        leaf = diff.state_particle_q_tensor(trajectory[0], requires_grad=True)
        before = novaphy.num_threads()
        novaphy.set_num_threads(threads)

        def run():
            with nova.Tape() as tape:
                solver.rollout(trajectory, None, None, 1 / 60)
                q = diff.state_particle_q_tensor(trajectory[2])
                loss = nova.sum(q * nova.tensor(np.tile(weights, (worlds, 1))))
            tape.backward(loss)

        try:
            if not replays:
                run()
            else:
                with nova.ScopedCapture() as capture:
                    run()
                capture.graph.launch()
            return leaf.grad.numpy()
        finally:
            novaphy.set_num_threads(before)

    one = gradient(1, 1, False)
    assert np.abs(one).max() > 0
    np.testing.assert_array_equal(np.tile(one, (3, 1)), gradient(3, 1, False))
    np.testing.assert_array_equal(np.tile(one, (3, 1)), gradient(3, 2, False))
    np.testing.assert_array_equal(one, gradient(1, 2, True))


def test_an_implicit_step_has_the_same_solution():
    model = hanging_sheet()
    ends = []
    for coarse in (None, "auto"):
        after = model.state()
        solver = DiffSolverVBD(model, iterations=20, gradient="implicit", coarse=coarse)
        solver.step(model.state(), after, None, None, 1 / 240)
        ends.append(after.particle_q.numpy())
    np.testing.assert_allclose(*ends, atol=1e-6)


def test_halved_steps_are_counted():
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    builder = novaphy.ModelBuilder(gravity=0.0)
    for k in range(6):
        builder.add_particle((0.1 * k, 0, 0), (0, 0, 0), 0.01 if k else 0.0)
    for k in range(5):
        builder.add_spring(k, k + 1, 1e4, 0.0, 0)
    builder.color()
    model = builder.finalize()

    def halvings(speed, coarse):
        """Push the chain together, which has no stiffness across itself then."""
        state, after = model.state(), model.state()
        state.requires_grad = True
        velocity = np.zeros((6, 3), np.float32)
        velocity[1:, 0], velocity[1:, 1] = -speed * np.linspace(0.2, 1.0, 5), 0.3 * speed
        state.particle_qd.assign(velocity)
        solver = DiffSolverVBD(model, iterations=10, coarse=coarse)
        with nova.Tape() as tape:
            solver.step(state, after, None, None, 1 / 60)
            loss = nova.sum(diff.state_particle_q_tensor(after))
        tape.backward(loss)
        return solver.gradient_info().halvings

    assert halvings(0.0, "auto") == halvings(20.0, None) == 0
    assert 1 <= halvings(20.0, "auto") <= 10
