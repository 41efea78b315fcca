"""Kinematic bodies among articulations: they follow their twist, and push what they touch."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contacts import GRAVITY, UPRIGHT, simulate

import novaphy

DT = 1 / 240
SURFACE = novaphy.ShapeConfig(mu=0.5, density=1000.0)


def table(builder: novaphy.ModelBuilder, twist: tuple[float, ...], **xform: object) -> int:
    """A kinematic slab whose top is at z = 0."""
    body = builder.add_body(is_kinematic=True, xform=((0.0, 0.0, -0.1), UPRIGHT), **xform)
    builder.add_shape_box(body, hx=3.0, hy=3.0, hz=0.1, cfg=SURFACE)
    builder.body_qd[body] = twist
    return body


def cube(builder: novaphy.ModelBuilder, x: float, y: float = 0.0) -> int:
    body = builder.add_body(xform=((x, y, 0.1), UPRIGHT))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    return body


def test_a_kinematic_body_moves_as_in_the_semi_implicit_solver_whatever_pulls_at_it() -> None:
    builder = novaphy.ModelBuilder()
    turned = (0.1, -0.2, 0.3, 0.9273618495495704)
    body = builder.add_body(
        xform=((1.0, 2.0, 3.0), turned), com=(0.1, 0.2, -0.3), is_kinematic=True
    )
    builder.body_qd[body] = (0.3, -0.2, 0.5, 1.0, -2.0, 0.7)
    model = builder.finalize()
    moved = {}
    for name in ("SolverFeatherstone", "SolverSemiImplicit"):
        solver = getattr(novaphy.solvers, name)(model)
        state, after, control = model.state(), model.state(), model.control()
        control.joint_f.assign(np.full(6, 50.0, np.float32))
        for _ in range(240):
            state.body_f.assign(np.full((1, 6), -30.0, np.float32))
            solver.step(state, after, control, None, DT)
            state, after = after, state
        moved[name] = state.body_q.numpy()[0]
        np.testing.assert_allclose(state.body_qd.numpy()[0], builder.body_qd[body], atol=2e-6)
    assert np.linalg.norm(moved["SolverFeatherstone"][:3] - (1, 2, 3)) > 0.5
    np.testing.assert_allclose(*moved.values(), atol=1e-4)


def test_a_conveyor_drags_a_box_by_its_friction_and_then_carries_it() -> None:
    builder = novaphy.ModelBuilder()
    belt = table(builder, (0.6, 0.0, 0.0, 0.0, 0.0, 0.0))
    box = cube(builder, -1.0)
    _, _, velocities, contacts = simulate(builder, 1.0)
    times = np.arange(1, 241) * DT
    expected = np.minimum(0.5 * GRAVITY * times, 0.6)
    np.testing.assert_allclose(velocities[1:, box, 0], expected, atol=0.5 * GRAVITY * DT + 1e-4)
    assert abs(velocities[-1, box, 0] - 0.6) < 1e-4
    assert (velocities[:, belt] == np.float32([0.6, 0, 0, 0, 0, 0])).all()
    up = contacts.rigid_contact_force.numpy().sum(axis=0)
    np.testing.assert_allclose(np.abs(up), (0.0, 0.0, 8.0 * GRAVITY), atol=0.5)


def test_a_turntable_carries_a_box_round_while_friction_holds_it() -> None:
    """w^2 r is 2 m/s^2 at the inner box, which stays, and 5.8 at the outer, which slides off."""
    builder = novaphy.ModelBuilder()
    table(builder, (0.0, 0.0, 0.0, 0.0, 0.0, 2.0))
    inner, outer = cube(builder, 0.5), cube(builder, -1.45)
    for body, x in ((inner, 0.5), (outer, -1.45)):
        builder.body_qd[body] = (0.0, 2.0 * x, 0.0, 0.0, 0.0, 2.0)
    _, poses, velocities, _ = simulate(builder, 1.0, pgs_iterations=200)
    radius = np.hypot(poses[..., 0], poses[..., 1])
    assert np.abs(radius[:, inner] - 0.5).max() < 5e-3
    np.testing.assert_allclose(velocities[-1, inner, 5], 2.0, atol=5e-3)
    assert radius[-1, outer] > 1.7


def test_a_lift_raises_what_stands_on_it_and_a_ram_is_not_stopped() -> None:
    builder = novaphy.ModelBuilder()
    lift = table(builder, (0.0, 0.0, 0.4, 0.0, 0.0, 0.0))
    box = cube(builder, 0.0)
    ram = builder.add_body(is_kinematic=True, xform=((-0.4, 0.0, 0.1), UPRIGHT))
    builder.add_shape_box(ram, hx=0.1, hy=0.1, hz=0.05, cfg=SURFACE)
    builder.body_qd[ram] = (1.0, 0.0, 0.4, 0.0, 0.0, 0.0)
    _, poses, velocities, _ = simulate(builder, 1.0)
    assert abs(poses[-1, box, 2] - 0.5) < 6e-3
    assert abs((poses[-1, box, 0] - 0.1) - (poses[-1, ram, 0] + 0.1)) < 6e-3
    np.testing.assert_allclose(poses[-1, [lift, ram], :3], [(0, 0, 0.3), (0.6, 0, 0.5)], atol=1e-5)
    assert (velocities[:, ram] == np.float32([1.0, 0, 0.4, 0, 0, 0])).all()


def test_a_racket_returns_a_ball_with_twice_its_speed_more() -> None:
    """Restitution is of the velocity between the surfaces: -1 against 0.5 leaves with 2 m/s."""
    builder = novaphy.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    rubber = novaphy.ShapeConfig(mu=0.0, restitution=1.0)
    racket = builder.add_body(is_kinematic=True)
    builder.add_shape_box(racket, hx=1.0, hy=1.0, hz=0.1, cfg=rubber)
    builder.body_qd[racket] = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    ball = builder.add_body(xform=((0.2, 0.1, 0.3), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1, cfg=rubber)
    builder.body_qd[ball] = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)
    velocities = simulate(builder, 0.3)[2]
    np.testing.assert_allclose(velocities[-1, ball], (0, 0, 2.0, 0, 0, 0), atol=1e-4)
    assert (velocities[:, racket] == np.float32([0, 0, 0.5, 0, 0, 0])).all()


@pytest.mark.parametrize("options", [{"contact": "penalty"}, {"friction_cone": "pyramid"}])
def test_other_ways_of_contact_know_the_velocity_of_a_belt_too(options: dict) -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, density=1000.0, ke=2e4, kd=200.0, kf=500.0)
    belt = builder.add_body(is_kinematic=True, xform=((0.0, 0.0, -0.1), UPRIGHT))
    builder.add_shape_box(belt, hx=3.0, hy=3.0, hz=0.1, cfg=surface)
    builder.body_qd[belt] = (0.6, 0.0, 0.0, 0.0, 0.0, 0.0)
    box = builder.add_body(xform=((-1.0, 0.0, 0.1), UPRIGHT))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    velocities = simulate(builder, 1.0, dt=1 / 960, **options)[2]
    assert abs(velocities[-1, box, 0] - 0.6) < 1e-2
    assert (velocities[:, belt] == np.float32([0.6, 0, 0, 0, 0, 0])).all()


@pytest.mark.parametrize("kinematic", [False, True])
def test_a_body_that_is_fixed_to_the_world_carries_a_box(kinematic: bool) -> None:
    builder = novaphy.ModelBuilder()
    slab = builder.add_link(is_kinematic=kinematic)
    builder.add_shape_box(slab, hx=3.0, hy=3.0, hz=0.1, cfg=SURFACE)
    at = ((0.0, 0.0, -0.1), UPRIGHT)
    builder.add_articulation([builder.add_joint_fixed(-1, slab, parent_xform=at)])
    box = cube(builder, 0.0)
    _, poses, _, _ = simulate(builder, 1.0)
    assert abs(poses[-1, box, 2] - 0.1) < 6e-3 and (poses[1:, slab] == poses[1, slab]).all()


def test_boxes_on_one_belt_do_not_share_an_island() -> None:
    """Each has the bits that it has alone, beside others, for any number of threads."""

    def run(xs: list[float]) -> np.ndarray:
        builder = novaphy.ModelBuilder()
        table(builder, (0.3, 0.1, 0.0, 0.0, 0.0, 0.2))
        for k, x in enumerate(xs):
            body = cube(builder, x, -0.5)
            builder.body_qd[body] = (0.1, 0.2, -0.3, 0.4, 0.5 + 0.1 * (x > 0), 0.6)
            assert body == k + 1
        return simulate(builder, 0.5)[1][:, 1:]

    together = run([-1.0, 0.5, 1.5])
    for k, x in enumerate([-1.0, 0.5, 1.5]):
        np.testing.assert_array_equal(run([x])[:, 0], together[:, k])
    threads = novaphy.num_threads()
    try:
        novaphy.set_num_threads(1)
        np.testing.assert_array_equal(run([-1.0, 0.5, 1.5]), together)
    finally:
        novaphy.set_num_threads(threads)


def arm(kinematic: bool, twist: tuple[float, ...], mass: float = 0.0) -> novaphy.ModelBuilder:
    """Two links on a base that is kinematic, or only heavy."""
    builder = novaphy.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    inertia = np.diag([0.02, 0.03, 0.04])
    base = builder.add_link(
        is_kinematic=kinematic, mass=mass, inertia=np.eye(3) * mass if mass else None
    )
    links = [builder.add_link(mass=1.0, inertia=inertia, com=(0.2, 0, 0)) for _ in range(2)]
    joints = [builder.add_joint_free(base)]
    for parent, child in zip([base, links[0]], links, strict=True):
        joints.append(
            builder.add_joint_revolute(
                parent, child, axis=(0, 1, 0), parent_xform=((0.4, 0, 0), UPRIGHT)
            )
        )
    builder.add_articulation(joints)
    builder.joint_q[7:] = [0.4, -0.6]
    builder.joint_qd[:] = [*twist, 0.5, -0.3]
    return builder


def test_a_kinematic_base_moves_an_arm_as_one_of_endless_mass_does() -> None:
    twist = (0.5, 0.2, -0.1, 0.3, 0.4, -0.5)
    ends = []
    for builder in (arm(True, twist), arm(False, twist, 1e7)):
        model = builder.finalize()
        solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
        state, after = model.state(), model.state()
        for _ in range(240):
            solver.step(state, after, None, None, DT)
            state, after = after, state
        ends.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-4)
    assert (ends[0][9:15] == np.float32(twist)).all()
    assert np.abs(ends[0][7:9] - (0.4, -0.6)).max() > 0.1


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
def test_the_gradient_by_a_kinematic_base_is_that_of_differences_without_contacts() -> None:
    from novaphy import diff, nova

    twist = (0.5, 0.2, -0.1, 0.3, 0.4, -0.5)
    model = arm(True, twist).finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model)
    weights = np.random.default_rng(1).normal(size=(3, 7)).astype(np.float32)
    trajectory = diff.Trajectory(model, 24)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1 / 60)
        poses = diff.state_body_q_tensor(trajectory[24])
        tape.backward(nova.sum(poses * nova.tensor(weights)))

    def value(name: str, k: int, change: float) -> float:
        start = trajectory[0]
        array = getattr(start, name)
        before = array.numpy().copy()
        numbers = before.copy()
        numbers[k] += change
        array.assign(numbers)
        solver.rollout(trajectory, None, None, 1 / 60)
        array.assign(before)
        return float((trajectory[24].body_q.numpy().astype(float) * weights).sum())

    for name, eps in (("joint_q", 2e-3), ("joint_qd", 5e-3)):
        gradient = getattr(trajectory[0], name).grad.numpy()
        expected = [
            (value(name, k, eps) - value(name, k, -eps)) / (2 * eps) for k in range(gradient.size)
        ]
        np.testing.assert_allclose(gradient, expected, atol=5e-3, rtol=2e-3, err_msg=name)


SOLVERS = ["SolverFeatherstone", *(["DiffFeatherstoneSolver"] if novaphy.has_diff() else [])]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_kinematic_root_of_another_joint_is_refused_by_name(solver: str) -> None:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3), is_kinematic=True, label="crank")
    builder.add_articulation([builder.add_joint_revolute(-1, link)])
    message = rf"{solver}: model: body 0 \('crank'\): .* FREE or FIXED to the world, got REVOLUTE"
    with pytest.raises(NotImplementedError, match=message):
        getattr(novaphy.solvers, solver)(builder.finalize())


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_body_that_becomes_kinematic_or_dynamic_is_refused_until_it_is_said(solver: str) -> None:
    builder = novaphy.ModelBuilder()
    bodies = [
        builder.add_body(mass=1.0, inertia=np.eye(3), is_kinematic=kinematic)
        for kinematic in (False, True)
    ]
    model = builder.finalize()
    made = getattr(novaphy.solvers, solver)(model)
    state, after = model.state(), model.state()
    made.step(state, after, None, None, DT)
    flags = model.body_flags.numpy().copy()
    for body in bodies:
        edited = flags.copy()
        edited[body] = flags[1 - body]
        model.body_flags.assign(edited)
        with pytest.raises(NotImplementedError, match=rf"body_flags\[{body}\]: .*kinematic"):
            made.step(state, after, None, None, DT)
    model.body_flags.assign(flags[::-1].copy())
    again = getattr(novaphy.solvers, solver)(model)
    state.joint_qd.assign(np.zeros(12, np.float32))
    again.step(state, after, None, None, DT)
    fell = after.joint_qd.numpy().reshape(2, 6)[:, 2]
    assert fell[0] == 0.0 and fell[1] == pytest.approx(-GRAVITY * DT, rel=1e-5)


@pytest.mark.parametrize("name", ["eval_mass_matrix", "eval_bias", "eval_energy"])
def test_functions_of_the_dynamics_refuse_kinematic_bodies(name: str) -> None:
    model = arm(True, (0.0,) * 6).finalize()
    with pytest.raises(NotImplementedError, match="kinematic"):
        getattr(novaphy, name)(model, model.state())
