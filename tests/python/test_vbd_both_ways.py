"""Contacts of particles with rigid bodies in SolverVBD, both ways."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from vbd_steps import rotation, run

import novaphy
from novaphy.solvers import SolverVBD

G = 9.81
KE = 1e4  # N/m
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def builder_of(gravity: float = -G, mu: float = 0.5) -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder(gravity=gravity)
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=KE, kd=0.0, mu=mu, density=1000.0)
    return builder


def add_sheet(builder: novaphy.ModelBuilder, cells: int, z: float = 0.0, **options: Any) -> None:
    """Add a square sheet of cells of 5 cm around the z axis, 2 g for each particle."""
    edge = -0.025 * cells
    cloth = {"mass": 2e-3, "tri_ke": 1e3, "tri_ka": 1e3, "tri_kd": 0.1, "edge_ke": 1e-3}
    builder.add_cloth_grid(pos=(edge, edge, z), dim_x=cells, dim_y=cells, cell_x=0.05, cell_y=0.05,
                           particle_radius=0.01, **{**cloth, **options})  # fmt: skip


def add_box(builder: novaphy.ModelBuilder, pos: tuple, mass: float, **options: Any) -> int:
    size = {"hx": 0.1, "hy": 0.1, "hz": 0.1, **options.pop("size", {})}
    body = builder.add_body(xform=(pos, UPRIGHT), **options)
    density = mass / (8 * size["hx"] * size["hy"] * size["hz"])
    mu = builder.default_shape_cfg.mu
    builder.add_shape_box(body, cfg=novaphy.ShapeConfig(ke=KE, kd=0.0, mu=mu, density=density),
                          **size)  # fmt: skip
    return body


def finalize(builder: novaphy.ModelBuilder) -> novaphy.Model:
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke = KE
    model.soft_contact_kd = 0.0
    model.soft_contact_mu = builder.default_shape_cfg.mu
    return model


def momenta(model: novaphy.Model, state: novaphy.State) -> tuple[np.ndarray, np.ndarray, float]:
    """Return momentum, angular momentum about the origin, and energy without that of elements."""
    m = model.particle_mass.numpy().astype(float)
    x = state.particle_q.numpy().astype(float)
    v = state.particle_qd.numpy().astype(float)
    gravity = -float(model.gravity.numpy()[0, 2])
    linear, angular = m @ v, (m[:, None] * np.cross(x, v)).sum(axis=0)
    energy = 0.5 * m @ (v * v).sum(axis=1) + gravity * m @ x[:, 2]
    for b, (q, qd) in enumerate(
        zip(state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float), strict=True)
    ):
        turn, mass = rotation(q[3:]), float(model.body_mass.numpy()[b])
        spin = turn @ model.body_inertia.numpy()[b] @ turn.T @ qd[3:]
        linear = linear + mass * qd[:3]
        angular = angular + np.cross(q[:3], mass * qd[:3]) + spin
        energy += 0.5 * (mass * qd[:3] @ qd[:3] + spin @ qd[3:]) + gravity * mass * q[2]
    return linear, angular, energy


@pytest.mark.parametrize(
    ("mass", "damping", "steps"),
    [(0.0034, 0.0, 3), (0.34, 0.0, 12), (34.0, 0.0, 12), (0.0034, 10.0, 3), (0.34, 10.0, 12)],
)  # fmt: skip
def test_a_free_cloth_and_a_free_box_keep_their_momentum(
    mass: float, damping: float, steps: int
) -> None:
    """The sheet has 0.34 kg, so the mass ratios are 1:100, 1:1 and 100:1.

    The lightest box flies off after three steps. The sheet alone has no balance of its angular
    momentum.
    """
    builder = builder_of(gravity=0.0)
    add_sheet(builder, 12)
    box = add_box(builder, (0.03, 0, 0.12), mass)
    builder.body_qd[box] = (0.3, 0, -2, 0, 0, 0)
    model = finalize(builder)
    model.soft_contact_kd = damping  # does not act between particles and dynamic bodies
    linear, angular, energy = momenta(model, model.state())
    handed, errors = [], []

    def see(_: int, state: novaphy.State) -> None:
        now = momenta(model, state)
        handed.append(mass * abs(float(state.body_qd.numpy()[0, 2]) + 2))
        errors.append((np.linalg.norm(now[0] - linear), np.linalg.norm(now[1] - angular) / 0.1))
        assert now[2] < energy * (1 + 1e-6)

    run(model, steps, 1 / 240, see)
    assert handed[-1] > 0.005 * mass
    assert np.array(errors).max() < 1e-3 * handed[-1]


@pytest.mark.parametrize("guess", ["inertia", "previous", "adaptive"])
def test_a_box_and_a_sheet_that_fly_together_gain_no_energy(guess: str) -> None:
    builder = builder_of(gravity=0.0)
    add_sheet(builder, 8, vel=(2, 0, 0))
    box = add_box(builder, (0.03, 0.02, 0.12), 0.05)
    builder.body_qd[box] = (2, 0, -2, 1, 1, 0)
    model = finalize(builder)
    before = momenta(model, model.state())[2]
    energies: list[float] = []

    def see(_: int, state: novaphy.State) -> None:
        energies.append(momenta(model, state)[2])

    run(model, 40, 1 / 120, see, initial_guess=guess)
    assert max(energies) < before * (1 + 1e-6)
    if guess != "previous":  # the guess that stops free motions
        assert energies[-1] > 0.5 * before


def test_a_pair_of_equal_mass_ends_with_equal_velocities() -> None:
    builder = builder_of(gravity=0.0)
    add_sheet(builder, 6, mass=0.0, tri_kd=5.0)
    mass = 0.5
    for p in range(len(builder.particle_mass)):
        builder.particle_mass[p] = mass / len(builder.particle_mass)
    box = add_box(builder, (0, 0, 0.12), mass, size={"hx": 0.2, "hy": 0.2})
    builder.body_qd[box] = (0, 0, -1, 0, 0, 0)
    state = run(finalize(builder), 100, 1 / 240)
    assert state.body_qd.numpy()[0, 2] == pytest.approx(-0.5, abs=0.02)
    assert state.particle_qd.numpy()[:, 2].mean() == pytest.approx(-0.5, abs=0.02)


def block_under(mass: float | None) -> tuple[novaphy.Model, novaphy.State]:
    """Return a soft block of 0.2 m on the ground at rest, under a box unless mass is None."""
    builder = builder_of(mu=0.0)
    builder.add_ground_plane()
    builder.add_soft_grid(pos=(-0.1, -0.1, 0.01), dim_x=4, dim_y=4, dim_z=4, cell_x=0.05,
                          cell_y=0.05, cell_z=0.05, density=500.0, k_mu=1e5, k_lambda=1e5,
                          k_damp=10.0, particle_radius=0.01)  # fmt: skip
    if mass is not None:
        add_box(builder, (0, 0, 0.32), mass, size={"hx": 0.12, "hy": 0.12})
    model = finalize(builder)
    return model, run(model, 240, 1 / 60, initial_guess="previous")


def test_a_soft_block_carries_a_box() -> None:
    """The contacts hold the weight, and the block shortens as its modulus E says."""
    heights = []
    for mass in (None, 8.0):
        model, state = block_under(mass)
        z = state.particle_q.numpy()[:, 2]
        order = np.argsort(model.particle_q.numpy()[:, 2], kind="stable")
        bottom, top = z[order[:25]], z[order[-25:]]
        heights.append(top.mean() - bottom.mean())
    weight, e = 8.0 * G, 1e5 * (3 * 1e5 + 2 * 1e5) / (1e5 + 1e5)
    under = KE * (0.01 - bottom).clip(0).sum()
    above = KE * (top + 0.01 - (state.body_q.numpy()[0, 2] - 0.1)).clip(0).sum()
    assert above == pytest.approx(weight, rel=1e-3)
    assert under == pytest.approx(weight + G * model.particle_mass.numpy().sum(), rel=1e-3)
    assert heights[0] - heights[1] == pytest.approx(weight * 0.2 / (0.04 * e), rel=0.1)
    assert abs(float(state.body_qd.numpy()[0, 2])) < 1e-5


def test_a_ball_rests_in_a_hammock() -> None:
    builder = builder_of()
    add_sheet(builder, 10, tri_ke=2e3, tri_ka=2e3, tri_kd=2.0, fix_left=True, fix_right=True)
    ball = builder.add_body(xform=((0, 0, 0.11), UPRIGHT))
    density = 5.0 / (4 / 3 * np.pi * 1e-3)
    builder.add_shape_sphere(
        ball, radius=0.1, cfg=novaphy.ShapeConfig(ke=KE, kd=0.0, mu=0.5, density=density)
    )
    model = finalize(builder)
    _, _, energy = momenta(model, model.state())

    def see(_: int, state: novaphy.State) -> None:
        assert momenta(model, state)[2] < energy

    state = run(model, 240, 1 / 120, see, initial_guess="previous")
    apart = state.body_q.numpy()[0, :3] - state.particle_q.numpy()
    distance = np.linalg.norm(apart, axis=1)
    force = KE * (apart * ((0.11 - distance).clip(0) / distance)[:, None]).sum(axis=0)
    assert force == pytest.approx((0, 0, 5.0 * G), abs=0.01 * G)
    assert np.abs(state.body_qd.numpy()).max() < 1e-3


def test_a_plate_slides_over_particles_until_friction_stops_it() -> None:
    builder = builder_of()
    add_sheet(builder, 4, mass=0.0)
    plate = add_box(builder, (-0.03, 0, 0.02 - 8 * G / (25 * KE)), 8.0,
                    size={"hx": 0.6, "hy": 0.6, "hz": 0.01})  # fmt: skip
    builder.body_qd[plate] = (0.8, 0, 0, 0, 0, 0)
    state = run(finalize(builder), 80, 1 / 240)
    way = 0.8**2 / (2 * 0.5 * G) - 0.8 / 480  # implicit Euler takes v dt / 2
    assert state.body_q.numpy()[0, 0] + 0.03 == pytest.approx(way, rel=0.01)
    assert np.abs(state.body_qd.numpy()[:, :3]).max() < 1e-3


def test_a_ball_rolls_over_a_sheet() -> None:
    builder = builder_of()
    builder.add_ground_plane()
    builder.add_cloth_grid(pos=(-0.1, -0.2, 0.01), dim_x=12, dim_y=8, cell_x=0.05, cell_y=0.05,
                           mass=2e-3, tri_ke=2e3, tri_ka=2e3, tri_kd=2.0, edge_ke=1e-3,
                           particle_radius=0.01, fix_left=True, fix_right=True)  # fmt: skip
    ball = builder.add_body(xform=((0, 0, 0.12), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1)
    builder.body_qd[ball] = (1, 0, 0, 0, 0, 0)
    state = run(finalize(builder), 80, 1 / 240)
    speed, spin = (float(state.body_qd.numpy()[0, k]) for k in (0, 4))
    assert 0.4 < speed < 5 / 7  # the sheet takes a part
    assert spin * 0.1 == pytest.approx(speed, rel=0.15)
    assert state.body_q.numpy()[0, 2] == pytest.approx(0.115, abs=0.005)


def test_a_kinematic_plate_lifts_a_sheet() -> None:
    builder = builder_of()
    add_sheet(builder, 8, z=0.06)
    plate = add_box(builder, (0, 0, 0), 1.0, size={"hx": 0.3, "hy": 0.3, "hz": 0.05},
                    is_kinematic=True)  # fmt: skip
    builder.body_qd[plate] = (0.2, 0, 0.1, 0, 0, 0)
    state = run(finalize(builder), 60, 1 / 120)
    assert state.particle_qd.numpy() == pytest.approx(np.tile((0.2, 0, 0.1), (81, 1)), abs=1e-3)
    assert state.particle_q.numpy()[:, 2] == pytest.approx(0.11, abs=1e-3)
    assert state.body_q.numpy()[0, :3] == pytest.approx((0.1, 0, 0.05), abs=1e-5)


def pile() -> novaphy.Model:
    """Return a model of four boxes above a hammock."""
    builder = builder_of()
    add_sheet(builder, 12, fix_left=True, fix_right=True)
    for k in range(4):
        add_box(builder, (0.05 * (-1) ** k, 0, 0.08 + 0.13 * k), 1.0,
                size={"hx": 0.06, "hy": 0.06, "hz": 0.06})  # fmt: skip
    return finalize(builder)


@pytest.mark.parametrize("options", [{}, {"particle_enable_self_contact": True}])
def test_the_bits_are_those_of_one_thread(options: dict[str, Any]) -> None:
    model, before = pile(), novaphy.num_threads()
    results = []
    for threads in (1, 3):
        novaphy.set_num_threads(threads)
        state = run(model, 40, 1 / 120, **options)
        results.append((state.body_q.numpy(), state.particle_q.numpy()))
    novaphy.set_num_threads(before)
    for one, several in zip(*results, strict=True):
        assert np.array_equal(one, several)
    assert np.abs(results[0][1][:, 2]).max() > 0.01


def test_a_rollout_with_checkpoints_has_the_bits_of_steps() -> None:
    model = pile()
    expected = run(model, 20, 1 / 120, initial_guess="adaptive")
    diff = pytest.importorskip("novaphy.diff")
    trajectory = diff.Trajectory(model, 20, checkpoint=8)
    solver = SolverVBD(model, initial_guess="adaptive")
    pipeline = novaphy.CollisionPipeline(model)
    solver.rollout(trajectory, None, None, 1 / 120, pipeline=pipeline)
    assert np.array_equal(trajectory[20].body_q.numpy(), expected.body_q.numpy())
    assert np.array_equal(trajectory.recompute(20).particle_q.numpy(), expected.particle_q.numpy())


def test_coarse_is_off_beside_dynamic_bodies() -> None:
    builder = builder_of()
    add_sheet(builder, 4)
    add_box(builder, (0, 0, 0.105), 1.0)
    model = finalize(builder)
    assert SolverVBD(model, coarse="auto").coarse is None
    auto, none = (run(model, 2, 1 / 240, coarse=coarse) for coarse in ("auto", None))
    assert np.array_equal(auto.particle_q.numpy(), none.particle_q.numpy())


def test_a_normal_that_is_not_finite_is_named() -> None:
    builder = builder_of()
    add_sheet(builder, 4)
    add_box(builder, (0, 0, 0.105), 1.0)
    model = finalize(builder)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state = model.state()
    pipeline.collide(state, contacts)
    normals = contacts.soft_contact_normal.numpy()
    normals[3] = np.nan
    contacts.soft_contact_normal.assign(normals)
    with pytest.raises(ValueError, match="soft contact 3 of body 0"):
        SolverVBD(model).step(state, model.state(), None, contacts, 1 / 120)
