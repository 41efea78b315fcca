"""Limits of effort, velocity and position of joints: what a step did, by laws of mechanics."""

from __future__ import annotations

import fr3
import numpy as np
import pytest

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT = 1e-3


def walk(model: novaphy.Model, steps: int, **options: object) -> novaphy.State:
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0, **options)
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    for _ in range(steps):
        solver.step(state, after, None, None, DT)
        state, after = after, state
    return state


def test_an_arm_with_weak_drives_gains_no_energy() -> None:
    """At 5 N m a stiff drive stops nearly always; the arm swings as gravity lets it."""
    builder = fr3.builder(target_ke=2000.0, target_kd=100.0, effort_limit=5.0, velocity_limit=1e6)
    builder.joint_q = [0.5, -0.5, 0.3, -1.5, 0.2, 2.0, 0.1]
    builder.joint_target_q = [-1.0, 0.5, -0.8, -2.5, 1.0, 1.0, 0.5]
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    state, after = model.state(), model.state()
    fastest = 0.0
    for _ in range(3000):
        solver.step(state, after, None, None, DT)
        state, after = after, state
        fastest = max(fastest, float(np.abs(state.joint_qd.numpy()).max()))
    assert fastest < 100.0


def test_drives_of_a_moving_arm_keep_to_their_limits() -> None:
    builder = fr3.builder(target_ke=2000.0, target_kd=100.0, velocity_limit=1e6, damping=0.0)
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    rng = np.random.default_rng(0)
    middle = 0.5 * (np.array(fr3.LOWER) + np.array(fr3.UPPER))
    worst, stopped = 0.0, 0
    for _ in range(200):
        state, after, control = model.state(), model.state(), model.control()
        state.joint_q.assign((middle + rng.uniform(-1, 1, 7)).astype(np.float32))
        state.joint_qd.assign(rng.normal(size=7).astype(np.float32))
        control.joint_target_q.assign(
            state.joint_q.numpy() + 0.3 * rng.normal(size=7).astype(np.float32)
        )
        solver.step(state, after, control, None, DT)
        qdd = (after.joint_qd.numpy() - state.joint_qd.numpy().astype(float)) / DT
        torque = novaphy.eval_inverse_dynamics(model, state, qdd.astype(np.float32))
        load = np.abs(torque) / np.array(fr3.EFFORT)
        worst, stopped = max(worst, load.max()), stopped + (load > 0.999).sum()
    assert worst <= 1.0 + 1e-3
    assert stopped > 400


