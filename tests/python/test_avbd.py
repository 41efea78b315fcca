"""Rigid bodies in SolverVBD, against closed forms and conservation laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from vbd_steps import H, rotation, run

import novaphy
from novaphy.solvers import SolverVBD

G = 9.81
BOX = {"hx": 0.1, "hy": 0.1, "hz": 0.1}  # 8 kg at 1,000 kg/m^3


def builder_of(ke: float = 1e5, mu: float = 0.5, **options: Any) -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder(**options)
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=ke, kd=0.0, mu=mu, density=1000.0)
    return builder


def add_box(builder: novaphy.ModelBuilder, pos: tuple, link: bool = False, **size: float) -> int:
    add = builder.add_link if link else builder.add_body
    body = add(xform=(pos, (0, 0, 0, 1)))
    builder.add_shape_box(body, **{**BOX, **size})
    return body


def momenta(model: novaphy.Model, state: novaphy.State) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the momentum, the angular momentum about the origin, and the kinetic energy."""
    linear, angular, energy = np.zeros(3), np.zeros(3), 0.0
    q, qd = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
    for b in range(model.body_count):
        turn = rotation(q[b, 3:])
        inertia = turn @ model.body_inertia.numpy()[b] @ turn.T
        mass = float(model.body_mass.numpy()[b])
        p, spin = mass * qd[b, :3], inertia @ qd[b, 3:]
        linear += p
        angular += np.cross(q[b, :3] + turn @ model.body_com.numpy()[b], p) + spin
        energy += 0.5 * (p @ qd[b, :3] + spin @ qd[b, 3:])
    return linear, angular, energy


def test_a_projectile_follows_implicit_euler() -> None:
    builder = builder_of()
    body = builder.add_body(xform=((0, 0, 5), (0, 0, 0, 1)), mass=2.0, inertia=np.diag([1, 2, 3]))
    builder.body_qd[body] = (1, 2, 3, 0, 0, 0)
    state = run(builder.finalize(), 60)
    height = 5 + 3 * 0.5 - G * H * H * 60 * 61 / 2
    assert np.allclose(state.body_q.numpy()[0, :3], (0.5, 1.0, height), atol=2e-6)
    assert np.allclose(state.body_qd.numpy()[0, :3], (1, 2, 3 - G * 0.5), atol=2e-6)


@pytest.mark.parametrize("guess", ["previous", "adaptive"])
def test_a_body_that_touches_nothing_does_not_depend_on_the_guess(guess: str) -> None:
    builder = builder_of()
    builder.body_qd[add_box(builder, (0, 0, 5))] = (1, 2, 3, 1, 2, 3)
    model = builder.finalize()
    state, expected = run(model, 20, initial_guess=guess), run(model, 20)
    assert np.array_equal(state.body_q.numpy(), expected.body_q.numpy())


def test_a_free_spin_keeps_energy_and_momentum() -> None:
    builder = builder_of(gravity=0.0)
    body = builder.add_body(mass=1.0, inertia=np.diag([0.02, 0.05, 0.06]), com=(0.1, 0, 0))
    builder.body_qd[body] = (0, 0, 0, 0.1, 8.0, 0.1)  # about the middle axis: it tumbles
    model = builder.finalize()
    _, before, energy = momenta(model, model.state())
    lengths, energies = [], []

    def see(k: int, state: novaphy.State) -> None:
        if k % 10 == 9:
            momentum, angular, now = momenta(model, state)
            assert np.linalg.norm(momentum) < 1e-5
            lengths.append(np.linalg.norm(angular) / np.linalg.norm(before))
            energies.append(now / energy)

    state = run(model, 1200, 1 / 240, see)
    assert np.abs(np.array(energies) - 1).max() < 1e-3
    assert np.abs(np.array(lengths) - 1).max() < 1e-3
    angular = momenta(model, state)[1]
    assert np.linalg.norm(angular - before) < 0.02 * np.linalg.norm(before)
    assert rotation(state.body_q.numpy()[0, 3:])[1, 1] < 0.99  # the body has turned over


def test_a_box_at_rest_sinks_by_its_weight() -> None:
    builder = builder_of(ke=2e4)
    builder.add_ground_plane()
    add_box(builder, (0, 0, 0.1))
    model = builder.finalize()
    state = run(model, 240)
    assert 0.1 - state.body_q.numpy()[0, 2] == pytest.approx(8 * G / (4 * 2e4), rel=0.02)
    assert np.abs(state.body_qd.numpy()).max() < 1e-4


