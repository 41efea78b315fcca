"""Drives and limits of BALL joints: closed forms, hinges about the same axis, MuJoCo's numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose as near

import novaphy
from novaphy.testing import assert_allclose

AXIS = np.array([2.0, -1.0, 2.0]) / 3
DT = 1 / 960


def turn(axis, angle):
    return (*np.multiply(axis, np.sin(angle / 2)), float(np.cos(angle / 2)))


def one_link(add, gravity=0.0, **link):
    """A model of a link on a joint that add(builder, link) makes."""
    builder = novaphy.ModelBuilder(gravity=gravity)
    body = builder.add_link(**{"mass": 2.0, "inertia": 0.05 * np.eye(3)} | link)
    builder.add_articulation([add(builder, body)])
    return builder.finalize()


def run(model, q, qd, steps, **options):
    solver = novaphy.solvers.SolverFeatherstone(model, **options)
    state = model.state()
    state.joint_q.assign(np.float32(q))
    state.joint_qd.assign(np.float32(qd))
    rows = []
    for _ in range(steps):
        solver.step(state, state, None, None, DT)
        rows.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
    return np.array(rows, float)


@pytest.mark.parametrize("implicit", [True, False])
@pytest.mark.parametrize(
    ("drive", "limit"),
    [({"target_ke": 3.0, "target_kd": 0.02}, {}), ({}, {"limit_ke": 40.0, "limit_kd": 0.1})],
    ids=["drive", "limit"],
)
def test_turns_about_one_axis_are_those_of_a_hinge(drive, limit, implicit):
    """An isotropic body that turns about a tilted axis, past its limit and past half a radian."""
    place = (0.1, 0.2, 0.3, *turn((0.0, 0.6, 0.8), 0.7))
    ball = one_link(
        lambda b, k: b.add_joint_ball(
            -1,
            k,
            parent_xform=place,
            target_q=turn(AXIS, 0.4),
            **drive,
            **limit,
            **({"limit_angle": 0.9} if limit else {}),
        )
    )
    hinge = one_link(
        lambda b, k: b.add_joint_revolute(
            -1,
            k,
            parent_xform=place,
            axis=AXIS,
            target_q=0.4,
            **drive,
            **limit,
            **({"limit_upper": 0.9} if limit else {}),
        )
    )
    a = run(ball, turn(AXIS, 0.6), 2.5 * AXIS, 900, implicit_drives=implicit)
    b = run(hinge, [0.6], [2.5], 900, implicit_drives=implicit)
    angle = 2 * np.arctan2(a[:, :3] @ AXIS, a[:, 3])
    # A ball turns by the Cayley map: 1 - (dt w)^2 / 12 of the angle of a hinge.
    assert_allclose(angle, b[:, 0], atol=5e-5)
    assert_allclose(a[:, 4:] @ AXIS, b[:, 1], atol=5e-4)
    assert np.ptp(angle) > 0.5
    assert (angle.max() > 0.9) == bool(limit)
    across = a[:, 4:] - np.outer(a[:, 4:] @ AXIS, AXIS)
    assert np.abs(across).max() < 2e-5


def test_a_limit_pushes_about_its_own_axis_alone():
    """Outside of the cone: the change of the momentum points along the axis of the turn."""
    model = one_link(lambda b, k: b.add_joint_ball(-1, k, limit_angle=0.5, limit_ke=500.0))
    q, qd = turn(AXIS, 0.6), np.array([1.0, 2.0, -3.0])
    after = run(model, q, qd, 1)[0, 4:]
    change = after - qd
    assert np.abs(change - (change @ AXIS) * AXIS).max() < 1e-6
    # The implicit law in one dof: v' = (v - dt ke depth / I) / (1 + dt (kd + dt ke) / I)
    v, inertia = qd @ AXIS, 0.05
    expected = (v - DT * 500 * 0.1 / inertia) / (1 + DT * (10 + DT * 500) / inertia)
    assert_allclose(after @ AXIS, expected, rtol=1e-5)


@pytest.mark.parametrize("upper", [0.5, 2.0])
def test_a_pendulum_rests_on_its_cone(upper):
    """Held back by the spring of the limit alone: ke (angle - limit) = m g l sin(angle)."""
    mass, arm, ke = 2.0, 0.3, 400.0
    model = one_link(
        lambda b, k: b.add_joint_ball(-1, k, limit_angle=upper, limit_ke=ke, damping=0.5),
        gravity=-9.81,
        com=(0, 0, arm),
    )
    last = run(model, turn((0.6, 0.8, 0), upper), [0.1, 0, 0], 6000)[-1]
    angle = 2 * np.arctan2(np.linalg.norm(last[:3]), last[3])
    assert_allclose(ke * (angle - upper), mass * 9.81 * arm * np.sin(angle), rtol=1e-3)
    assert np.abs(last[4:]).max() < 1e-4


def chain(contacts):
    """Three balls in a row with drives. The first and the last are outside of their limits."""
    builder = novaphy.ModelBuilder()
    joints, parent = [], -1
    for k, angle in enumerate((0.3, 1e10, 0.4)):
        link = builder.add_link(mass=1.0, com=(0.02, 0, -0.1), inertia=0.01 * np.diag([1, 2, 2.5]))
        joints.append(
            builder.add_joint_ball(
                parent,
                link,
                parent_xform=((0, 0, -0.3 if k else 0.75), (0, 0, 0, 1)),
                target_q=turn(AXIS[::-1], 0.5),
                target_ke=4.0 + k,
                target_kd=0.1,
                damping=0.02,
                armature=0.01,
                limit_angle=angle,
                limit_ke=60.0,
                limit_kd=0.4,
            )
        )
        parent = link
    if contacts:
        surface = novaphy.ShapeConfig(mu=0.4, density=0.0)
        builder.add_shape_sphere(parent, radius=0.1, cfg=surface)
        builder.add_ground_plane(cfg=surface)
    builder.add_articulation(joints)
    builder.joint_q = [*turn(AXIS, 0.5), *turn(AXIS[::-1], -0.2), *turn((0.0, 1.0, 0.0), 0.6)]
    builder.joint_qd = list(np.linspace(-0.6, 0.5, 9))
    return builder.finalize()


STARTS = ("joint_q", "joint_qd")
PARTS = (
    "joint_target_q",
    "joint_target_qd",
    "joint_target_ke",
    "joint_target_kd",
    "joint_damping",
    "joint_armature",
    "joint_limit_upper",
    "joint_limit_ke",
    "joint_limit_kd",
    "body_mass",
)


def loss_of(model, start, weights, moving=()):
    """A weighted sum of the rates after some steps, and the tape that has it."""
    from novaphy import diff, nova

    state, control = model.state(), model.control()
    for name in STARTS:
        getattr(state, name).assign(start[name])
    owners = {}
    for name in moving:
        in_control = name in ("joint_target_q", "joint_target_qd")
        kind = "state" if name in STARTS else "control" if in_control else "model"
        owner = {"state": state, "control": control, "model": model}[kind]
        getattr(owner, name).requires_grad = True
        owners[name] = (owner, kind)
    for name in ("joint_target_q", "joint_target_qd"):
        getattr(control, name).assign(start[name])
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, pgs_iterations=200)
    pipeline = novaphy.CollisionPipeline(model) if model.shape_count else None
    states = [state, *(model.state() for _ in range(3))]
    tape = nova.Tape()
    with tape:
        for now, then in itertools.pairwise(states):
            contacts = None
            if pipeline:
                contacts = pipeline.contacts()
                pipeline.collide(now, contacts)
            solver.step(now, then, control, contacts, 0.005)
        value = nova.sum(diff.state_joint_qd_tensor(states[-1]) * nova.tensor(weights))
    return tape, value, owners


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs diff")
@pytest.mark.parametrize("contacts", [False, True], ids=["free", "on the ground"])
def test_gradients_are_differences_and_tangents_are_gradients(contacts):
    """By every number of drives and limits of balls."""
    from novaphy import diff, nova

    model = chain(contacts)
    draw = np.random.default_rng(5)
    weights = np.float32(draw.normal(size=9))
    start = {n: getattr(model, n).numpy() for n in (*STARTS, *PARTS[:2])}
    tape, value, owners = loss_of(model, start, weights, (*STARTS, *PARTS))
    ways, tangents = {}, {}
    with tape:
        for name, (owner, kind) in owners.items():
            array = getattr(owner, name)
            ways[name] = np.float32(draw.normal(size=array.numpy().shape))
            if name == "joint_limit_upper":
                ways[name] *= np.isin(np.arange(9), (0, 6))
            elif name.startswith(("joint_target_k", "joint_limit_k", "joint_damping", "body")):
                ways[name] *= np.float32(array.numpy())
            view = getattr(diff, f"{kind}_{name}_tensor", None)
            if view is None:
                continue
            tensor = view(owner)
            tangents[name] = tape.jvp([value], [tensor], [nova.tensor(ways[name])])[0].item()
        tape.backward(value)
    for name, (owner, _) in owners.items():
        gradient = getattr(owner, name).grad.numpy().astype(float)
        along = (gradient * ways[name]).sum()
        size = np.linalg.norm(gradient) * np.linalg.norm(ways[name])
        assert size > 0, name
        tangent = tangents.get(name, along)
        near(tangent, along, rtol=1e-3, atol=1e-4 * size, err_msg=name)
        base = start[name] if name in start else getattr(owner, name).numpy()
        ends = []
        for sign in (1, -1):
            moved = np.float32(base + sign * 5e-3 * ways[name])
            if name in start:
                ends.append(loss_of(model, {**start, name: moved}, weights)[1].item())
                continue
            getattr(owner, name).assign(moved)
            ends.append(loss_of(model, start, weights)[1].item())
            getattr(owner, name).assign(base)
        expected = (ends[0] - ends[1]) / 1e-2
        near(along, expected, rtol=1e-2, atol=5e-3 * size, err_msg=name)


def test_an_actuated_model_keeps_the_targets_of_its_balls():
    """Actuators of other joints leave a drive of a ball as it was, to the bit."""

    def scene(actuators):
        builder = novaphy.ModelBuilder(gravity=0.0)
        links = [builder.add_link(mass=1.0, inertia=0.1 * np.eye(3)) for _ in range(2)]
        joints = [
            builder.add_joint_ball(-1, links[0], target_q=turn(AXIS, 1.0), target_ke=5.0),
            builder.add_joint_revolute(links[0], links[1], axis=(0, 0, 1)),
        ]
        builder.add_articulation(joints)
        if actuators:
            builder.add_actuator(joints[1])
        return builder.finalize()

    start = ([0, 0, 0, 1, 0.3], [0.1, 0, 0, 0.2])
    assert (run(scene(True), *start, 50) == run(scene(False), *start, 50)).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"limit_angle": 0.0}, "limit_angle: expected an angle above 0, got 0"),
        ({"limit_angle": np.nan}, "limit_angle: expected a finite number"),
        ({"target_ke": -1.0}, "target_ke: expected .*>= 0, got -1"),
        ({"target_q": (0, 0, 0, 2)}, r"joint_target_q\[0\].*length 2"),
        ({"target_q": (0, 0, 1)}, "target_q: expected 4 numbers"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        one_link(lambda b, k: b.add_joint_ball(-1, k, **arguments))


@pytest.mark.parametrize(
    ("name", "row", "value"),
    [
        ("joint_limit_lower", 0, -1.0),
        ("joint_limit_upper", 1, 1.0),
        ("joint_limit_upper", 0, -1.0),
        ("joint_effort_limit", 2, 10.0),
    ],
)
def test_what_balls_do_not_have_is_refused_by_name(name, row, value):
    model = one_link(lambda b, k: b.add_joint_ball(-1, k, target_ke=1.0, label="hip"))
    array = getattr(model, name)
    values = array.numpy()
    values[row] = value
    if name == "joint_limit_upper" and row == 0:
        model.joint_limit_lower.assign([-2.0, -1e10, -1e10])
    array.assign(values)
    with pytest.raises((NotImplementedError, ValueError), match=rf"joint_limit|{name}"):
        run(model, [0, 0, 0, 1], [0, 0, 0], 1)


def test_a_penalty_joint_has_no_drive_of_a_ball():
    model = one_link(lambda b, k: b.add_joint_ball(-1, k, target_ke=1.0))
    with pytest.raises(NotImplementedError, match=r"joint_target_ke\[0\]: expected 0 of a BALL"):
        solver = novaphy.solvers.SolverSemiImplicit(model)
        state = model.state()
        solver.step(state, state, None, None, DT)


def test_a_long_chain_has_limits():
    """Trees of more than nine joints in a row take a mass matrix where a ball has a limit."""
    builder = novaphy.ModelBuilder()
    joints, parent = [], -1
    for k in range(14):
        link = builder.add_link(mass=0.1, com=(0, 0, -0.05), inertia=1e-4 * np.eye(3))
        joints.append(
            builder.add_joint_ball(
                parent,
                link,
                limit_angle=0.2,
                limit_ke=5.0,
                limit_kd=0.01,
                damping=1e-3,
                parent_xform=((0, 0, -0.1 if k else 3), (0, 0, 0, 1)),
            )
        )
        parent = link
    builder.add_articulation(joints)
    builder.joint_qd = [*([0.0] * 36), *([3.0] * 6)]
    model = builder.finalize()
    rows = run(model, model.joint_q.numpy(), model.joint_qd.numpy(), 960)
    angles = 2 * np.arcsin(
        np.clip(np.linalg.norm(rows[:, :56].reshape(-1, 14, 4)[..., :3], axis=2), 0, 1)
    )
    assert 0.2 < angles.max() < 0.45
    free = novaphy.ModelBuilder()
    free.add_builder(builder)
    free.joint_limit_upper = [1e10] * 42
    model = free.finalize()
    solver, state = novaphy.solvers.SolverFeatherstone(model), model.state()
    model.joint_limit_upper.assign(np.float32([0.2, *([1e10] * 41)]))
    with pytest.raises(NotImplementedError, match=r"joint_limit_upper\[0\].*make another"):
        solver.step(state, state, None, None, DT)


@pytest.mark.skipif(not novaphy.has_io(), reason="needs io")
def test_springs_of_balls_move_as_in_mujoco():
    """Two balls with springs and a free body with one, 0.5 s. Both integrators have order one."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    box = '<geom type="box" size=".1 .2 .3" pos=".1 .05 -.2" contype="0" conaffinity="0"/>'
    text = f"""<mujoco><option timestep="0.0005"/><worldbody>
<body pos="0 0 2"><joint type="ball" stiffness="40" damping="1"/>{box}
<body pos="0 .1 -.5"><joint type="ball" stiffness="30" damping=".5" armature=".2"/>{box}
</body></body>
<body pos="3 0 1"><joint type="free" stiffness="60" damping=".3"/>{box}</body>
</worldbody></mujoco>"""
    exact = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(exact)
    first, second, third = (turn(AXIS, 1.2), turn(AXIS[::-1], -0.8), turn((0.0, 0.6, 0.8), 1.0))
    data.qpos[:] = [*np.roll(first, 1), *np.roll(second, 1), 3.2, 0.1, 1.0, *np.roll(third, 1)]
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(text)
    model = builder.finalize()
    solver, state = novaphy.solvers.SolverFeatherstone(model), model.state()
    state.joint_q.assign(np.float32([*first, *second, 3.2, 0.1, 1.0, *third]))
    for _ in range(1000):
        mujoco.mj_step(exact, data)
        solver.step(state, state, None, None, 0.0005)
    got = state.joint_q.numpy()
    for k, start in ((0, 0), (4, 4), (11, 11)):
        ours, theirs = got[k : k + 4], np.roll(data.qpos[start : start + 4], -1)
        assert abs(ours @ theirs) > 1 - 2e-6, (k, ours, theirs)
    assert_allclose(got[8:11], data.qpos[8:11], atol=2e-3)
    assert abs(first @ np.roll(data.qpos[:4], -1)) < 0.99
