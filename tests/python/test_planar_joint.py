"""PLANAR joints: x and y in a plane, and an angle about its normal."""

import numpy as np
import pytest

import novaphy
from novaphy import JointDofConfig, JointType

DT = 1e-3
diff = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

# Results of JointModelPlanar of Pinocchio 4.1.0 in double precision, for the tree of three_joints.
# Pinocchio's q are x, y, cos and sin, and its velocity is in the axes of the child. The values here
# are converted to x, y, the angle and their rates.
Q = (0.3, -0.2, 0.7, 0.5, -0.1, 0.25, -0.9)
QD = (0.4, -0.6, 1.1, -0.8, 0.5, 0.2, -1.3)
TAU = (1.0, -2.0, 0.5, 0.3, -0.4, 0.6, 0.2)
QDD = (
    *(1.141782148, -5.085538323, 6.140248882, -4.668163553),
    *(6.186831837, -3.034267619, 30.374438728),
)
BIAS = (
    *(-1.162504908, 12.762192444, 0.654012935, 1.110267359),
    *(-2.21504539, 4.361865548, 0.070151783),
)
POSES = (
    (0.4, -0.384212199, 0.222116332, 0.186624548, -0.068123278, 0.336062681, 0.9206478),
    (0.488546669, -0.156150977, 0.209968627, 0.408594754, 0.017137748, 0.342469274, 0.845855437),
    (0.169885886, -0.075914578, 0.686835253, 0.106710167, 0.391534329, 0.07278174, 0.911052484),
)


def turned(place: tuple[float, ...], axis: int, angle: float) -> tuple:
    """A frame at a place, turned about a coordinate axis."""
    q = [0.0, 0.0, 0.0, np.cos(angle / 2)]
    q[axis] = np.sin(angle / 2)
    return (*place, *q)


def three_joints(planar: bool = True, **numbers: float) -> novaphy.ModelBuilder:
    """A PLANAR joint, a hinge on it and another PLANAR joint, or D6 joints of the same axes."""
    builder = novaphy.ModelBuilder()
    a, b, c = (
        builder.add_link(mass=mass, com=com, inertia=np.diag(moments), lock_inertia=True)
        for mass, com, moments in (
            (2.0, (0.05, -0.03, 0.1), (0.03, 0.04, 0.05)),
            (1.0, (0.0, 0.1, 0.2), (0.01, 0.02, 0.015)),
            (0.7, (0.02, 0.01, -0.05), (0.004, 0.005, 0.006)),
        )
    )

    def add(parent: int, child: int, frame: tuple) -> int:
        dofs = [JointDofConfig(axis=axis, **numbers) for axis in "xyz"]
        if planar:
            x, y, angle = dofs
            return builder.add_joint_planar(
                parent, child, parent_xform=frame, x=x, y=y, angle=angle
            )
        return builder.add_joint_d6(
            parent, child, parent_xform=frame, linear_axes=dofs[:2], angular_axes=dofs[2:]
        )

    joints = [
        add(-1, a, turned((0.1, -0.2, 0.3), 0, 0.4)),
        builder.add_joint_revolute(a, b, axis="x", parent_xform=turned((0.2, 0.1, -0.1), 0, 0.0)),
        add(b, c, turned((0.0, 0.3, 0.1), 1, 0.7)),
    ]
    builder.add_articulation(joints)
    builder.joint_q, builder.joint_qd = list(Q), list(QD)
    return builder


def stepped(builder: novaphy.ModelBuilder, steps: int) -> list[np.ndarray]:
    """States behind so many steps."""
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    now, after = model.state(), model.state()
    for _ in range(steps):
        solver.step(now, after, None, None, DT)
        now, after = after, now
    return [x.numpy() for x in (now.joint_q, now.joint_qd, now.body_q, now.body_qd)]


def test_the_dynamics_are_those_of_pinocchio() -> None:
    model = three_joints().finalize()
    planar, hinge = JointType.PLANAR, JointType.REVOLUTE
    assert model.joint_type.numpy().tolist() == [planar, hinge, planar]
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    np.testing.assert_allclose(state.body_q.numpy(), POSES, atol=2e-6)
    bias = novaphy.eval_bias(model, state)
    np.testing.assert_allclose(np.ravel(bias), BIAS, rtol=1e-5, atol=1e-6)
    qdd = novaphy.eval_forward_dynamics(model, state, np.float32(TAU))
    np.testing.assert_allclose(np.ravel(qdd), QDD, rtol=2e-5)


