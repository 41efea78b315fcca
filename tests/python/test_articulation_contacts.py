"""Contacts and dry friction of articulations: SolverFeatherstone with pgs and penalty."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
GRAVITY = 9.81


def simulate(
    builder: novaphy.ModelBuilder, seconds: float, dt: float = 1 / 240, **options: object
) -> tuple[novaphy.Model, np.ndarray, np.ndarray, novaphy.Contacts]:
    """Run a scene; the model, poses and velocities of all states, and the last contacts."""
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, **options)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    poses, velocities = [state.body_q.numpy()], [state.body_qd.numpy()]
    for _ in range(round(seconds / dt)):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        state, after = after, state
        poses.append(state.body_q.numpy())
        velocities.append(state.body_qd.numpy())
    return model, np.array(poses), np.array(velocities), contacts


def stack(masses: list[float], offset: float) -> novaphy.ModelBuilder:
    """Cubes of 0.2 m one upon the other, each a little aside."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.5))
    for k, mass in enumerate(masses):
        x = offset * (-1) ** k
        y = x if k % 3 == 0 else -x
        cube = builder.add_body(xform=((x, y, 0.1 * (2 * k + 1)), UPRIGHT))
        surface = novaphy.ShapeConfig(mu=0.5, density=mass / 0.008)
        builder.add_shape_box(cube, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    return builder


def test_ten_cubes_stand_for_ten_seconds() -> None:
    model, poses, velocities, contacts = simulate(stack([8.0] * 10, 0.003), 10.0)
    moved = poses[-1, :, :3] - model.body_q.numpy()[:, :3]
    assert np.abs(moved[:, :2]).max() < 2e-3
    assert np.abs(moved[:, 2]).max() < 1e-3
    assert np.abs(velocities[-1]).max() < 1e-3
    rows = contacts.rigid_contact_shape0.numpy() == 0  # contacts with the ground
    carried = contacts.rigid_contact_force.numpy()[rows].sum(axis=0)
    np.testing.assert_allclose(carried, (0.0, 0.0, 80.0 * GRAVITY), atol=0.5)


def test_a_light_cube_carries_one_of_twenty_times_its_mass() -> None:
    model, poses, _, _ = simulate(stack([1.0, 20.0], 0.0), 5.0)
    assert np.abs(poses[-1, :, :3] - model.body_q.numpy()[:, :3]).max() < 1e-3


def flat_box(mu: float) -> novaphy.ModelBuilder:
    """A flat box on the ground."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=mu)
    builder.add_ground_plane(cfg=surface)
    box = builder.add_body(xform=((0.0, 0.0, 0.05), UPRIGHT))
    builder.add_shape_box(box, hx=0.2, hy=0.2, hz=0.05, cfg=surface)
    return builder


@pytest.mark.parametrize("cone", ["cone", "pyramid"])
@pytest.mark.parametrize("direction", [0.0, 0.7])
def test_a_box_on_a_slope_sticks_and_slides_as_coulomb_says(cone: str, direction: float) -> None:
    mu, dt, steps = 0.5, 1 / 480, 240
    heading = np.array([np.cos(direction), np.sin(direction)])
    for tangent in (0.45, 0.8):
        angle = np.arctan(tangent)
        model = flat_box(mu).finalize()
        across = GRAVITY * np.sin(angle) * heading
        model.set_gravity((*across, -GRAVITY * np.cos(angle)))
        solver = novaphy.solvers.SolverFeatherstone(model, friction_cone=cone, angular_damping=0.0)
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        state, after = model.state(), model.state()
        for _ in range(steps):
            pipeline.collide(state, contacts)
            solver.step(state, after, None, contacts, dt)
            state, after = after, state
        speed = state.body_qd.numpy()[0, :2] @ heading
        if tangent < mu:
            assert abs(speed) < 1e-5
            assert np.abs(state.body_q.numpy()[0, :2]).max() < 1e-5
        elif cone == "cone":
            slides = GRAVITY * (np.sin(angle) - mu * np.cos(angle))
            assert speed / (steps * dt) == pytest.approx(slides, rel=1e-3)
        else:  # too strong along the diagonals, never too weak
            assert (
                0.0
                <= speed / (steps * dt)
                <= GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * (1 + 1e-3)
            )


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8])
def test_a_ball_bounces_to_its_height(restitution: float) -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(restitution=restitution)
    builder.add_ground_plane(cfg=surface)
    ball = builder.add_body(xform=((0.0, 0.0, 1.1), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    _, poses, velocities, _ = simulate(builder, 1.0, 1 / 2000)
    fastest = int(np.argmin(velocities[:, 0, 2]))
    assert velocities[fastest, 0, 2] == pytest.approx(-np.sqrt(2 * GRAVITY), rel=5e-3)
    lowest = poses[:, 0, 2].min() - 0.1
    assert lowest > -1e-5  # a rebound begins up to a step's way above the ground
    height = poses[fastest + 1 :, 0, 2].max() - 0.1
    assert height == pytest.approx(restitution**2, rel=0.02, abs=3e-3)


def test_two_equal_balls_exchange_their_velocities() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    surface = novaphy.ShapeConfig(restitution=1.0, mu=0.0)
    for x in (0.0, 0.5):
        ball = builder.add_body(xform=((x, 0.0, 0.0), UPRIGHT))
        builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    builder.joint_qd = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    _, _, velocities, _ = simulate(builder, 0.5, angular_damping=0.0)
    np.testing.assert_allclose(velocities[-1, :, 0], (0.0, 2.0), atol=1e-5)
    np.testing.assert_allclose(velocities[:, :, 0].sum(axis=1), 2.0, atol=1e-5)


def robot() -> novaphy.ModelBuilder:
    """A trunk on two legs with box feet, held by drives at hips, knees and ankles."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.8)
    builder.add_ground_plane(cfg=surface)
    trunk = builder.add_link(xform=((0.0, 0.0, 1.02), UPRIGHT))
    builder.add_shape_box(trunk, hx=0.1, hy=0.15, hz=0.15, cfg=surface)
    joints = [builder.add_joint_free(trunk)]
    drive = {"target_ke": 400.0, "target_kd": 20.0, "axis": (0.0, 1.0, 0.0)}
    for side in (-0.1, 0.1):
        parent, anchor = trunk, (0.0, side, -0.17)
        for length in (0.4, 0.4):
            link = builder.add_link()
            thin = novaphy.ShapeConfig(mu=0.8, density=500.0)
            builder.add_shape_box(link, hx=0.04, hy=0.04, hz=length / 2 - 0.02, cfg=thin)
            joints.append(
                builder.add_joint_revolute(
                    parent,
                    link,
                    parent_xform=(anchor, UPRIGHT),
                    child_xform=((0.0, 0.0, length / 2), UPRIGHT),
                    **drive,
                )
            )
            parent, anchor = link, (0.0, 0.0, -length / 2)
        foot = builder.add_link()
        builder.add_shape_box(foot, hx=0.12, hy=0.06, hz=0.02, cfg=surface)
        joints.append(
            builder.add_joint_revolute(
                parent,
                foot,
                parent_xform=(anchor, UPRIGHT),
                child_xform=((-0.02, 0.0, 0.03), UPRIGHT),
                **drive,
            )
        )
    builder.add_articulation(joints)
    return builder


def test_a_robot_with_box_feet_stands() -> None:
    model, poses, velocities, contacts = simulate(robot(), 5.0, 1 / 500)
    assert np.abs(poses[-1, 0, :2] - poses[0, 0, :2]).max() < 0.03
    assert poses[-1, 0, 2] > 0.98
    assert np.abs(velocities[-1]).max() < 1e-2
    force = contacts.rigid_contact_force.numpy()[: int(contacts.rigid_contact_count.numpy()[0])]
    weight = model.body_mass.numpy().sum() * GRAVITY
    np.testing.assert_allclose(force.sum(axis=0), (0.0, 0.0, weight), atol=0.02 * weight)


def test_a_gripper_lifts_a_box() -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.8)
    builder.add_ground_plane(cfg=surface)
    box = builder.add_body(xform=((0.0, 0.0, 0.05), UPRIGHT))
    builder.add_shape_box(box, hx=0.05, hy=0.05, hz=0.05, cfg=surface)  # 1 kg
    wrist = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
    joints = [
        builder.add_joint_prismatic(
            -1,
            wrist,
            axis=(0.0, 0.0, 1.0),
            parent_xform=((0.0, 0.0, 0.2), UPRIGHT),
            target_ke=5000.0,
            target_kd=500.0,
        )
    ]
    for side in (-1.0, 1.0):
        finger = builder.add_link()
        builder.add_shape_box(finger, hx=0.01, hy=0.03, hz=0.05, cfg=surface)
        joints.append(
            builder.add_joint_prismatic(
                wrist,
                finger,
                axis=(-side, 0.0, 0.0),
                parent_xform=((0.08 * side, 0.0, -0.13), UPRIGHT),
                target_ke=2000.0,
                target_kd=100.0,
                effort_limit=30.0,
            )
        )
    builder.add_articulation(joints)
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    pipeline = novaphy.CollisionPipeline(model)
    contacts, control = pipeline.contacts(), model.control()
    state, after = model.state(), model.state()
    start = model.joint_q.numpy().size - 3
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    for step in range(1000):
        target = control.joint_target_q.numpy()
        target[start + 1 :] = 0.1  # closes with the force of the effort limit
        target[start] = 0.3 * min(max(step / 500 - 0.4, 0.0), 1.0)
        control.joint_target_q.assign(target)
        pipeline.collide(state, contacts)
        solver.step(state, after, control, contacts, 1 / 500)
        state, after = after, state
    pose = state.body_q.numpy()[box]
    assert pose[2] == pytest.approx(0.35, abs=0.01)
    assert np.abs(pose[:2]).max() < 5e-3


