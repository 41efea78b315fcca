"""Self-contact of cloth in SolverVBD: no crossings, and laws with a closed form."""

import numpy as np
import pytest
from self_contact_scenes import CLOTH, Rollout, finalized, grid, sheet_on_edge

import novaphy
from novaphy.solvers import SolverVBD

RADIUS = 0.006


def solver_of(model, **options):
    given = {"particle_enable_self_contact": True, "particle_self_contact_radius": RADIUS}
    return SolverVBD(model, **(given | options))


def test_a_sheet_that_falls_on_its_edge_never_crosses_itself():
    rollout = Rollout(solver_of(model := sheet_on_edge()), model)
    for _ in range(100):
        rollout.step(1 / 300)
    assert rollout.crossed == 0
    assert len(rollout.solver.self_contacts()) > 100
    without = Rollout(SolverVBD(model), model)
    for step in range(70):
        without.step(1 / 300, counts=step == 69)
    assert without.crossed > 100


def test_two_layers_on_a_plane_stay_apart():
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e3, kd=1e-2, mu=0.5)
    builder.add_ground_plane()
    grid(builder, pos=(0.0, 0.0, 0.01), cells=8)
    grid(builder, pos=(0.013, 0.004, 0.04), cells=8, vel=(0.0, 0.0, -1.0))
    rollout = Rollout(solver_of(model := finalized(builder)), model)
    for _ in range(120):
        q = rollout.step(1 / 300)
    assert rollout.crossed == 0
    assert 0.5 * RADIUS < (q[81:, 2] - q[:81, 2]).mean() < 1.1 * RADIUS


def test_a_twisted_towel_never_crosses_itself():
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_cloth_grid(
        pos=(0.0, -0.1, 0.0), dim_x=20, dim_y=8, cell_x=0.02, cell_y=0.025, mass=2e-4,
        fix_left=True, fix_right=True, **CLOTH,
    )  # fmt: skip
    model = finalized(builder)
    rollout = Rollout(solver_of(model), model)
    rest = model.particle_q.numpy()
    held = np.flatnonzero(model.particle_mass.numpy() == 0.0)
    assert len(held) == rollout.solver.kinematic_count == 18
    for step in range(150):
        turn = 2.0 * np.pi * 1.5 * (step + 1) / 150
        angle = np.where(rest[held, 0] > 0.2, turn, -turn)
        y, z = rest[held, 1], rest[held, 2]
        targets = np.stack(
            [
                np.where(rest[held, 0] > 0.2, rest[held, 0] - 0.08 * (step + 1) / 150, 0.0),
                np.cos(angle) * y - np.sin(angle) * z,
                np.sin(angle) * y + np.cos(angle) * z,
            ],
            axis=1,
        )
        rollout.step(1 / 100, targets=targets)
    assert rollout.crossed == 0
    assert len(rollout.solver.self_contacts()) > 20


def test_free_fall_has_the_bits_of_a_solver_without_self_contact():
    builder = novaphy.ModelBuilder()
    grid(builder, pos=(0.0, 0.0, 0.0), cells=6)
    model = finalized(builder)
    falls = [Rollout(solver_of(model), model), Rollout(SolverVBD(model), model)]
    for _ in range(300):
        ends = [fall.step(1 / 300) for fall in falls]
    assert (ends[0] == ends[1]).all()
    assert falls[0].state.particle_qd.numpy()[:, 2] == pytest.approx(-9.81, rel=2e-3)


def test_two_sheets_that_collide_keep_their_momentum():
    builder = novaphy.ModelBuilder(gravity=0.0)
    grid(builder, pos=(0.0, 0.0, 0.0), cells=2)
    grid(builder, pos=(0.009, 0.007, 0.012), cells=2, vel=(0.2, 0.0, -1.0))
    model = finalized(builder)
    rollout = Rollout(solver_of(model, iterations=400), model)
    mass = model.particle_mass.numpy()[:, None].astype(float)
    before = (mass * model.particle_qd.numpy()).sum(0)
    for _ in range(8):
        rollout.step(1 / 300)
    velocity = rollout.state.particle_qd.numpy()
    assert velocity[:9, 2].mean() < -0.2  # the lower sheet was hit
    after = (mass * velocity).sum(0)
    assert np.abs(after - before).max() < 1e-5 * np.abs(before).max()