@pytest.mark.parametrize("ke", [1e4, 1e5, 1e6])
def test_a_box_that_starts_in_the_ground_rises_slowly(ke: float) -> None:
    builder = builder_of(ke)
    builder.add_ground_plane()
    add_box(builder, (0, 0, 0.05))
    heights = []
    state = run(builder.finalize(), 240, see=lambda k, s: heights.append(s.body_q.numpy()[0, 2]))
    assert max(heights) < 0.115  # 0.5 m/s reach 13 mm above the ground
    assert state.body_q.numpy()[0, 2] == pytest.approx(0.1 - 8 * G / (4 * ke), abs=2e-5)


@pytest.mark.parametrize("ke", [1e5, 1e7])
def test_a_stack_of_ten_stands(ke: float) -> None:
    builder = builder_of(ke=ke)
    builder.add_ground_plane()
    for k in range(10):
        add_box(builder, (0, 0, 0.1 + 0.2 * k))
    speeds = []

    def see(k: int, state: novaphy.State) -> None:
        if k >= 240:
            speeds.append(np.abs(state.body_qd.numpy()[:, :3]).max())

    state = run(builder.finalize(), 480, see=see)
    sink = 1.9 - state.body_q.numpy()[9, 2]
    assert sink == pytest.approx(55 * 8 * G / (4 * ke), rel=0.02)
    assert max(speeds) < 1e-3


def test_a_stiff_stack_that_is_built_askew_comes_to_rest() -> None:
    builder = builder_of(ke=1e7)
    builder.add_ground_plane()
    for k in range(8):
        add_box(builder, (0.01 * (-1) ** k, 0.005 * (k % 3), 0.1 + 0.202 * k))
    state = run(builder.finalize(), 480)
    assert np.abs(state.body_qd.numpy()[:, :3]).max() < 1e-3
    assert state.body_q.numpy()[7, 2] == pytest.approx(1.5, abs=1e-3)


def test_a_wall_of_bricks_stands() -> None:
    """Every brick rests on two others, so that contacts close cycles."""
    builder = builder_of()
    builder.add_ground_plane()
    for row in range(4):
        for k in range(4 - row):
            add_box(builder, (0.22 * (k + 0.5 * row), 0, 0.1 + 0.2 * row))
    state = run(builder.finalize(), 360)
    assert np.abs(state.body_qd.numpy()[:, :3]).max() < 1e-2
    assert state.body_q.numpy()[9, 2] == pytest.approx(0.7, abs=1.5e-3)


def test_a_sliding_box_stops_where_friction_says() -> None:
    speed, dt = 2.58, 1 / 240
    builder = builder_of()
    builder.add_ground_plane()
    body = add_box(builder, (0, 0, 0.1 - 8 * G / 4e5))
    builder.body_qd[body] = (speed, 0, 0, 0, 0, 0)
    state = run(builder.finalize(), 240, dt)
    way = float(state.body_q.numpy()[0, 0])
    assert way == pytest.approx(speed**2 / (2 * 0.5 * G), rel=0.01)
    speeds = np.maximum(speed - 0.5 * G * dt * np.arange(1, 241), 0)  # of implicit Euler
    assert way == pytest.approx(speeds.sum() * dt, rel=1e-3)
    assert np.abs(state.body_qd.numpy()).max() < 1e-4


@pytest.mark.parametrize("mu", [0.4, 0.6])
def test_a_box_on_a_slope_sticks_or_slides(mu: float) -> None:
    slope = np.arctan(0.5)
    builder = builder_of(mu=mu)
    builder.add_ground_plane()
    add_box(builder, (0, 0, 0.1 - 8 * G * np.cos(slope) / 4e5))
    model = builder.finalize()
    model.set_gravity((G * np.sin(slope), 0, -G * np.cos(slope)))
    state = run(model, 120)
    way = float(state.body_q.numpy()[0, 0])
    if mu > 0.5:
        assert abs(way) < 2e-4
    else:
        pull = G * (np.sin(slope) - mu * np.cos(slope))
        assert way == pytest.approx(pull * H * H * 120 * 121 / 2, rel=0.01)