def test_a_drive_that_a_contact_blocks_keeps_to_its_effort_limit() -> None:
    """A light finger on a rail presses against a wall."""
    ke, kd, mass, limit, dt = 2000.0, 100.0, 0.1, 20.0, 1 / 500

    def pressed(depth: float) -> float:
        builder = novaphy.ModelBuilder(gravity=0.0)
        surface = novaphy.ShapeConfig(mu=0.0)
        finger = builder.add_link(mass=mass, inertia=np.eye(3) * 1e-3, lock_inertia=True)
        builder.add_shape_sphere(finger, radius=0.05, cfg=surface)
        builder.add_shape_box(
            -1, xform=((0.15, 0, 0), UPRIGHT), hx=0.1, hy=0.1, hz=0.1, cfg=surface
        )
        rail = builder.add_joint_prismatic(
            -1, finger, axis=(1.0, 0.0, 0.0), target_ke=ke, target_kd=kd, effort_limit=limit
        )
        builder.add_articulation([rail])
        model = builder.finalize()
        solver = novaphy.solvers.SolverFeatherstone(model)
        pipeline = novaphy.CollisionPipeline(model)
        contacts, control = pipeline.contacts(), model.control()
        state, after = model.state(), model.state()
        for _ in range(100):
            control.joint_target_q.assign(state.joint_q.numpy() + np.float32(depth))
            pipeline.collide(state, contacts)
            solver.step(state, after, control, contacts, dt)
            state, after = after, state
        assert abs(state.joint_qd.numpy()[0]) < 1e-4
        return float(np.linalg.norm(contacts.rigid_contact_force.numpy()[0]))

    for force in (10.0, 19.9, 20.1, 30.0, 60.0, 200.0):
        assert pressed(force / ke) == pytest.approx(min(force, limit), rel=1e-3)