@pytest.mark.parametrize(("ratio", "dt", "speed"), [(10, 1 / 300, 1.0), (100, 1 / 60, 2.0)])
def test_free_sheets_of_unequal_mass_keep_their_momentum(ratio, dt, speed):
    builder = novaphy.ModelBuilder(gravity=0.0)
    grid(builder, pos=(0.0, 0.0, 0.0), cells=6, mass=2e-4 * ratio)
    grid(builder, pos=(0.009, 0.007, 0.012), cells=6, vel=(0.2, 0.0, -speed))
    if speed > 1.0:  # a third sheet where the momentum of the other two moves them
        grid(builder, pos=(0.004, 0.002, 0.022), cells=4, vel=(0.0, 0.0, -0.916))
    rollout = Rollout(solver_of(model := finalized(builder)), model)
    mass, velocity = model.particle_mass.numpy()[:, None].astype(float), model.particle_qd.numpy()
    before, energy = mass * velocity, (mass * velocity**2).sum()
    was_touching = False
    for _ in range(round(0.1 / dt)):
        rollout.step(dt)
        was_touching |= len(rollout.solver.self_contacts()) > 0
        velocity = rollout.state.particle_qd.numpy()
        change = (mass * velocity - before).sum(0)
        assert np.abs(change).max() < 1e-5 * np.abs(before).sum()
        assert (mass * velocity**2).sum() < 1.001 * energy
    assert was_touching and rollout.crossed == 0


HALF = np.sqrt(0.5)


@pytest.mark.parametrize(
    ("cells", "radius", "vel", "dt", "second"),
    [
        ((5, 0.02), 0.006, (0, 0, -1), 1 / 120, {"pos": (0, 0, 0.003), "cells": 5}),
        (
            (5, 0.02), 0.01, (0, 0, -1), 1 / 300,
            {"pos": (0.16, 0, 0.005), "rot": (0, 0, HALF, HALF), "cells": 4, "cell": 0.04},
        ),
        (
            (5, 0.1), 0.015, (1, 0, -2), 1 / 120,
            {"pos": (0, 0, 0.015), "rot": (HALF, 0, 0, HALF), "cells": 2, "cell": 0.05},
        ),
    ],
)  # fmt: skip
def test_grids_that_are_aligned_exactly_stay_finite_and_apart(cells, radius, vel, dt, second):
    builder = novaphy.ModelBuilder(gravity=0.0)
    grid(builder, pos=(0.0, 0.0, 1.0), cells=cells[0], cell=cells[1])
    second = second | {"pos": np.add(second["pos"], (0.0, 0.0, 1.0))}
    grid(builder, vel=vel, **second)
    model = finalized(builder)
    rollout = Rollout(solver_of(model, particle_self_contact_radius=radius), model)
    for _ in range(10):
        q = rollout.step(dt)
    assert rollout.crossed == 0
    assert np.abs(q - model.particle_q.numpy()).max() < 0.3


@pytest.mark.parametrize(("stiffness", "is_deep"), [(1e3, False), (1.0, True)])
def test_a_light_triangle_rests_where_the_potential_carries_it(stiffness, is_deep):
    builder = novaphy.ModelBuilder()
    mass = 4e-4
    wide = [builder.add_particle(q, (0, 0, 0), 0.0) for q in [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]]
    small = [(-0.02, -0.02, 0.007), (0.02, -0.02, 0.007), (0.0, 0.02, 0.007)]
    light = [builder.add_particle(q, (0, 0, 0), mass) for q in small]
    builder.add_triangle(*wide, tri_ke=1.0, tri_ka=1.0)
    builder.add_triangle(*light, tri_ke=10.0, tri_ka=10.0)
    model = finalized(builder, ke=stiffness, kd=0.2)
    rollout = Rollout(solver_of(model, iterations=30), model)
    for _ in range(400):
        q = rollout.step(1 / 200)
    half = 0.5 * RADIUS
    load = 9.81 * mass
    wanted = half**2 * stiffness / load if is_deep else RADIUS - load / stiffness
    assert (wanted < half) == is_deep
    assert q[3:, 2] == pytest.approx(wanted, rel=2e-3)
    contacts = rollout.solver.self_contacts()
    assert len(contacts) == 3 and not contacts.has_edges.any()
    assert contacts.gaps == pytest.approx(wanted, rel=2e-3)
    assert contacts.forces == pytest.approx(load, rel=5e-3)
    assert sorted(contacts.particles[:, 0]) == light


def test_a_world_beside_another_has_its_own_bits():
    def sheets(builder, offset):
        grid(builder, pos=(0.0, 0.0, 0.0), cells=4)
        grid(builder, pos=(offset, 0.004, 0.02), cells=4, vel=(0.0, 0.0, -2.0))

    def end(offsets):
        builder = novaphy.ModelBuilder(gravity=0.0)
        for offset in offsets:
            world = novaphy.ModelBuilder(gravity=0.0)
            sheets(world, offset)
            builder.add_world(world)
        rollout = Rollout(solver_of(model := finalized(builder)), model)
        for _ in range(20):
            q = rollout.step(1 / 300, counts=False)
        return q

    one, both = end([0.013]), end([0.013, 0.006])
    assert (both[:50] == one).all()
    assert np.abs(both[50:] - one).max() > 1e-3