def test_a_sliding_sphere_begins_to_roll() -> None:
    builder = builder_of()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, 0.1), (0, 0, 0, 1)))
    builder.add_shape_sphere(body, radius=0.1)
    builder.body_qd[body] = (2, 0, 0, 0, 0, 0)
    state = run(builder.finalize(), 240)
    assert state.body_qd.numpy()[0, 0] == pytest.approx(2 * 5 / 7, rel=0.005)
    assert state.body_qd.numpy()[0, 4] == pytest.approx(20 * 5 / 7, rel=0.005)


def test_a_collision_keeps_momentum_and_angular_momentum() -> None:
    builder = builder_of(gravity=0.0)
    for pos, speed in (((0, 0, 0), 1.0), ((0.25, 0.08, 0.03), -1.0)):
        body = add_box(builder, pos)
        builder.body_qd[body] = (speed, 0, 0, 0, 0, 0)
    model = builder.finalize()
    linear, angular, energy = momenta(model, model.state())
    state = run(model, 60)
    after = momenta(model, state)
    exchanged = 8.0 * np.abs(state.body_qd.numpy()[0, 0] - 1.0)
    assert exchanged > 4.0
    assert np.linalg.norm(after[0] - linear) < 1e-5 * exchanged
    assert np.linalg.norm(after[1] - angular) < 5e-3 * exchanged * 0.1
    assert after[2] <= energy


def test_a_box_rides_on_a_kinematic_plate() -> None:
    builder = builder_of()
    plate = builder.add_body(xform=((0, 0, 0.1), (0, 0, 0, 1)), is_kinematic=True)
    builder.add_shape_box(plate, hx=1.0, hy=1.0, hz=0.1)
    builder.body_qd[plate] = (0.5, 0, 0, 0, 0, 0)
    add_box(builder, (0, 0, 0.3))
    state = run(builder.finalize(), 240)
    assert np.allclose(state.body_qd.numpy()[1, :3], (0.5, 0, 0), atol=1e-3)
    assert state.body_q.numpy()[0, 0] == pytest.approx(1.0, rel=1e-5)


def chain_of(links: int, heavy: float = 1.0, **options: Any) -> novaphy.Model:
    builder = builder_of(**options)
    before = -1
    for k in range(links):
        density = 1000.0 * (heavy if k == links - 1 else 1.0)
        body = builder.add_link(xform=((0.1 + 0.2 * k, 0, 0), (0, 0, 0, 1)))
        builder.add_shape_box(
            body, hx=0.1, hy=0.02, hz=0.02, cfg=novaphy.ShapeConfig(density=density)
        )
        builder.add_joint_ball(
            before,
            body,
            parent_xform=((0.1 if k else 0, 0, 0), (0, 0, 0, 1)),
            child_xform=((-0.1, 0, 0), (0, 0, 0, 1)),
        )
        before = body
    builder.add_articulation(list(range(links)))
    return builder.finalize()


def gap_of(state: novaphy.State) -> float:
    q = state.body_q.numpy().astype(float)
    half = np.array([rotation(row[3:])[:, 0] * 0.1 for row in q])
    ends = np.vstack([np.zeros(3), (q[:, :3] + half)[:-1]])
    return float(np.linalg.norm(ends - (q[:, :3] - half), axis=1).max())


@pytest.mark.parametrize(("links", "heavy"), [(10, 1.0), (10, 100.0), (40, 1.0)])
def test_a_chain_that_falls_stays_together(links: int, heavy: float) -> None:
    model = chain_of(links, heavy)
    gaps, energies = [], []

    def see(k: int, state: novaphy.State) -> None:
        if k % 6 == 5:
            gaps.append(gap_of(state))
            weight = model.body_mass.numpy() * G
            energies.append(momenta(model, state)[2] + weight @ state.body_q.numpy()[:, 2])

    run(model, 240, see=see)
    assert max(gaps) < 1e-3
    assert max(energies) < 0.0  # the chain starts at rest at the height 0


