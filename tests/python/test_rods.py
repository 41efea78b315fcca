"""Rods and cables of SolverVBD, against closed forms and the rod's equilibrium in float64."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vbd_steps import H, rotation, run

import novaphy
from novaphy.solvers import SolverFeatherstone, SolverSemiImplicit, SolverVBD

sys.path.insert(0, str(Path(__file__).parents[2] / "tools" / "bench"))
import avbd_scenes

DENSITY, RADIUS = 1000.0, 0.005
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def rod_of(links: int, length: float, radius: float, **material: Any) -> novaphy.Model:
    """Return a rod along x whose first link is fixed to the world."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    config = novaphy.ShapeConfig(density=DENSITY)
    points = [(length * k / links, 0.0, 0.0) for k in range(links + 1)]
    bodies, joints = builder.add_rod(points, radius=radius, cfg=config, **material)
    assert (len(bodies), len(joints)) == (links, links - 1)
    builder.add_joint_fixed(-1, bodies[0], parent_xform=builder.body_q[bodies[0]])
    return builder.finalize()


def loaded(
    model: novaphy.Model,
    steps: int,
    force: tuple = (0, 0, 0),
    moment: tuple = (0, 0, 0),
    keep: float = 1.0,
) -> novaphy.State:
    """Return the state after steps without contacts under a constant wrench on the last body.

    Each step keeps a part `keep` of the velocities, so that a state of rest comes soon.
    """
    solver = SolverVBD(model)
    state, after = model.state(), model.state()
    wrench = np.zeros((model.body_count, 6), np.float32)
    wrench[-1] = (*force, *moment)
    for _ in range(steps):
        state.body_f.assign(wrench)
        solver.step(state, after, None, None, H)
        state, after = after, state
        state.body_qd.assign(keep * state.body_qd.numpy())
    return state


@pytest.mark.parametrize(
    ("links", "bend", "steps"), [(20, 0.05, 200), (20, 5e-3, 800), (200, 0.05, 120)]
)
def test_a_cable_hangs_in_its_own_equilibrium(links: int, bend: float, steps: int) -> None:
    found = avbd_scenes.cable(links, bend, steps)
    assert found["tip_over_sag"] < 2e-3
    assert found["gap_mm"] < 0.01


def test_a_torque_twists_and_a_force_stretches_a_rod() -> None:
    links, length, twist, stretch, torque, pull = 6, 1.2, 20.0, 5e3, 10.0, 100.0
    material = {"twist_stiffness": twist, "bend_stiffness": 50.0, "stretch_stiffness": stretch}
    model = rod_of(links, length, radius=0.05, **material)
    state = loaded(model, 240, (pull, 0, 0), (torque, 0, 0), keep=0.5)
    way = length * (links - 1) / links
    turn = rotation(state.body_q.numpy()[-1, 3:]) @ rotation(model.body_q.numpy()[-1, 3:]).T
    assert np.arctan2(turn[2, 1], turn[1, 1]) == pytest.approx(torque / twist * way, rel=0.01)
    moved = state.body_q.numpy()[-1, 0] - model.body_q.numpy()[-1, 0]
    assert moved == pytest.approx(pull / stretch * way, rel=0.01)


def test_shear_and_bend_of_each_axis_have_their_own_stiffness() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    body = builder.add_body(mass=1.0, inertia=np.eye(3))
    builder.add_joint_rod(-1, body)
    model = builder.finalize()
    stiffness = np.array([0] * 6 + [100, 200, 400, 10, 20, 40], np.float32)
    model.joint_target_ke.assign(stiffness)
    model.joint_target_kd.assign(2 * np.sqrt(stiffness))  # critical for a mass and inertia of 1
    state = loaded(model, 400, (1, 1, 1))
    assert np.allclose(state.body_q.numpy()[0, :3], (0.01, 0.005, 0.0025), rtol=1e-3)
    for axis, angle in enumerate((0.1, 0.05, 0.025)):
        state = loaded(model, 400, moment=tuple(np.eye(3)[axis]))
        assert 2 * state.body_q.numpy()[0, 3 + axis] == pytest.approx(angle, rel=1e-3)


def test_a_damper_of_a_rod_limits_the_rate() -> None:
    damping, moment, length = 2.0, 4.0, 0.2
    material = {"twist_damping": damping, "bend_stiffness": 50.0, "twist_stiffness": 0.0}
    model = rod_of(2, 2 * length, radius=0.05, **material)
    state = loaded(model, 60, moment=(moment, 0, 0))
    assert state.body_qd.numpy()[1, 3] == pytest.approx(moment * length / damping, rel=0.01)


def test_a_free_rod_that_bends_keeps_its_momentum_and_angular_momentum() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    config = novaphy.ShapeConfig(density=DENSITY)
    points = [(0.05 * k, 0.0, 0.0) for k in range(9)]
    bodies, _ = builder.add_rod(points, radius=RADIUS, cfg=config, bend_stiffness=0.05)
    model = builder.finalize()
    mass, inertia = model.body_mass.numpy().astype(float), model.body_inertia.numpy().astype(float)
    state, after = model.state(), model.state()
    qd = np.zeros((len(bodies), 6), np.float32)
    qd[0, 4], qd[-1, 2], qd[-1, 3] = 5.0, 1.0, 2.0
    state.body_qd.assign(qd)

    def momenta(s: novaphy.State) -> np.ndarray:
        q, v = s.body_q.numpy().astype(float), s.body_qd.numpy().astype(float)
        p = mass[:, None] * v[:, :3]
        spin = [
            rotation(q[b, 3:]) @ inertia[b] @ rotation(q[b, 3:]).T @ v[b, 3:]
            for b in range(len(bodies))
        ]
        return np.concatenate([p.sum(0), (np.cross(q[:, :3], p) + spin).sum(0)])

    start, solver = momenta(state), SolverVBD(model)
    for _ in range(120):
        solver.step(state, after, None, None, H)
        state, after = after, state
    assert np.allclose(momenta(state)[:3], start[:3], atol=1e-3 * np.abs(start[:3]).max())
    assert np.allclose(momenta(state)[3:], start[3:], atol=2e-2 * np.abs(start[3:]).max())