def test_coordinates_come_back_from_poses() -> None:
    model = three_joints().finalize()
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    back = model.state()
    back.joint_q.zero_()
    back.joint_qd.zero_()
    novaphy.eval_ik(model, state, back.joint_q, back.joint_qd)
    np.testing.assert_allclose(back.joint_q.numpy(), Q, atol=1e-6)
    np.testing.assert_allclose(back.joint_qd.numpy(), QD, atol=5e-6)


def test_steps_have_the_bits_of_a_d6_joint() -> None:
    numbers = {"target_ke": 30.0, "target_kd": 2.0, "limit_lower": -0.25, "limit_upper": 0.65}
    planar, d6 = stepped(three_joints(**numbers), 50), stepped(three_joints(False, **numbers), 50)
    for a, b in zip(planar, d6, strict=True):
        np.testing.assert_array_equal(a, b)


def free_in_the_plane() -> novaphy.ModelBuilder:
    """A body in the plane of the normal (1, 2, 2) / 3, without gravity."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    body = builder.add_link(
        mass=2.0, com=(0.1, -0.05, 0.0), inertia=np.diag((0.02, 0.03, 0.04)), lock_inertia=True
    )
    builder.add_articulation([builder.add_joint_planar(-1, body, axis=(1.0, 2.0, 2.0))])
    builder.joint_q, builder.joint_qd = [0.2, -0.1, 0.4], [0.3, 0.5, 1.2]
    return builder


def test_a_free_body_moves_as_the_closed_form_says() -> None:
    """The center of mass moves on a line, the angle at its rate; energy and plane are kept."""
    builder = free_in_the_plane()
    normal = np.array((1.0, 2.0, 2.0)) / 3
    model = builder.finalize()
    axes = model.joint_axis.numpy().astype(float)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-7)
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), normal, atol=1e-7)
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    start, twist = state.body_q.numpy()[0], state.body_qd.numpy()[0]
    energy = novaphy.eval_energy(model, state)
    com = novaphy.eval_center_of_mass(model, state)[0]
    solver = novaphy.solvers.SolverFeatherstone(model)
    after, steps, dt = model.state(), 2000, 5e-4
    for _ in range(steps):
        solver.step(state, after, None, None, dt)
        state, after = after, state
    time = steps * dt
    np.testing.assert_allclose(state.joint_q.numpy()[2], 0.4 + 1.2 * time, atol=2e-3)
    expected = com + time * twist[:3]
    np.testing.assert_allclose(novaphy.eval_center_of_mass(model, state)[0], expected, atol=2e-3)
    np.testing.assert_allclose(novaphy.eval_energy(model, state), energy, rtol=2e-3)
    end = state.body_q.numpy()[0]
    assert abs(float((end[:3] - start[:3]) @ normal)) < 1e-5
    np.testing.assert_allclose(state.body_qd.numpy()[0][3:], 1.2 * normal, rtol=2e-3)


@diff
def test_gradients_are_central_differences_and_transposes_of_tangents() -> None:
    """Through drives, and through limits that are reached."""
    from novaphy import nova
    from novaphy.diff import (
        Trajectory,
        control_joint_f_tensor,
        model_joint_damping_tensor,
        state_body_q_tensor,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    numbers = {"target_ke": 30.0, "target_kd": 2.0, "limit_lower": -0.25, "damping": 0.1}
    model = three_joints(**numbers).finalize(requires_grad=True)
    damping = model_joint_damping_tensor(model, requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    weights = np.random.default_rng(3).normal(size=(7 + 7 + 21)).astype(np.float32)
    steps = 12

    def run(start: dict[str, np.ndarray]) -> tuple:
        trajectory, control = Trajectory(model, steps), model.control()
        first, last = trajectory[0], trajectory[steps]
        leaves = {
            "q": state_joint_q_tensor(first, True),
            "qd": state_joint_qd_tensor(first, True),
            "force": control_joint_f_tensor(control, True),
            "damping": damping,
        }
        first.joint_q.assign(start["q"])
        first.joint_qd.assign(start["qd"])
        control.joint_f.assign(start["force"])
        model.joint_damping.assign(start["damping"])
        damping.zero_grad()
        novaphy.eval_fk(model, first.joint_q, first.joint_qd, first)
        with nova.Tape() as tape:
            solver.rollout(trajectory, control, None, 5e-3)
            ends = (state_joint_q_tensor(last), state_joint_qd_tensor(last))
            poses = state_body_q_tensor(last).reshape(-1)
            loss = nova.sum(ends[0] * nova.tensor(weights[:7]))
            loss = loss + nova.sum(ends[1] * nova.tensor(weights[7:14]))
            loss = loss + nova.sum(poses * nova.tensor(weights[14:]))
        return tape, loss, leaves

    start = {
        "q": np.float32(Q),
        "qd": np.float32(QD),
        "force": np.float32(TAU),
        "damping": np.full(7, 0.1, np.float32),
    }
    tape, loss, leaves = run(start)
    rng = np.random.default_rng(5)
    ways = {name: rng.normal(size=7).astype(np.float32) for name in leaves}
    tangents = {
        name: tape.jvp([loss], [leaf], [nova.tensor(ways[name])])[0].item()
        for name, leaf in leaves.items()
    }
    tape.backward(loss)
    gradients = {name: leaf.grad.numpy().astype(float) for name, leaf in leaves.items()}
    for name, gradient in gradients.items():
        along = float(gradient @ ways[name])
        assert tangents[name] == pytest.approx(along, rel=2e-5, abs=1e-6)
        h, values = 1e-3, []
        for sign in (1, -1):
            moved = dict(start)
            moved[name] = start[name] + np.float32(sign * h) * ways[name]
            values.append(run(moved)[1].item())
        assert (values[0] - values[1]) / (2 * h) == pytest.approx(along, rel=5e-3, abs=5e-4)


@diff
def test_penalty_joints_have_the_bits_of_a_d6_joint() -> None:
    ends = []
    for planar in (True, False):
        model = three_joints(planar, target_ke=30.0).finalize()
        for kind in (novaphy.solvers.SolverSemiImplicit, novaphy.solvers.DiffSemiImplicitSolver):
            solver, state, after = kind(model), model.state(), model.state()
            novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
            for _ in range(20):
                state.clear_forces()
                solver.step(state, after, None, None, 1e-4)
                state, after = after, state
            ends.append(state.body_q.numpy())
    for other in ends[1:]:
        np.testing.assert_array_equal(other, ends[0])


def test_urdf_files_have_them() -> None:
    text = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="planar"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit effort="5" velocity="2"/><dynamics damping="0.3"/></joint></robot>"""
    builder = novaphy.ModelBuilder()
    builder.add_urdf(text)
    model = builder.finalize()
    assert JointType(model.joint_type.numpy()[-1]) == JointType.PLANAR
    np.testing.assert_allclose(model.joint_axis.numpy()[-1], (0, 1, 0), atol=1e-7)
    assert model.joint_effort_limit.numpy().tolist() == [5.0] * 3
    np.testing.assert_allclose(model.joint_damping.numpy(), 0.3)


def test_what_is_refused() -> None:
    builder = novaphy.ModelBuilder()
    a, b = (builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(2))
    axis = {name: JointDofConfig(axis=name) for name in "xyz"}
    with pytest.raises(ValueError, match="add_joint_planar: axis: expected a finite vector"):
        builder.add_joint_planar(-1, a, axis=(0, 0, 0))
    with pytest.raises(ValueError, match="expected 2 and 1 of a PLANAR joint, got 1 and 1"):
        builder.add_joint(
            JointType.PLANAR, -1, a, linear_axes=[axis["x"]], angular_axes=[axis["z"]]
        )
    for linear, angular in (("xy", "x"), ("yx", "z")):
        with pytest.raises(ValueError, match="a PLANAR joint"):
            builder.add_joint(
                JointType.PLANAR,
                -1,
                a,
                linear_axes=[axis[k] for k in linear],
                angular_axes=[axis[angular]],
            )
    first = builder.add_joint_planar(-1, a)
    second = builder.add_joint_revolute(a, b)
    builder.add_articulation([first, second])
    with pytest.raises(ValueError, match="REVOLUTE or PRISMATIC joint, got PLANAR"):
        builder.add_constraint_mimic(second, first)
    builder.add_actuator(first, axis=2)