def test_joints_keep_momentum_and_angular_momentum() -> None:
    builder = builder_of(gravity=0.0)
    first = add_box(builder, (0, 0, 0))
    second = add_box(builder, (0.4, 0, 0))
    frames = {"parent_xform": ((0.2, 0, 0), (0, 0, 0, 1)),
              "child_xform": ((-0.2, 0, 0), (0, 0, 0, 1))}  # fmt: skip
    builder.add_joint_ball(first, second, **frames)
    builder.body_qd[first] = (0, 0.2, 0, 1, 0, 1)
    builder.body_qd[second] = (0, 0.6, 0, 0, 2, 1)
    model = builder.finalize()
    linear, angular, _ = momenta(model, model.state())
    after = momenta(model, run(model, 240))
    assert np.linalg.norm(after[0] - linear) < 1e-4 * np.linalg.norm(linear)
    assert np.linalg.norm(after[1] - angular) < 0.02 * np.linalg.norm(angular)


def wheel_of(**axis: Any) -> tuple[novaphy.Model, float]:
    """Return a box on a vertical hinge of the world, and its inertia about the hinge."""
    builder = builder_of(gravity=0.0)
    body = add_box(builder, (0, 0, 0), link=True)
    builder.add_articulation([builder.add_joint_revolute(-1, body, axis=(0, 0, 1), **axis)])
    model = builder.finalize()
    return model, float(model.body_inertia.numpy()[0, 2, 2])


def test_a_drive_gives_at_most_its_effort() -> None:
    model, inertia = wheel_of(target_q=100.0, target_ke=1e4, effort_limit=0.5)
    state = run(model, 120)
    assert state.body_qd.numpy()[0, 5] == pytest.approx(0.5 / inertia, rel=1e-3)


def test_a_drive_holds_its_target_over_several_turns() -> None:
    model, _ = wheel_of(target_q=10.0, target_ke=50.0, target_kd=5.0)
    states: list[float] = []

    def see(k: int, state: novaphy.State) -> None:
        z, w = state.body_q.numpy()[0, 5:]
        states.append(2 * np.arctan2(z, w))

    state = run(model, 480, see=see)
    assert np.unwrap(states)[-1] == pytest.approx(10.0, abs=1e-3)
    assert np.abs(state.body_qd.numpy()).max() < 1e-3


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ({}, 1.0),
        ({"friction": 0.2}, 0.6),
        ({"armature": 0.1}, "armature"),
        ({"damping": 0.5}, "damping"),
    ],
)
def test_a_torque_turns_a_wheel(axis: dict[str, float], expected: float | str) -> None:
    model, inertia = wheel_of(**axis)
    control = model.control()
    control.joint_f.assign(np.array([0.5], np.float32))
    speed = run(model, 120, control=control).body_qd.numpy()[0, 5]
    if expected == "damping":  # 0.5 N m against 0.5 N m s
        assert speed == pytest.approx(1.0, rel=1e-3)
    elif expected == "armature":
        assert speed == pytest.approx(0.5 / (inertia + 0.1), rel=1e-3)
    else:
        assert speed == pytest.approx(0.5 * float(expected) / inertia, rel=1e-3)


def test_joint_forces_carry_the_weight() -> None:
    builder = builder_of()
    arm = add_box(builder, (0.2, 0, 0), link=True)
    hanging = add_box(builder, (0.4, 0, -0.3), link=True)
    hinge = builder.add_joint_revolute(-1, arm, axis=(0, 1, 0), target_ke=1e5, target_kd=1e3,
                                       child_xform=((-0.2, 0, 0), (0, 0, 0, 1)))  # fmt: skip
    ball = builder.add_joint_ball(arm, hanging, parent_xform=((0.2, 0, 0), (0, 0, 0, 1)),
                                  child_xform=((0, 0, 0.3), (0, 0, 0, 1)))  # fmt: skip
    builder.add_articulation([hinge, ball])
    add_box(builder, (5, 0, 5))  # with a FREE joint
    solver = SolverVBD(builder.finalize())
    with pytest.raises(RuntimeError, match="joint_forces: expected a step before"):
        solver.joint_forces()
    state, after = solver.model.state(), solver.model.state()
    for _ in range(120):
        solver.step(state, after, None, None, H)
        state, after = after, state
    weight = 8 * G
    moment = -(0.2 * weight + 0.4 * weight)  # the arm points along x
    expected = [(0, 0, 2 * weight, 0, moment, 0), (0, 0, weight, 0, 0, 0), (0,) * 6]
    assert solver.joint_forces() == pytest.approx(np.array(expected), abs=0.01 * weight)