def test_dry_friction_holds_a_joint_and_slows_it_down() -> None:
    def hinge(friction: float, torque: float) -> novaphy.ModelBuilder:
        builder = novaphy.ModelBuilder(gravity=0.0)
        link = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.5)
        joint = builder.add_joint_revolute(-1, link, axis=(0.0, 0.0, 1.0), friction=friction)
        builder.add_articulation([joint])
        builder.joint_f = [torque]
        return builder

    _, _, stuck, _ = simulate(hinge(1.0, 0.9), 1.0, angular_damping=0.0)
    assert np.abs(stuck).max() < 1e-6
    _, _, moving, _ = simulate(hinge(1.0, 1.5), 1.0, angular_damping=0.0)
    assert moving[-1, 0, 5] == pytest.approx((1.5 - 1.0) / 0.5, rel=1e-4)


@pytest.mark.parametrize("stiffness", [2e4, 5e4])
def test_a_compliant_contact_is_the_spring_of_the_shapes(stiffness: float) -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=stiffness, kd=500.0)
    builder.add_ground_plane(cfg=surface)
    ball = builder.add_body(xform=((0.0, 0.0, 0.1), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    model, poses, _, _ = simulate(builder, 2.0, 1 / 1000, compliant_contacts=True)
    weight = model.body_mass.numpy()[0] * GRAVITY
    assert 0.1 - poses[-1, 0, 2] == pytest.approx(weight / stiffness, rel=2e-3)


def test_penalty_contacts_rest_where_the_springs_carry() -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(ke=2e4, kd=300.0)
    builder.add_ground_plane(cfg=surface)
    ball = builder.add_body(xform=((0.0, 0.0, 0.1), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    model, poses, _, contacts = simulate(builder, 2.0, 1 / 1000, contact="penalty")
    weight = model.body_mass.numpy()[0] * GRAVITY
    assert 0.1 - poses[-1, 0, 2] == pytest.approx(weight / 2e4, rel=2e-3)
    assert contacts.rigid_contact_force.numpy()[0, 2] == pytest.approx(weight, rel=1e-3)


def on_springs(ke: float, kd: float, hinged: bool = False) -> novaphy.ModelBuilder:
    """A ball of 2 kg that springs of the ground bear, a little deeper than at rest; perhaps at the
    end of an arm, which adds to its mass."""
    surface = novaphy.ShapeConfig(density=0.0, ke=ke, kd=kd, kf=0.0)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    place = (0.0, 0.0, 0.1 - 1.02 * 2.0 * GRAVITY / ke)
    inertia = {"mass": 2.0, "inertia": 0.008 * np.eye(3)}
    if hinged:
        ball = builder.add_link(**inertia)
        at = {"parent_xform": ((-0.5, 0.0, place[2]), UPRIGHT)}
        at["child_xform"] = ((-0.5, 0.0, 0.0), UPRIGHT)
        joint = builder.add_joint_revolute(-1, ball, axis=(0.0, 1.0, 0.0), armature=1.0, **at)
        builder.add_articulation([joint])
    else:
        ball = builder.add_body(xform=(place, UPRIGHT), **inertia)
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    return builder


@pytest.mark.parametrize("kd", [20.0, 200.0])
def test_penalties_warn_of_a_step_that_throws_a_free_body_off(kd: float) -> None:
    """The damper acts on every other step: kd w dt + ke w dt^2 = 4. An arm has more than the ball's
    own mass, so that its own limit is a longer step, and nothing is said."""
    springs, dampers = 1e4 / 2.0, 0.5 * kd
    limit = 8.0 / (dampers + np.sqrt(dampers**2 + 16.0 * springs))
    for factor, hinged, thrown in ((0.98, False, False), (1.02, False, True), (1.02, True, False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            _, poses, _, _ = simulate(
                on_springs(1e4, kd, hinged), 600 * limit, factor * limit, contact="penalty"
            )
        said = [str(w.message) for w in caught]
        assert (poses[:, 0, 2].max() > 0.12) == thrown, factor
        assert len(said) == thrown, said
        if thrown:
            assert "SolverFeatherstone.step: dt: " in said[0] and "contacts of body 0" in said[0]
            assert said[0].endswith('lower dt, ke or kd, or take contact="pgs"')


def test_islands_have_the_bits_that_they_have_alone() -> None:
    alone = simulate(robot(), 0.2, 1 / 500)[1]
    many = novaphy.ModelBuilder()
    many.replicate(robot(), 5)
    together = simulate(many, 0.2, 1 / 500)[1]
    for world in range(5):
        np.testing.assert_array_equal(together[:, 7 * world : 7 * world + 7], alone)


def test_threads_do_not_change_a_bit() -> None:
    def piles() -> novaphy.ModelBuilder:
        many = novaphy.ModelBuilder()
        many.replicate(stack([8.0] * 4, 0.003), 20)
        return many

    before = novaphy.num_threads()
    try:
        novaphy.set_num_threads(1)
        one = simulate(piles(), 0.2)
        novaphy.set_num_threads(4)
        four = simulate(piles(), 0.2)
    finally:
        novaphy.set_num_threads(before)
    np.testing.assert_array_equal(one[1], four[1])
    np.testing.assert_array_equal(one[2], four[2])
    forces = [run[3].rigid_contact_force.numpy() for run in (one, four)]
    np.testing.assert_array_equal(*forces)


def test_a_contact_that_opens_fast_does_not_pull() -> None:
    builder = stack([8.0], 0.0)
    builder.joint_qd = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    _, poses, _, _ = simulate(builder, 0.1, angular_damping=0.0)
    t = np.arange(len(poses)) / 240
    free = 0.1 + t - 0.5 * GRAVITY * t * (t + 1 / 240)
    np.testing.assert_allclose(poses[:, 0, 2], free, atol=1e-5)


def test_a_fast_ball_stops_at_the_surface_without_delay() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.rigid_gap = 0.2
    builder.add_ground_plane()
    ball = builder.add_body(xform=((0.0, 0.0, 0.25), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1)
    builder.joint_qd = [0.0, 0.0, -30.0, 0.0, 0.0, 0.0]
    _, poses, _, _ = simulate(builder, 0.1, 1 / 60)
    assert poses[1:, 0, 2] == pytest.approx(0.1, abs=1e-5)


def test_sweeps_and_residual_can_be_read() -> None:
    model = stack([8.0] * 3, 0.003).finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, pgs_iterations=3)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    pipeline.collide(state, contacts)
    solver.step(state, after, None, contacts, 1 / 240)
    assert solver.pgs_sweeps == 3 and solver.pgs_residual > 1e-6
    solver.step(state, after, None, None, 1 / 240)
    assert solver.pgs_sweeps == 0 and solver.pgs_residual == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"contact": "soft"}, 'contact: expected "pgs", "penalty" or None'),
        ({"friction_cone": "box"}, 'friction_cone: expected "cone" or "pyramid"'),
        ({"pgs_iterations": 0}, "pgs_iterations: expected at least 1, got 0"),
        ({"pgs_erp": -0.1}, "pgs_erp: expected a finite number >= 0"),
        ({"pgs_erp": 1.5}, "pgs_erp: expected 0 to 1"),
        ({"pgs_slop": float("nan")}, "pgs_slop"),
        ({"contact": "penalty", "pgs_cfm": 0.1}, "pgs_cfm: expected 0 where"),
        ({"contact": None, "warm_start": False}, "warm_start"),
        ({"friction_smoothing": 0.2}, "friction_smoothing: expected 0.1 where"),
        ({"compliant_contacts": True, "pgs_erp": 0.1}, "pgs_erp, pgs_slop"),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], message: str) -> None:
    model = stack([8.0], 0.0).finalize()
    with pytest.raises(ValueError, match=message):
        novaphy.solvers.SolverFeatherstone(model, **options)


def test_contacts_without_a_way_of_contact_raise() -> None:
    model = stack([8.0], 0.0).finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, contact=None)
    contacts = novaphy.CollisionPipeline(model).contacts()
    with pytest.raises(ValueError, match="contacts: expected none"):
        solver.step(model.state(), model.state(), None, contacts, 0.01)


@pytest.mark.parametrize(
    "solver", [novaphy.solvers.SolverFeatherstone, novaphy.solvers.DiffFeatherstoneSolver]
)
def test_a_failing_articulation_in_contact_is_named(solver):
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0)))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    state, control = model.state(), model.control()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    assert contacts.rigid_contact_count.numpy()[0] > 0
    force = control.joint_f.numpy()
    force[0] = np.nan
    control.joint_f.assign(force)
    with pytest.raises(novaphy.Error, match=r"dof 0 \(joint"):
        solver(model, contact="pgs").step(state, model.state(), control, contacts, 0.01)