def test_a_closed_rod_and_a_graph_join_at_their_nodes() -> None:
    ring = [(np.cos(a), np.sin(a), 1.0) for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    builder = novaphy.ModelBuilder()
    bodies, joints = builder.add_rod(ring, radius=0.02, closed=True, bend_stiffness=1.0)
    assert (len(bodies), len(joints)) == (12, 12)
    star = [(0, 0, 2), (1, 0, 2), (0, 1, 2), (-1, 0, 2)]
    bodies, joints = builder.add_rod_graph(star, [(0, 1), (0, 2), (3, 0)], radius=0.02)
    assert (len(bodies), len(joints)) == (3, 2)
    model = builder.finalize()
    frames = [model.joint_X_p.numpy(), model.joint_X_c.numpy()]
    q, ends = model.body_q.numpy(), [model.joint_parent.numpy(), model.joint_child.numpy()]
    for joint, side in itertools.product(joints, (0, 1)):
        body = q[ends[side][joint]]
        point = body[:3] + rotation(body[3:]) @ frames[side][joint, :3]
        assert np.allclose(point, star[0], atol=1e-6)
    state = run(model, 2, initial_guess="inertia")
    assert np.abs(state.body_qd.numpy()[:, 3:]).max() < 1e-3  # all fall alike: at rest in shape


def test_a_cable_that_falls_over_a_free_box_holds_and_comes_to_rest() -> None:
    builder, links = novaphy.ModelBuilder(), 20
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e4, kd=1.0, mu=0.5, density=DENSITY)
    builder.add_ground_plane()
    points = [(k / links - 0.5, 0.0, 0.3) for k in range(links + 1)]
    builder.add_rod(points, radius=0.01, bend_stiffness=0.01, bend_damping=1e-3)
    box = builder.add_body(xform=((0.0, 0.0, 0.1), IDENTITY))
    builder.add_shape_box(box, hx=0.05, hy=0.2, hz=0.1)
    model = builder.finalize()
    gaps = []

    def see(_: int, state: novaphy.State) -> None:
        q = state.body_q.numpy()[:links].astype(float)
        half = 0.5 / links * np.array([rotation(row[3:])[:, 2] for row in q])
        ends = (q[:-1, :3] + half[:-1]) - (q[1:, :3] - half[1:])
        gaps.append(np.linalg.norm(ends, axis=1).max())

    state = run(model, 300, see=see)
    assert max(gaps) < 1e-3
    assert np.abs(state.body_qd.numpy()[:, :3]).max() < 1e-3


def test_links_that_overlap_at_rest_do_not_collide() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    points = [(0.01 * k, 0.0, 0.0) for k in range(9)]
    builder.add_rod(points, radius=0.009, bend_stiffness=1.0)
    model = builder.finalize()
    pairs = {tuple(sorted(pair)) for pair in model.shape_collision_filter_pairs}
    assert (0, 4) in pairs and (0, 5) not in pairs
    state = run(model, 5)
    assert np.abs(state.body_qd.numpy()).max() < 1e-4


@pytest.mark.parametrize("solver", [SolverFeatherstone, SolverSemiImplicit])
def test_other_solvers_refuse_the_joint_by_name(solver: Any) -> None:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    builder.add_articulation([builder.add_joint_rod(-1, link)])
    with pytest.raises(NotImplementedError, match="ROD joint"):
        model = builder.finalize()
        solver(model).step(model.state(), model.state(), None, None, 1e-3)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"positions": [(0, 0, 0)]}, "positions: expected at least 2, got 1"),
        ({"positions": [(0, 0, 0), (0, 0, 0)]}, r"add_rod: positions\[1\]: expected more than"),
        ({"positions": [(0, 0, 0), (0, np.nan, 0)]}, r"add_rod: positions\[1\]: expected finite"),
        ({"radius": 0.0}, "radius: expected a finite number > 0, got 0"),
        ({"bend_stiffness": -1.0}, "bend_stiffness: expected a finite number >= 0, got -1"),
        ({"quaternions": [IDENTITY]}, "quaternions: expected 2, one for each link, got 1"),
        ({"quaternions": [IDENTITY] * 2}, r"quaternions\[0\]: expected a rotation of z"),
    ],
)
def test_bad_rods_are_named(change: dict[str, Any], match: str) -> None:
    positions = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    with pytest.raises(ValueError, match=match):
        novaphy.ModelBuilder().add_rod(**{"positions": positions, **change})


@pytest.mark.parametrize(
    ("node", "match"),
    [
        ((0, 0, 0), r"add_rod_graph: edges\[0\]: expected more than 1e-6 m"),
        ((np.nan, 0, 0), r"add_rod_graph: node_positions\[1\]: expected finite"),
    ],
)
def test_bad_nodes_of_a_graph_are_named(node: tuple, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        novaphy.ModelBuilder().add_rod_graph([(0, 0, 0), node], [(0, 1)])