def test_a_limit_yields_by_its_stiffness() -> None:
    model, _ = wheel_of(limit_lower=-0.3, limit_upper=0.3, limit_ke=100.0, limit_kd=5.0)
    control = model.control()
    control.joint_f.assign(np.array([2.0], np.float32))
    q = run(model, 480, control=control).body_q.numpy()[0]
    assert 2 * np.arctan2(q[5], q[6]) == pytest.approx(0.3 + 2.0 / 100.0, rel=1e-3)


def test_a_prismatic_drive_carries_a_weight_and_a_fixed_joint_an_arm() -> None:
    builder = builder_of()
    lift = add_box(builder, (0, 0, 0), link=True)
    arm = add_box(builder, (0.3, 0, 0), link=True)
    slide = builder.add_joint_prismatic(
        -1, lift, axis=(0, 0, 1), target_q=0.0, target_ke=1e4, target_kd=1e3
    )
    hold = builder.add_joint_fixed(lift, arm, parent_xform=((0.3, 0, 0), (0, 0, 0, 1)))
    builder.add_articulation([slide, hold])
    q = run(builder.finalize(), 480).body_q.numpy()
    assert q[0, 2] == pytest.approx(-16 * G / 1e4, rel=1e-3)
    assert np.allclose(q[0, :2], 0, atol=1e-4)
    assert np.allclose(q[1, :3] - q[0, :3], (0.3, 0, 0), atol=3e-4)
    assert np.allclose(q[:, 3:], (0, 0, 0, 1), atol=1e-3)


def test_a_distance_joint_is_a_rope() -> None:
    builder = builder_of()
    body = add_box(builder, (0.5, 0, 0), link=True)
    builder.add_joint_distance(-1, body, min_distance=0.0, max_distance=0.5)
    model = builder.finalize()
    lengths = []

    def see(k: int, state: novaphy.State) -> None:
        lengths.append(np.linalg.norm(state.body_q.numpy()[0, :3]))

    run(model, 120, see=see)
    assert max(lengths) < 0.5 + 5e-4


def test_a_loop_of_joints_stays_closed() -> None:
    """Four bars in a square hang on a corner; the last joint closes the loop."""
    builder = builder_of(mu=0.0)
    turns = [np.pi / 2 * k for k in range(4)]
    corners = [np.array((np.sin(t + np.pi / 4), 0, np.cos(t + np.pi / 4))) / 5 for t in turns]
    for k, turn in enumerate(turns):
        center = (corners[k] + corners[(k + 1) % 4]) / 2
        body = builder.add_body(
            xform=(tuple(center), (0, np.sin((turn + np.pi) / 2), 0, np.cos((turn + np.pi) / 2)))
        )
        builder.add_shape_box(body, hx=0.02, hy=0.02, hz=0.1)
    model = builder.finalize()
    half = np.linalg.norm(corners[1] - corners[0]) / 2
    along = [rotation(q[3:]).T @ (corners[(k + 1) % 4] - corners[k]) / 2
             for k, q in enumerate(model.body_q.numpy())]  # fmt: skip
    for k in range(4):
        builder.add_joint_ball(
            k,
            (k + 1) % 4,
            parent_xform=(tuple(along[k]), (0, 0, 0, 1)),
            child_xform=(tuple(-along[(k + 1) % 4]), (0, 0, 0, 1)),
        )
    builder.add_joint_ball(
        -1, 0, parent_xform=(tuple(corners[0]), (0, 0, 0, 1)),
        child_xform=(tuple(-along[0]), (0, 0, 0, 1))
    )  # fmt: skip
    gaps = []

    def see(k: int, state: novaphy.State) -> None:
        q = state.body_q.numpy().astype(float)
        ends = [row[:3] + rotation(row[3:]) @ a for row, a in zip(q, along, strict=True)]
        starts = [row[:3] - rotation(row[3:]) @ a for row, a in zip(q, along, strict=True)]
        gaps.append(max(np.linalg.norm(ends[i] - starts[(i + 1) % 4]) for i in range(4)))

    run(builder.finalize(), 240, see=see)
    assert half == pytest.approx(np.sqrt(0.02), rel=1e-6)
    assert max(gaps) < 1e-3


def stack_of(boxes: int) -> novaphy.Model:
    builder = builder_of()
    builder.add_ground_plane()
    for k in range(boxes):
        add_box(builder, (0.01 * k, 0, 0.11 + 0.21 * k))
    return builder.finalize()