@pytest.mark.parametrize(
    "solver", [novaphy.solvers.SolverFeatherstone, novaphy.solvers.DiffFeatherstoneSolver]
)
def test_a_coordinate_that_is_not_finite_is_named(solver):
    builder = novaphy.ModelBuilder()
    body = builder.add_body()
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    for coordinate, value in ((0, np.nan), (2, np.inf), (6, np.nan)):
        state = model.state()
        q = state.joint_q.numpy()
        q[coordinate] = value
        state.joint_q.assign(q)
        with pytest.raises(novaphy.Error, match=rf"dof {min(coordinate, 5)} \(joint"):
            solver(model).step(state, model.state(), None, None, 0.01)


@pytest.mark.parametrize("rows", [8, 32, 33, 64, 65])
def test_a_body_rests_on_any_number_of_contacts_alone_and_among_others(rows: int) -> None:
    """Impulse is the change of momentum, and every world has the bits of one that is alone."""
    one = novaphy.ModelBuilder()
    one.add_ground_plane()
    body = one.add_body(xform=((0, 0, 0.1), (0, 0, 0, 1)), mass=2.0, inertia=np.diag([0.1] * 3))
    for k in range(rows):
        angle = 2 * np.pi * k / rows
        place = ((0.3 * np.cos(angle), 0.3 * np.sin(angle), -0.05), (0, 0, 0, 1))
        one.add_shape_sphere(body, xform=place, radius=0.05, cfg=novaphy.ShapeConfig(density=0))
    results = []
    for worlds in (1, 17):
        builder = novaphy.ModelBuilder()
        builder.replicate(one, worlds)
        model = builder.finalize()
        solver = novaphy.solvers.SolverFeatherstone(model)
        pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=worlds * rows)
        state, contacts = model.state(), pipeline.contacts()
        for _ in range(60):
            before = state.joint_qd.numpy()[2]
            pipeline.collide(state, contacts)
            solver.step(state, state, None, contacts, 1 / 240)
        force = contacts.rigid_contacts()["force"].reshape(worlds, rows, 3)
        rises = 240 * (state.joint_qd.numpy()[2] - before)  # m/s^2
        assert abs(force[0, :, 2].sum() - 2.0 * (9.81 + rises)) < 1e-3
        assert abs(state.joint_q.numpy()[2] - 0.1) < 5e-3 and abs(rises) < 0.05
        results.append(
            np.concatenate([state.joint_q.numpy().reshape(worlds, -1), force[:, :, 2]], 1)
        )
    assert (results[1] == results[0]).all()