def test_the_number_of_threads_does_not_change_the_bits():
    model = sheet_on_edge(12)

    def end(threads):
        novaphy.set_num_threads(threads)
        rollout = Rollout(solver_of(model), model)
        for _ in range(60):
            q = rollout.step(1 / 200, counts=False)
        return q

    before = novaphy.num_threads()
    try:
        assert (end(1) == end(2)).all()
    finally:
        novaphy.set_num_threads(before)


def test_a_start_that_crosses_is_named():
    builder = novaphy.ModelBuilder()
    grid(builder, pos=(0.0, 0.0, 0.0), cells=2)
    builder.add_triangle(
        *(
            builder.add_particle(q, (0, 0, 0), 1e-3)
            for q in [(0.01, 0.013, -0.02), (0.012, 0.013, 0.02), (0.05, 0.013, 0.03)]
        ),
        tri_ke=1e2,
    )
    model = finalized(builder)
    state, after = model.state(), model.state()
    with pytest.raises(ValueError, match=r"edge of particles .* passes through the triangle of"):
        solver_of(model).step(state, after, None, None, 1 / 60)


def test_a_start_that_touches_is_named():
    for height, message in [(0.0, "got 0 m between particle"), (1e-6, None)]:
        builder = novaphy.ModelBuilder(gravity=0.0)
        grid(builder, pos=(0.0, 0.0, 0.0), cells=3)
        grid(builder, pos=(0.01, 0.01, height), cells=3, vel=(0.0, 0.0, -1.0))
        rollout = Rollout(solver_of(model := finalized(builder)), model)
        if message:
            with pytest.raises(ValueError, match=message):
                rollout.step(1 / 120)
        else:
            for _ in range(10):
                rollout.step(1 / 120)
            assert rollout.crossed == 0


def test_bad_options_are_named():
    builder = novaphy.ModelBuilder()
    grid(builder, pos=(0.0, 0.0, 0.0), cells=2)
    model = finalized(builder)
    for given, message in [
        ({"particle_self_contact_radius": 0.03}, "at most the length of the shortest edge"),
        ({"particle_self_contact_radius": -1.0}, "radius: expected a finite number > 0"),
        ({"particle_self_contact_gap": 0.0}, "gap: expected a finite number > 0"),
        ({"particle_self_contact_margin": 0.01}, "margin: expected None beside"),
        ({"particle_enable_self_contact": False}, "radius: expected None without"),
    ]:
        with pytest.raises(ValueError, match=message):
            solver_of(model, **given)
    for given in [
        {"acceleration": 0.5}, {"tolerance": 1e-3}, {"safeguard": True}, {"solve": "converged"},
    ]:  # fmt: skip
        with pytest.raises(NotImplementedError, match=f"{next(iter(given))}.*not supported"):
            solver_of(model, **given)
    with pytest.raises(ValueError, match="self_contacts: expected"):
        SolverVBD(model).self_contacts()
    with pytest.raises(ValueError, match="expected a model with triangles"):
        solver_of(finalized(novaphy.ModelBuilder()))
    alike = solver_of(model, particle_self_contact_radius=None, particle_self_contact_margin=RADIUS)
    assert alike.particle_enable_self_contact
    radii = model.particle_radius.numpy()
    radii[0] *= 2.0
    model.particle_radius = radii
    with pytest.raises(ValueError, match="particle_radius varies from 0.003 to 0.006"):
        solver_of(model, particle_self_contact_radius=None)


def test_a_capture_is_refused_by_name():
    from novaphy import nova

    builder = novaphy.ModelBuilder()
    grid(builder, pos=(0.0, 0.0, 0.0), cells=2)
    model = finalized(builder)
    solver, state, after = solver_of(model), model.state(), model.state()
    with (
        pytest.raises(NotImplementedError, match="particle_enable_self_contact"),
        nova.ScopedCapture(),
    ):
        solver.step(state, after, None, None, 1 / 60)


@pytest.mark.parametrize("other", ["searches", "lies far away"])
def test_a_world_keeps_its_bits_whatever_another_world_does(other):
    def end(*others):
        builder = novaphy.ModelBuilder()
        world = novaphy.ModelBuilder()
        grid(world, pos=(0.01, 0, 0.3), cells=3, mass=2e-3)
        grid(world, pos=(0.005, 0.02, 0.302), cells=1, cell=0.04, vel=(0, 0, -1), mass=2e-2)
        for each in (world, *others):
            builder.add_world(each)
        rollout = Rollout(solver_of(model := finalized(builder), iterations=5), model)
        for _ in range(6):
            q = rollout.step(1 / 120, counts=False)
        return q[:20]

    beside = novaphy.ModelBuilder()
    if other == "searches":
        grid(beside, pos=(0, 0, 0.3), cells=4, vel=(0, 0, -1), mass=2e-2, fix_left=True)
    else:
        grid(beside, pos=(0, 0, 1000.0), cells=3)
    assert (end(beside) == end()).all()