def free_pair(limit: float) -> novaphy.Model:
    """Two links that a hinge joins, in free flight, with a torque of the hinge."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    inertia = np.diag([0.02, 0.03, 0.04])
    one = builder.add_link(mass=1.0, inertia=inertia)
    two = builder.add_link(mass=2.0, inertia=inertia, com=(0.2, 0.0, 0.0))
    hinge = {"axis": (0, 0, 1), "parent_xform": ((0.3, 0, 0), UPRIGHT), "velocity_limit": limit}
    builder.add_articulation(
        [builder.add_joint_free(one), builder.add_joint_revolute(one, two, **hinge)]
    )
    builder.joint_f = [0, 0, 0, 0, 0, 0, 0.5]
    return builder.finalize()


def test_a_velocity_limit_keeps_the_momentum_of_a_free_pair() -> None:
    model = free_pair(1.0)
    state = walk(model, 1000)
    momentum = model.body_mass.numpy() @ state.body_qd.numpy()[:, :3]
    assert state.joint_qd.numpy()[6] == 1.0
    assert np.linalg.norm(momentum) < 0.05  # the error of the integration alone is 0.03


@pytest.mark.parametrize("gravity", [9.81, -9.81])
def test_a_pendulum_swings_below_a_joint_that_is_held(gravity: float) -> None:
    """velocity_limit=0 holds a joint, and its reaction carries what hangs on it."""

    def angle(held: bool) -> float:
        builder = novaphy.ModelBuilder(gravity=gravity)
        body = {"mass": 1.0, "inertia": np.diag([0.02] * 3), "com": (0.25, 0.0, 0.0)}
        parent, joints = -1, []
        if held:
            parent = builder.add_link(**body)
            joints.append(
                builder.add_joint_revolute(-1, parent, axis=(0, 1, 0), velocity_limit=0.0)
            )
        lower = builder.add_link(**body)
        at = ((0.5, 0.0, 0.0), UPRIGHT)
        joints.append(builder.add_joint_revolute(parent, lower, axis=(0, 1, 0), parent_xform=at))
        builder.add_articulation(joints)
        return float(walk(builder.finalize(), 200).joint_q.numpy()[-1])

    assert angle(True) == pytest.approx(angle(False), abs=1e-5)


def test_a_joint_leaves_its_velocity_limit_when_its_load_turns() -> None:
    builder = novaphy.ModelBuilder(gravity=0.0)
    link = builder.add_link(mass=2.0, inertia=np.eye(3))
    slide = builder.add_joint_prismatic(-1, link, axis=(1, 0, 0), velocity_limit=1.0)
    builder.add_articulation([slide])
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after, control = model.state(), model.state(), model.control()
    rates = []
    for force in [10.0] * 300 + [-10.0] * 100:
        control.joint_f.assign(np.float32([force]))
        solver.step(state, after, control, None, DT)
        state, after = after, state
        rates.append(float(state.joint_qd.numpy()[0]))
    assert rates[299] == 1.0
    assert rates[399] == pytest.approx(1.0 - 10.0 / 2.0 * 0.1, abs=1e-5)


@pytest.mark.parametrize("stiffness", [10.0, 400.0, 2000.0, 1e4])
def test_a_drive_rests_against_a_limit(stiffness: float) -> None:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.diag([0.05] * 3))
    drive = {"target_q": 1.5, "target_ke": stiffness, "target_kd": 9.0}
    stop = {"limit_lower": -1.0, "limit_upper": 1.0, "limit_ke": 1e4, "limit_kd": 10.0}
    position = novaphy.JointTargetMode.POSITION
    hinge = builder.add_joint_revolute(
        -1, link, axis=(0, 0, 1), actuator_mode=position, **drive, **stop
    )
    builder.add_articulation([hinge])
    state = walk(builder.finalize(), 4000)
    assert abs(state.joint_qd.numpy()[0]) < 1e-4
    rest = (1.5 * stiffness + 1e4) / (stiffness + 1e4)
    assert state.joint_q.numpy()[0] == pytest.approx(rest, abs=1e-4)


def pusher(limits: dict, friction: float = 0.0) -> novaphy.ModelBuilder:
    """A bent arm of two links whose tip meets the ground, which its drives press on."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.6)
    builder.add_ground_plane(cfg=surface)
    parent, joints = -1, []
    for k in range(2):
        link = builder.add_link(mass=1.0, com=(0.2, 0.0, 0.0), inertia=np.diag([0.01, 0.02, 0.02]))
        at = ((0.0, 0.0, 0.3), UPRIGHT) if k == 0 else ((0.4, 0.0, 0.0), UPRIGHT)
        drive = {"target_ke": 800.0, "target_kd": 20.0, "target_q": (-0.1, 1.8)[k]}
        joints.append(
            builder.add_joint_revolute(
                parent, link, axis=(0, 1, 0), parent_xform=at, friction=friction, **drive, **limits
            )
        )
        parent = link
    builder.add_shape_sphere(parent, xform=((0.4, 0, 0), UPRIGHT), radius=0.05, cfg=surface)
    builder.add_articulation(joints)
    builder.joint_q = [-0.3, 1.46]
    return builder


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_drives_of_an_arm_on_the_ground_keep_to_their_limits(friction: float) -> None:
    """Torques by inverse dynamics, with the force of the contact and less than dry friction."""
    limit = 6.0
    model = pusher({"effort_limit": limit}, friction).finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0, pgs_iterations=200)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    pressed, worst = 0, 0.0
    for _ in range(400):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        qdd = (after.joint_qd.numpy() - state.joint_qd.numpy().astype(float)) / DT
        torque = np.asarray(novaphy.eval_inverse_dynamics(model, state, qdd.astype(np.float32)))
        count = int(contacts.rigid_contact_count.numpy()[0])
        for k in range(count):
            force = contacts.rigid_contact_force.numpy()[k].astype(float)
            sign = 1.0 if contacts.rigid_contact_shape1.numpy()[k] != 0 else -1.0
            # The contact's point: below the middle of the sphere, half of the gap lower.
            x, a = state.body_q.numpy()[1], state.joint_q.numpy().astype(float)
            tip = np.array([np.cos(a.sum()), 0.0, -np.sin(a.sum())]) * 0.4 + x[:3]
            point = np.array([tip[0], 0.0, 0.5 * (tip[2] - 0.05)])
            bases = np.array([[0.0, 0.0, 0.3], x[:3]])
            for j in range(2):
                torque[j] -= sign * np.cross(point - bases[j], force)[1]
            pressed += bool(np.linalg.norm(force) > 1.0)
        worst = max(worst, float(np.abs(torque).max()))
        state, after = after, state
    assert pressed > 100
    assert limit - friction <= worst <= (limit + friction) * (1.0 + 1e-3)


LIMITS = {"effort_limit": 6.0, "velocity_limit": 0.4, "limit_lower": -0.35, "limit_upper": 1.5}


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_limits_have_the_bits_of_a_world_alone(friction: float) -> None:
    """Worlds that start apart reach their limits in different steps, in lanes and one by one."""

    def run(starts: list[float]) -> np.ndarray:
        builder = novaphy.ModelBuilder()
        for start in starts:
            one = pusher(LIMITS, friction)
            one.joint_q = [start, 1.45]
            builder.add_world(one)
        model = builder.finalize()
        solver = novaphy.solvers.SolverFeatherstone(model)
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        state, after = model.state(), model.state()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        rows = []
        for _ in range(150):
            pipeline.collide(state, contacts)
            solver.step(state, after, None, contacts, 2 * DT)
            state, after = after, state
            rows.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
        return np.array(rows).reshape(150, 2, len(starts), 2)

    starts = [-0.5, -0.4, -0.34, -0.32, -0.3, -0.28, -0.26]
    together = run(starts)
    for k, start in enumerate(starts):
        np.testing.assert_array_equal(together[:, :, k], run([start])[:, :, 0])