@pytest.mark.skipif(not novaphy.has_io(), reason="built without io")
@pytest.mark.parametrize(
    ("torque", "softness", "moves"), [(0, 0, 2e-3), (0, 1e-5, 1e-4), (60, 0, 1)]
)
def test_an_ant_stands_for_ten_seconds(
    monkeypatch, torque: float, softness: float, moves: float
) -> None:
    """Under torques (N m) that change every 50 ms it stays on the ground, and finite; without any
    its height hardly changes once it has settled: less than `moves` (m). How four feet share a load
    is not determined, and wanders by rounding until one slides; a little softness determines it."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "python/demos"))
    import demo_articulated_scenes

    model = demo_articulated_scenes.build_ant().finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, pgs_cfm=softness, angular_damping=0.05)
    pipeline = novaphy.CollisionPipeline(model)
    contacts, control = pipeline.contacts(), model.control()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    rng = np.random.default_rng(5)
    heights = []
    for step in range(15000):
        if step % 50 == 0:
            force = rng.uniform(-torque, torque, model.joint_dof_count)
            force[:6] = 0.0
            control.joint_f.assign(force.astype(np.float32))
        pipeline.collide(state, contacts)
        solver.step(state, after, control, contacts, 1e-3)
        state, after = after, state
        if step % 100 == 99:
            heights.append(float(state.joint_q.numpy()[2]))
    assert np.isfinite(state.joint_q.numpy()).all() and np.isfinite(state.joint_qd.numpy()).all()
    assert np.ptp(heights[50:]) < moves  # in 10 s
    assert min(heights) > 0.05 and max(heights) < 1.5