@pytest.mark.parametrize("guess", ["inertia", "previous", "adaptive"])
def test_a_rollout_with_checkpoints_has_the_bits_of_steps(guess: str) -> None:
    model = stack_of(3)
    expected = run(model, 24, initial_guess=guess).body_q.numpy()
    diff = pytest.importorskip("novaphy.diff")
    trajectory = diff.Trajectory(model, 24, checkpoint=8)
    pipeline = novaphy.CollisionPipeline(model)
    SolverVBD(model, initial_guess=guess).rollout(trajectory, None, None, H, pipeline=pipeline)
    assert np.array_equal(trajectory[24].body_q.numpy(), expected)
    again = trajectory.recompute(23)
    assert np.array_equal(again.body_q.numpy(), run(model, 23, initial_guess=guess).body_q.numpy())


def test_the_bits_are_those_of_one_thread() -> None:
    builder = builder_of()
    builder.add_ground_plane()
    for k in range(60):
        add_box(builder, (0.3 * (k // 3), 0.001 * k, 0.11 + 0.21 * (k % 3)))
    model = builder.finalize()
    before = novaphy.num_threads()
    results = []
    for threads in (1, 3):
        novaphy.set_num_threads(threads)
        results.append(run(model, 12).body_q.numpy())
    novaphy.set_num_threads(before)
    assert np.array_equal(results[0], results[1])


def test_reset_forgets_the_multipliers() -> None:
    model = stack_of(2)
    solver = SolverVBD(model)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    results = []
    for _ in range(2):
        state, after = model.state(), model.state()
        for _ in range(20):
            pipeline.collide(state, contacts)
            solver.step(state, after, None, contacts, H)
            state, after = after, state
        results.append(state.body_q.numpy())
        solver.reset()
    assert np.array_equal(results[0], results[1])


def test_contact_forces_carry_the_weight() -> None:
    model = stack_of(2)
    solver = SolverVBD(model)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    for _ in range(240):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, H)
        state, after = after, state
    rows = slice(0, contacts.active_rigid_contact_count)
    force = contacts.rigid_contact_force.numpy()[rows]
    ground = contacts.rigid_contact_shape0.numpy()[rows] == 0
    assert force[ground].sum(axis=0) == pytest.approx((0, 0, 16 * G), abs=0.05)
    assert force[~ground].sum(axis=0) == pytest.approx((0, 0, 8 * G), abs=0.05)


@pytest.mark.parametrize("kd", [0.0, 500.0])
def test_contact_forces_are_the_change_of_momentum_and_friction(kd: float) -> None:
    builder = builder_of(gravity=0.0)
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e5, kd=kd, mu=0.5, density=1000.0)
    builder.add_ground_plane()
    box = add_box(builder, (0, 0, 0.105))
    builder.body_qd[box] = (3.0, 0, -1.0, 0, 0, 0)
    model = builder.finalize()
    solver, pipeline = SolverVBD(model), novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    pushed = 0
    for _ in range(12):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, H / 4)
        change = 8.0 * (after.body_qd.numpy() - state.body_qd.numpy())[0, :3]
        rows = slice(0, contacts.active_rigid_contact_count)
        force = contacts.rigid_contact_force.numpy()[rows].sum(axis=0)
        state, after = after, state
        assert np.allclose(force * H / 4, change, atol=2e-3)
        if force[2] > 10.0:
            pushed += 1
            assert force[0] == pytest.approx(-0.5 * force[2], rel=1e-2)
    assert pushed > 2


def test_a_cloth_and_bodies_move_in_one_step() -> None:
    builder = builder_of()
    builder.add_ground_plane()
    add_box(builder, (3, 0, 0.1))
    builder.add_cloth_grid(pos=(0, 0, 1), dim_x=4, dim_y=4, cell_x=0.05, cell_y=0.05, mass=1e-3,
                           tri_ke=1e3, tri_ka=1e3, fix_left=True)  # fmt: skip
    builder.color()
    state = run(builder.finalize(), 60)
    assert state.particle_q.numpy()[:, 2].min() < 0.95
    assert state.body_q.numpy()[0, 2] == pytest.approx(0.1, abs=1e-3)


