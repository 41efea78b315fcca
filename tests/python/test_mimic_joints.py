"""Joints that follow others: q0 = coef0 + coef1 q1, in reduced coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy
from novaphy import solvers

DT = 1e-3
needs_diff = pytest.mark.skipif(not novaphy.has_diff(), reason="built without nova")
needs_io = pytest.mark.skipif(not novaphy.has_io(), reason="built without io")


def tree(follows: bool = True, worlds: int = 1, **numbers) -> novaphy.ModelBuilder:
    """Two branches of hinges and slides on a moving base; a chain of followers across them."""
    rng = np.random.default_rng(3)
    b = novaphy.ModelBuilder()
    parents = (-1, 0, 1, 0, 3, 3)
    joints, links = [], []
    for k, parent in enumerate(parents):
        turn = rng.normal(size=4)
        half = rng.normal(size=(3, 3)) * 0.2
        inertia = half @ half.T
        links.append(
            b.add_link(
                mass=rng.uniform(0.5, 2),
                com=rng.normal(size=3) * 0.1,
                inertia=inertia + np.trace(inertia) * np.eye(3),
            )
        )
        add = b.add_joint_prismatic if k == 4 else b.add_joint_revolute
        joints.append(
            add(
                -1 if parent < 0 else links[parent],
                links[k],
                axis=rng.normal(size=3),
                parent_xform=(rng.normal(size=3) * 0.3, turn / np.linalg.norm(turn)),
                target_ke=20.0 if k in (1, 4) else 0.0,
                target_kd=1.0,
                target_q=0.3,
                damping=0.1,
                armature=0.02 * k,
                **numbers,
            )
        )
    b.add_articulation(joints)
    if follows:  # 4 follows 2, and 5 follows 4
        b.add_constraint_mimic(joints[4], joints[2], 0.1, -0.4)
        b.add_constraint_mimic(joints[5], joints[4], -0.2, 1.5)
    b.joint_q = rng.uniform(-0.5, 0.5, 6).tolist()
    b.joint_qd = rng.uniform(-1, 1, 6).tolist()
    if worlds > 1:
        many = novaphy.ModelBuilder()
        many.replicate(b, worlds)
        return many
    return b


# qd = T qd_reduced of the joints 0, 1, 2, 3.
T = np.zeros((6, 4))
T[:4] = np.eye(4)
T[4, 2], T[5, 2] = -0.4, -0.6


def test_a_model_begins_where_its_leaders_are():
    model = tree().finalize()
    q, qd = model.joint_q.numpy(), model.joint_qd.numpy()
    assert_allclose([q[4], q[5]], [0.1 - 0.4 * q[2], -0.05 - 0.6 * q[2]], rtol=1e-6)
    assert_allclose([qd[4], qd[5]], [-0.4 * qd[2], -0.6 * qd[2]], rtol=1e-6)
    assert model.joint_mimic.numpy().tolist() == [-1, -1, -1, -1, 2, 4]


def test_accelerations_are_those_of_the_reduced_matrix():
    model, free = tree().finalize(), tree(follows=False).finalize()
    state = model.state()
    tau = np.random.default_rng(1).normal(size=6).astype(np.float32)
    mass = novaphy.eval_mass_matrix(free, state)[0].astype(float)
    bias = novaphy.eval_bias(free, state).astype(float)
    expected = T @ np.linalg.solve(T.T @ mass @ T, T.T @ (tau - bias))
    got = novaphy.eval_forward_dynamics(model, state, tau)
    assert_allclose(got, expected, rtol=2e-5, atol=2e-5 * np.abs(expected).max())
    inverse = novaphy.eval_forward_dynamics_derivatives(model, state, tau)[2][0]
    assert_allclose(inverse, T @ np.linalg.solve(T.T @ mass @ T, T.T), atol=1e-4)


def test_a_step_is_backward_euler_of_the_reduced_tree():
    model = tree().finalize()
    solver = solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    qd = state.joint_qd.numpy().astype(float)
    q = state.joint_q.numpy().astype(float)
    mass = novaphy.eval_mass_matrix(model, state)[0].astype(float)
    ke, kd, damping = (
        getattr(model, f"joint_{n}").numpy().astype(float)
        for n in ("target_ke", "target_kd", "damping")
    )
    force = ke * (0.3 - q - DT * qd) - (kd + damping) * qd - novaphy.eval_bias(model, state)
    full = mass + np.diag(DT * (kd + damping) + DT**2 * ke)
    expected = qd + DT * T @ np.linalg.solve(T.T @ full @ T, T.T @ force)
    solver.step(state, after, None, None, DT)
    assert_allclose(after.joint_qd.numpy(), expected, rtol=1e-4, atol=1e-5)


def test_followers_follow_to_rounding_for_ever():
    model = tree().finalize()
    solver = solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    for _ in range(2000):
        solver.step(state, after, None, None, DT)
        state, after = after, state
    q, qd = state.joint_q.numpy(), state.joint_qd.numpy()
    assert np.abs(qd).max() > 0.05
    assert q[4] == np.float32(-0.4) * q[2] + np.float32(0.1)
    assert qd[4] == np.float32(-0.4) * qd[2]
    assert_allclose([q[5], qd[5]], [-0.05 - 0.6 * q[2], -0.6 * qd[2]], rtol=1e-6, atol=1e-7)


def test_the_drift_of_energy_halves_with_the_step():
    b = tree()
    b.gravity = 0.0
    for name in ("joint_target_ke", "joint_target_kd", "joint_damping", "joint_armature"):
        setattr(b, name, [0.0] * 6)
    model = b.finalize()
    solver = solvers.SolverFeatherstone(model, angular_damping=0.0)
    state, after = model.state(), model.state()
    start = novaphy.eval_energy(model, state)[0].sum()
    worst = []
    for dt in (1e-3, 5e-4):
        state = model.state()
        drift = 0.0
        for _ in range(int(0.5 / dt)):
            solver.step(state, after, None, None, dt)
            state, after = after, state
            drift = max(drift, abs(novaphy.eval_energy(model, state)[0].sum() - start))
        worst.append(drift)
    assert 0 < worst[0] < 1e-4 * start and 0.4 * worst[0] < worst[1] < 0.65 * worst[0]


def test_many_worlds_have_the_bits_of_one():
    single, many = tree().finalize(), tree(worlds=9).finalize()
    results = []
    for model in (single, many):
        solver = solvers.SolverFeatherstone(model)
        state, after = model.state(), model.state()
        for _ in range(20):
            solver.step(state, after, None, None, DT)
            state, after = after, state
        results.append((state.joint_q.numpy(), state.joint_qd.numpy()))
    for one, all_of in zip(*results):
        assert np.array_equal(np.tile(one, 9), all_of)


@needs_diff
@pytest.mark.parametrize(
    "name", ["joint_q", "joint_qd", "joint_target_q", "joint_f", "joint_target_kd"]
)
def test_gradients_are_those_of_differences(name):
    from novaphy import diff, nova

    rng = np.random.default_rng(7)
    weights = rng.normal(size=6).astype(np.float32), rng.normal(size=6).astype(np.float32)
    dt = 0.02

    def run(change=None, row=0, gradient=False):
        b = tree()
        model = b.finalize(requires_grad=True)
        solver = solvers.DiffFeatherstoneSolver(model, angular_damping=0.5)
        states = [model.state(requires_grad=True) for _ in range(4)]
        control = model.control()
        source = {
            "joint_q": states[0].joint_q, "joint_qd": states[0].joint_qd,
            "joint_target_q": control.joint_target_q, "joint_f": control.joint_f,
            "joint_target_kd": model.joint_target_kd,
        }[name]  # fmt: skip
        if change is not None:
            values = source.numpy().copy()
            values[row] += change
            source.assign(values)
        source.requires_grad = True
        with nova.Tape() as tape:
            for k in range(3):
                solver.step(states[k], states[k + 1], control, None, dt)
            loss = nova.sum(
                diff.state_joint_q_tensor(states[3]) * nova.tensor(weights[0])
            ) + nova.sum(diff.state_joint_qd_tensor(states[3]) * nova.tensor(weights[1]))
            if gradient:
                tape.backward(loss)
                return source.grad.numpy().copy()
        q, qd = states[3].joint_q.numpy().astype(float), states[3].joint_qd.numpy().astype(float)
        return q @ weights[0] + qd @ weights[1]

    exact = run(gradient=True)
    eps = 1e-2
    for row in range(6):
        by_difference = (run(eps, row) - run(-eps, row)) / (2 * eps)
        assert abs(by_difference - exact[row]) < 3e-3 * np.abs(exact).max() + 1e-3, row


@needs_io
def test_the_fingers_of_the_fr3_close_on_a_box_together():
    """Only the leader has a drive; the hand, turned to the ground by the arm, carries the box."""
    text = novaphy.assets.path("fr3.urdf").read_text()
    at = text.index('<joint name="fr3_finger_joint2"')
    end = text.index("</joint>", at)
    text = text[:end] + '<mimic joint="fr3_finger_joint1"/>' + text[end:]
    b = novaphy.ModelBuilder()
    b.default_shape_cfg = novaphy.ShapeConfig(mu=0.8)
    found = b.add_urdf(text)
    leader, follower = (found.joint_dofs[f"fr3_finger_joint{k}"] for k in (1, 2))
    home = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4, 0.0155, 0.0155]
    b.joint_q = home
    b.joint_target_q = [*home[:7], 0.0, 0.0]
    b.joint_target_ke = [6000.0] * 7 + [2000.0, 0.0]
    b.joint_target_kd = [300.0] * 7 + [50.0, 0.0]
    for k in range(9):
        b.joint_target_mode[k] = int(novaphy.JointTargetMode.POSITION)
    # At home the hand points down: the fingers' pads are 39 mm below their origins.
    tool = (0.30689, 0.0, 0.48688 + 0.1034 - 0.0584 - 0.039)
    turn = (0.0, 0.0, 0.0, 1.0)
    box = b.add_body(xform=(tool, turn), mass=0.1, inertia=np.eye(3) * 2e-5)
    b.add_shape_box(box, hx=0.01, hy=0.015, hz=0.01, cfg=novaphy.ShapeConfig(mu=0.8, density=0.0))
    model = b.finalize()
    solver = solvers.SolverFeatherstone(model)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    center = 0.5 * sum(
        state.body_q.numpy()[found.links[f"fr3_{side}finger"], :3] for side in ("left", "right")
    )
    assert_allclose(center[:2], tool[:2], atol=1e-4)
    heights = []
    for _ in range(500):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, 1 / 500)
        state, after = after, state
        q = state.joint_q.numpy()
        assert q[leader] == q[follower]
        heights.append(state.body_q.numpy()[box, 2])
    assert q[leader] == pytest.approx(0.015, abs=1e-3)
    # the box is held, after it fell while the pads closed
    assert abs(heights[-1] - heights[250]) < 1e-3
    # At rest both pads share the drive's force, 2000 N/m times 15 mm. Each presses with half of the
    # force.
    force = contacts.rigid_contact_force.numpy()[: contacts.rigid_contact_count.numpy()[0]]
    across = np.abs(force[:, 1]).sum()
    assert across == pytest.approx(30.0, rel=0.01)


def branched_urdf(seed: int) -> str:
    """Two branches of random links on a base; the joint 4 follows 2, and 5 follows 1."""
    rng = np.random.default_rng(seed)

    def numbers(size: int, scale: float) -> str:
        return " ".join(f"{x:.4f}" for x in rng.normal(size=size) * scale)

    text = '<robot name="r"><link name="l0"/>'
    for k, parent in enumerate((0, 1, 2, 1, 4, 5), 1):
        moments = rng.uniform(0.02, 0.03, 3)
        inertia = " ".join(f'{n}="{x:.5f}"' for n, x in zip(("ixx", "iyy", "izz"), moments))
        follows = {
            4: '<mimic joint="j2" multiplier="-0.4" offset="0.1"/>',
            5: '<mimic joint="j1" multiplier="1.5" offset="-0.2"/>',
        }.get(k, "")
        text += (
            f'<link name="l{k}"><inertial><origin xyz="{numbers(3, 0.1)}" rpy="{numbers(3, 1)}"/>'
            f'<mass value="{rng.uniform(0.5, 2):.4f}"/>'
            f'<inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="{"prismatic" if k == 2 else "revolute"}">'
            f'<parent link="l{parent}"/><child link="l{k}"/>'
            f'<origin xyz="{numbers(3, 0.3)}" rpy="{numbers(3, 1)}"/><axis xyz="{numbers(3, 1)}"/>'
            f'<limit lower="-9" upper="9" effort="9" velocity="9"/>{follows}</joint>'
        )
    return text + "</robot>"


@needs_io
@pytest.mark.parametrize("seed", range(3))
def test_the_reduced_matrix_is_that_of_pinocchio(seed):
    """Its crba of the joined model; and T^T M T with its M of the free one."""
    pin = pytest.importorskip("pinocchio", reason="the oracle of this test: pip install pin")
    text = branched_urdf(seed)
    b = novaphy.ModelBuilder()
    found = b.add_urdf(text, joint_ordering=None)
    model = b.finalize()
    leaders = [found.joint_dofs[f"j{k}"] for k in (1, 2, 3, 6)]
    reduce = np.zeros((6, 4))
    for row, (k, column, factor) in enumerate(
        [(1, 0, 1), (2, 1, 1), (3, 2, 1), (4, 1, -0.4), (5, 0, 1.5), (6, 3, 1)]
    ):
        assert found.joint_dofs[f"j{k}"] == row
        reduce[row, column] = factor
    draw = np.random.default_rng(seed)
    joined, free = (pin.buildModelFromXML(text, mimic=mimic) for mimic in (True, False))
    assert joined.nv == 4 and free.nv == 6
    state = model.state()
    for _ in range(5):
        q = draw.uniform(-1, 1, 4)
        whole = reduce @ q + [0, 0, 0, 0.1, -0.2, 0]
        state.joint_q.assign(whole.astype(np.float32))
        inverse = novaphy.eval_forward_dynamics_derivatives(model, state, np.zeros(6, np.float32))[
            2
        ]
        ours = np.linalg.inv(inverse[0].astype(float)[np.ix_(leaders, leaders)])
        for exact, at, t in ((joined, q, np.eye(4)), (free, whole, reduce)):
            data = exact.createData()
            pin.crba(exact, data, at)
            mass = t.T @ (np.triu(data.M) + np.triu(data.M, 1).T) @ t
            assert_allclose(ours, mass, atol=1e-5 * np.abs(mass).max())


@needs_io
def test_a_mimic_of_a_file_follows_by_default():
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    links = "".join(f'<link name="{n}">{inertial}</link>' for n in "abcd")
    limit = '<limit lower="-2" upper="2" effort="5" velocity="{}"/>'

    def joint(name, kind, child, inside):
        return (
            f'<joint name="{name}" type="{kind}"><parent link="a"/><child link="{child}"/>'
            f"{inside}</joint>"
        )

    text = (
        f'<robot name="r">{links}'
        + joint("j", "revolute", "b", limit.format(4))
        + joint(
            "k",
            "prismatic",
            "c",
            limit.format(1) + '<mimic joint="j" multiplier="-0.5" offset="0.25"/>',
        )
        + joint("l", "revolute", "d", limit.format(9) + '<mimic joint="k" multiplier="3"/>')
        + "</robot>"
    )
    b = novaphy.ModelBuilder()
    b.default_joint_cfg.target_ke = 7.0
    found = b.add_urdf(text, scale=2.0)
    model = b.finalize()
    j, k, el = (found.joints[name] for name in "jkl")
    assert model.joint_mimic.numpy().tolist() == [-1, -1, j, k]
    # Lengths grow with the scale: of an angle's follower that slides, and back.
    assert_allclose(model.joint_mimic_coef.numpy()[[k, el]], [[0.5, -1.0], [0.0, 1.5]])
    assert_allclose(model.joint_q.numpy(), [0.0, 0.5, 0.75])
    # The velocity limit of k, 2 m/s, is one of 2 rad/s for j, and that of l one of 6 rad/s.
    assert_allclose(model.joint_velocity_limit.numpy()[0], 2.0)
    assert model.joint_target_ke.numpy().tolist() == [7.0, 0.0, 0.0]
    state = model.state()
    body = model.body_q.numpy()[found.links["c"]]
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    assert_allclose(state.body_q.numpy()[found.links["c"]], body, atol=1e-6)


def two():
    b = novaphy.ModelBuilder()
    links = [b.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(3)]
    joints = [
        b.add_joint_revolute(-1, links[0]),
        b.add_joint_revolute(links[0], links[1]),
        b.add_joint_ball(links[1], links[2]),
    ]
    return b, joints


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((0, 3), IndexError, "joint1: expected 0 to 2, got 3"),
        ((2, 0), ValueError, "joint0: joint 2 .* expected a REVOLUTE or PRISMATIC joint, got BALL"),
        ((0, 0), ValueError, "joint1: expected a joint that does not follow joint 0"),
        ((0, 1, float("nan")), ValueError, "coef0"),
        ((0, 1, 0.0, float("inf")), ValueError, "coef1"),
    ],
)
def test_what_cannot_follow_is_refused(arguments, error, message):
    b, joints = two()
    with pytest.raises(error, match=message):
        b.add_constraint_mimic(*arguments)
    b.add_articulation(joints)
    assert b.finalize().joint_mimic.numpy().tolist() == [-1, -1, -1]


def test_cycles_and_second_leaders_are_refused():
    b, _ = two()
    b.add_constraint_mimic(1, 0)
    with pytest.raises(ValueError, match="joint 1 .* expected one that mimics no other"):
        b.add_constraint_mimic(1, 0)
    with pytest.raises(ValueError, match="expected a joint that does not follow joint 0"):
        b.add_constraint_mimic(0, 1)


def test_a_leader_of_another_articulation_is_refused():
    b, joints = two()
    b.add_articulation(joints)
    other = b.add_link(mass=1.0, inertia=np.eye(3))
    b.add_articulation([b.add_joint_revolute(-1, other, label="apart")])
    b.add_constraint_mimic(3, 0)
    with pytest.raises(ValueError, match='joint "apart".* in the same articulation'):
        b.finalize()


def test_solvers_without_mimic_joints_say_so():
    model = tree().finalize()
    with pytest.raises(NotImplementedError, match="joint 4 .* mimics joint 2: mimic joints"):
        solvers.SolverSemiImplicit(model)
    with pytest.raises(NotImplementedError, match=r"dof 4 \(joint .*mimic joints are not"):
        solvers.FeatherstoneAnalyticControlSensitivity(
            model, parameter_count=1, point_body=1, point_local=(0, 0, 0), kind="torque",
            solver=solvers.SolverFeatherstone(model),
        )  # fmt: skip
    coef = model.joint_mimic_coef.numpy()
    coef[4, 1] = 2.0
    model.joint_mimic_coef.assign(coef)
    with pytest.raises(ValueError, match=r"joint_mimic_coef\[4\]: expected -0.4.*got 2"):
        solvers.SolverFeatherstone(model)


def test_no_gradient_reaches_the_coefficients():
    nova = pytest.importorskip("novaphy.nova")
    model = tree().finalize()
    model.joint_mimic_coef.requires_grad = True
    with nova.Tape(), pytest.raises(NotImplementedError, match="joint_mimic_coef"):
        solvers.DiffFeatherstoneSolver(model).step(model.state(), model.state(), None, None, 1e-3)


def test_collapsing_and_copies_keep_who_follows_whom():
    b = novaphy.ModelBuilder()
    links = [b.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(4)]
    joints = [
        b.add_joint_fixed(-1, links[0]),
        b.add_joint_revolute(links[0], links[1]),
        b.add_joint_fixed(links[1], links[2]),
        b.add_joint_revolute(links[2], links[3]),
    ]
    b.add_articulation(joints)
    b.add_constraint_mimic(joints[3], joints[1], 0.0, 2.0)
    b.collapse_fixed_joints()
    many = novaphy.ModelBuilder()
    many.replicate(b, 2)
    assert many.finalize().joint_mimic.numpy().tolist() == [-1, 0, -1, 2]


@needs_diff
@pytest.mark.skipif(not novaphy.is_device_available("cuda:0"), reason="no CUDA device")
def test_followers_on_a_device_have_the_bits_of_the_cpu():
    from novaphy import diff, nova

    found = []
    for device in ("cpu", "cuda:0"):
        model = tree(worlds=3).finalize(device, requires_grad=True)
        control = model.control()
        control.joint_f.assign(np.linspace(-2, 2, model.joint_dof_count, dtype=np.float32))
        control.joint_f.requires_grad = True
        solver = solvers.DiffFeatherstoneSolver(model, angular_damping=0.0)
        trajectory = diff.Trajectory(model, 8)
        with nova.Tape() as tape:
            solver.rollout(trajectory, control, None, DT)
            q = diff.state_joint_q_tensor(trajectory[8])
            tape.backward(nova.sum(q * q))
        end = trajectory[8]
        arrays = (end.joint_q, end.joint_qd, end.body_q, control.joint_f.grad)
        found.append([a.numpy() for a in arrays])
    for on_cpu, on_device in zip(*found, strict=True):
        np.testing.assert_array_equal(on_cpu, on_device)
    assert np.abs(found[0][3]).max() > 0.0


def test_followers_are_written_from_their_leaders() -> None:
    model = tree(worlds=2).finalize()
    state, after = model.state(), model.state()
    q, qd = state.joint_q.numpy(), state.joint_qd.numpy()
    rng = np.random.default_rng(8)
    for x in (q, qd):
        x += rng.uniform(-1, 1, x.shape).astype(np.float32)
    state.joint_q.assign(q)
    state.joint_qd.assign(qd)
    novaphy.eval_mimic(model, state.joint_q, state.joint_qd)
    got, rates = (x.numpy().reshape(2, 6) for x in (state.joint_q, state.joint_qd))
    assert np.array_equal(got[:, :4], q.reshape(2, 6)[:, :4])
    assert_allclose(got[:, 4], 0.1 - 0.4 * got[:, 2], atol=1e-6)
    assert_allclose(got[:, 5], -0.2 + 1.5 * got[:, 4], atol=1e-6)
    assert_allclose(rates[:, 4:], rates[:, 2:3] * [[-0.4, -0.6]], atol=1e-6)
    # The coordinates have the bits of a step's result.
    solvers.SolverFeatherstone(model).step(state, after, None, None, DT)
    q, qd = after.joint_q.numpy(), after.joint_qd.numpy()
    novaphy.eval_mimic(model, after.joint_q, after.joint_qd)
    assert np.array_equal(after.joint_q.numpy(), q)
    assert np.array_equal(after.joint_qd.numpy(), qd)
    with pytest.raises(ValueError, match="eval_mimic: joint_qd: expected 12 rows"):
        novaphy.eval_mimic(model, after.joint_q, novaphy.DeviceArray(q[:1]))


def test_reduced_matrices_are_those_of_the_joined_tree() -> None:
    model = tree().finalize()
    state = model.state()
    t = np.zeros((6, 4))
    t[:4] = np.eye(4)
    t[4, 2], t[5, 2] = -0.4, -0.6
    tau = np.linspace(-1.0, 1.0, 6)
    mass = t.T @ novaphy.eval_mass_matrix(model, state)[0] @ t
    bias = t.T @ novaphy.eval_bias(model, state)
    expected = t @ np.linalg.solve(mass, t.T @ tau - bias)
    assert_allclose(
        novaphy.eval_forward_dynamics(model, state, tau), expected, rtol=2e-4, atol=1e-4
    )