def refused(match: str, change: Callable[[novaphy.ModelBuilder], object], **options: Any) -> None:
    builder = builder_of()
    change(builder)
    builder.color()
    with pytest.raises(NotImplementedError, match=match):
        SolverVBD(builder.finalize(), **options)


def test_what_rows_do_not_do_is_refused_by_name() -> None:
    def joint(kind: str, **options: Any) -> Callable[[novaphy.ModelBuilder], object]:
        def add(builder: novaphy.ModelBuilder) -> None:
            body = add_box(builder, (0, 0, 0), link=True)
            made = getattr(builder, f"add_joint_{kind}")(-1, body, **options)
            builder.add_articulation([made])

        return add

    refused("PLANAR", joint("planar"))
    refused("joint_velocity_limit", joint("revolute", axis=(0, 0, 1), velocity_limit=1.0))
    refused("tolerance", lambda b: add_box(b, (0, 0, 0)), tolerance=1e-3)
    refused("converged", lambda b: add_box(b, (0, 0, 0)), solve="converged")


def test_a_capture_and_gradients_are_refused() -> None:
    model = stack_of(2)
    solver = SolverVBD(model)
    assert not solver.supports_graph_capture
    a, b = model.state(), model.state()
    solver.step(a, b, None, None, H)
    nova = pytest.importorskip("novaphy.nova")
    with nova.ScopedCapture(), pytest.raises(NotImplementedError, match="bodies"):
        solver.step(a, b, None, None, H)
    with pytest.raises(NotImplementedError, match='gradient: expected "implicit"'):
        novaphy.solvers.DiffSolverVBD(model)


def test_edits_that_rows_do_not_have_are_refused_in_the_next_step() -> None:
    model, _ = wheel_of()
    solver, state, after = SolverVBD(model), model.state(), model.state()
    solver.step(state, after, None, None, H)
    model.joint_velocity_limit.assign(np.array([2.0], np.float32))
    with pytest.raises(NotImplementedError, match=r"joint_velocity_limit\[0\]"):
        solver.step(state, after, None, None, H)
    free = stack_of(1)
    control = free.control()
    control.joint_f.assign(np.ones(6, np.float32))
    with pytest.raises(NotImplementedError, match=r"joint_f\[0\]"):
        SolverVBD(free).step(free.state(), free.state(), control, None, H)


def test_a_step_in_place_has_the_bits_of_one_into_another_state() -> None:
    model = stack_of(2)
    expected = run(model, 8).body_q.numpy()
    solver, pipeline, state = SolverVBD(model), novaphy.CollisionPipeline(model), model.state()
    contacts = pipeline.contacts()
    for _ in range(8):
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, H)
    assert np.array_equal(state.body_q.numpy(), expected)


def test_a_pose_that_is_not_finite_is_named() -> None:
    model = stack_of(2)
    state = model.state()
    state.body_qd.assign(np.full((2, 6), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"body_qd\[0\]"):
        SolverVBD(model).step(state, model.state(), None, None, H)


def test_contacts_that_are_not_finite_or_fewer_than_none_are_named() -> None:
    model = stack_of(1)
    solver, pipeline, state = SolverVBD(model), novaphy.CollisionPipeline(model), model.state()
    contacts = pipeline.contacts()
    state.body_q.assign(np.float32([[0, 0, 0.1, 0, 0, 0, 1]]))
    pipeline.collide(state, contacts)
    normals = contacts.rigid_contact_normal.numpy()
    broken = normals.copy()
    broken[1] = np.nan
    contacts.rigid_contact_normal.assign(broken)
    with pytest.raises(ValueError, match="contact 1: expected finite points"):
        solver.step(state, model.state(), None, contacts, H)
    contacts.rigid_contact_normal.assign(normals)
    contacts.rigid_contact_count.assign(np.int32([-5]))
    with pytest.raises(ValueError, match="rigid_contact_count: expected at least 0, got -5"):
        solver.step(state, model.state(), None, contacts, H)


@pytest.mark.parametrize("value", [-1.0, np.nan])
@pytest.mark.parametrize("name", ["joint_friction", "joint_armature"])
def test_negative_friction_and_armature_are_named(name: str, value: float) -> None:
    model, _ = wheel_of()
    getattr(model, name).assign(np.float32([value]))
    with pytest.raises(ValueError, match=rf"{name}\[0\]: expected a finite number"):
        SolverVBD(model).step(model.state(), model.state(), None, None, H)
