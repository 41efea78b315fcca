"""Actuators that push bodies: laws, sites and ball joints of MJCF files, gradients, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

DT = 1e-3
ARM = """<mujoco><option gravity="0 0 0"><flag contact="disable"/></option><worldbody>
<site name="post" pos=".3 -.2 1.1" euler="20 -40 70"/>
<body name="base" pos="0 .1 1"><joint name="root" type="ball" pos="0 0 .05"/>
<geom type="capsule" size=".05" fromto="0 0 0 .3 .1 0"/>
<site name="hip" pos=".1 0 .1" euler="10 0 30"/>
<body name="left" pos=".3 .1 0" euler="0 30 0"><joint name="lift" axis="0 1 1"/>
<joint name="slide" type="slide" axis="1 0 .2"/><geom type="box" size=".1 .04 .03" pos=".1 0 0"/>
<site name="palm" pos=".2 .05 0" euler="0 60 10"/>
<body name="tip" pos=".2 0 .1"><joint name="wrist" type="ball" damping=".1"/>
<geom type="capsule" size=".03" fromto="0 0 0 .1 .05 .1"/>
<site name="nail" pos=".1 .02 .1" euler="50 0 0"/>
</body></body>
<body name="right" pos="-.1 .2 0"><joint name="swing" axis="1 0 0"/>
<geom type="ellipsoid" size=".1 .04 .03" pos="0 .1 0"/>
<site name="foot" pos="0 .2 .02" euler="0 0 90"/>
</body></body>
<body name="drone" pos="1 0 1"><freejoint name="fly"/>
<geom type="box" size=".1 .1 .02" pos=".02 0 0"/>
<site name="rotor" pos=".1 .1 .02" euler="5 10 0"/></body></worldbody>
<actuator>{}</actuator></mujoco>"""
SITES = {
    "rotor": '<motor site="rotor" gear="0 0 1 0 0 -.02"/>',
    "wrench": '<motor site="nail" gear="1 2 -3 .4 -.2 .1" forcerange="-1 .6"/>',
    "damper": '<velocity site="palm" gear="0 1 0 0 0 2" kv="3"/>',
    "servo": '<position site="nail" refsite="foot" gear="1 .5 -.2 .3 .1 -.4" kp="20" kv="2"/>',
    "apart": '<position site="foot" refsite="palm" gear="0 1 0" kp="20" dampratio="0"/>',
    "turn": '<position site="palm" refsite="hip" gear="0 0 0 0 1 1" kp="9"/>',
    "same": '<motor site="hip" refsite="foot" gear="1 1 1"/>',
    "post": '<general site="palm" refsite="post" gear="1 0 2 .1 .2 .3" gainprm="3" '
    'biastype="affine" biasprm=".1 -4 -.3" dyntype="filter" dynprm=".05"/>',
    "from post": '<motor site="post" refsite="nail" gear="1 0 2 .1 .2 .3"/>',
    "ball": '<position joint="wrist" gear="1 2 -.5" kp="6" kv=".3"/>',
    "in parent": '<position jointinparent="root" gear="1 2 -.5" kp="6" kv=".3"/>',
    "free": '<motor joint="fly" gear="1 2 3 .1 .2 .3"/>',
    "free in parent": '<motor jointinparent="fly" gear="1 2 3 .1 .2 .3"/>',
}


def step(model, state, control=None, dt=DT):
    after = model.state()
    novaphy.solvers.SolverFeatherstone(model).step(state, after, control, None, dt)
    return after


def floating(**actuator) -> novaphy.Model:
    builder = novaphy.ModelBuilder(gravity=0.0)
    body = builder.add_body(mass=2.0, inertia=np.eye(3), com=(0.1, 0, 0))
    builder.add_body_actuator(body, **actuator)
    return builder.finalize()


def test_a_rotor_lifts_and_turns_a_body():
    model = floating(wrench=(0, 0, 2, 0, 0, 0.5), frame=((0.1, 0.3, 0), (0, 0, 0, 1)))
    model.ctrl.assign([3.0])
    state = step(model, model.state())
    # 6 N at 0.3 m beside the center of mass, and 1.5 N m
    assert_allclose(state.joint_qd.numpy(), DT * np.array([0, 0, 3, 0.3 * 6, 0, 1.5]), rtol=1e-5)
    assert_allclose(novaphy.eval_actuator_forces(model, state), [3.0])


def test_a_pair_of_frames_pushes_nothing_that_carries_both():
    builder = novaphy.ModelBuilder(gravity=0.0)
    links = [builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(3)]
    joints = [builder.add_joint_free(links[0])]
    for side in (-1, 1):
        pose = ((side, 0, 0), (0, 0, 0, 1))
        joints.append(
            builder.add_joint_prismatic(links[0], links[(side + 3) // 2], axis=(0, 0, 1),
                                        parent_xform=pose)
        )  # fmt: skip
    builder.add_articulation(joints)
    builder.add_body_actuator(links[1], wrench=(0, 0, 1, 0, 0, 0), reference_body=links[2],
                              gain=(0, 0, 0), bias=(0, -5, 0))  # fmt: skip
    model = builder.finalize()
    model.joint_q.assign([0, 0, 0, 0, 0, 0, 1, 0.02, -0.01])
    state = model.state()
    assert_allclose(novaphy.eval_actuator_forces(model, state), [-5 * 0.03], rtol=1e-5)
    after = step(model, state).joint_qd.numpy() / DT
    # 0.15 N on the left slider at -1 m, and -0.15 N on the right one: the base, 3 kg m^2 with both,
    # turns by their reactions alone.
    assert_allclose(after[[4, 6, 7]], [0.1, -0.15 - 0.1, 0.15 + 0.1], rtol=1e-3)
    assert_allclose(after[[0, 1, 2, 3, 5]], np.zeros(5), atol=1e-3)


def ours_and_theirs(actuators, seed):
    """A random state of both engines: (model, state, control, mujoco's model and data, change)."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    exact = mujoco.MjModel.from_xml_string(ARM.format(actuators))
    data = mujoco.MjData(exact)
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(ARM.format(actuators))
    model = builder.finalize()
    draw = np.random.default_rng(seed)
    data.qpos[:] = np.float32(draw.normal(size=exact.nq))
    for at in (0, 6, 14):
        data.qpos[at : at + 4] /= np.linalg.norm(data.qpos[at : at + 4])
    data.qvel[:] = draw.normal(size=exact.nv)
    data.ctrl[:] = np.float32(draw.uniform(-2, 2, exact.nu))
    data.act[:] = np.float32(draw.uniform(-1, 1, exact.na))
    mujoco.mj_forward(exact, data)
    q, change = data.qpos.copy(), np.eye(exact.nv)
    for at, dof, joint in ((0, 0, "root"), (6, 5, "wrist"), (14, 12, "fly")):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[at : at + 4])
        change[dof : dof + 3, dof : dof + 3] = turn.reshape(3, 3)
        q[at : at + 4] = np.roll(data.qpos[at : at + 4], -1)
        if joint == "fly":
            x, y, z = change[12:, 12:] @ model.body_com.numpy()[robot.links["drone"]]
            arm = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            change[9:12, 12:] = -arm @ change[12:, 12:]
    state, control = model.state(), model.control()
    state.joint_q.assign(np.float32(q))
    state.joint_qd.assign(np.float32(change @ data.qvel))
    control.ctrl.assign(np.float32(data.ctrl))
    state.act.assign(np.float32(data.act))
    return model, state, control, exact, data, change


def moments(model, state):
    """What a force of 1 of each actuator is for the dofs, by the rates {actuators, dofs}."""
    ranges = np.tile(np.float32([-1e10, 1e10]), (model.actuator_count, 1))
    given = {
        "gain": np.zeros((model.actuator_count, 3), np.float32), "force_range": ranges,
        "bias": np.tile(np.float32([0, 0, 1]), (model.actuator_count, 1)),
    }  # fmt: skip
    kept = {name: getattr(model, f"actuator_{name}").numpy().copy() for name in given}
    rates, columns = state.joint_qd.numpy().copy(), []
    for name, values in given.items():
        getattr(model, f"actuator_{name}").assign(values)
    for unit in np.eye(model.joint_dof_count, dtype=np.float32):
        state.joint_qd.assign(unit)
        columns.append(novaphy.eval_actuator_forces(model, state))
    for name, values in kept.items():
        getattr(model, f"actuator_{name}").assign(values)
    state.joint_qd.assign(rates)
    return np.array(columns).T


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")
class TestFiles:
    @pytest.mark.parametrize("name", SITES)
    def test_forces_of_sites_and_joints_are_those_of_mujoco(self, name):
        for seed in range(3):
            model, state, control, _, data, change = ours_and_theirs(SITES[name], seed)
            force = novaphy.eval_actuator_forces(model, state, control)
            assert_allclose(force, data.actuator_force, rtol=1e-5, atol=1e-5)
            got = change.T @ moments(model, state).T @ force
            scale = max(np.abs(data.qfrc_actuator).max(), 1e-3)
            assert np.abs(got - data.qfrc_actuator).max() < 1e-5 * max(scale, 1.0)
            # The effect on a step: with and without the actuator.
            free = step(model, state, control)
            model.actuator_wrench.assign(np.zeros((1, 6), np.float32))
            still = step(model, state, control)
            moved = (free.joint_qd.numpy() - still.joint_qd.numpy()).astype(float) / DT
            sizes, parts = (9, 6), np.split(moved, [9])
            damping = DT * np.diag(model.joint_damping.numpy()[:9])
            blocks = novaphy.eval_mass_matrix(model, state)
            ours = [
                (np.asarray(block)[:n, :n] + damped) @ part
                for block, n, damped, part in zip(blocks, sizes, (damping, 0.0), parts, strict=True)
            ]
            pushed = change.T @ np.concatenate(ours)
            assert np.abs(pushed - data.qfrc_actuator).max() < 2e-3 * scale

    def test_all_of_them_are_rows_of_one_table(self):
        builder = novaphy.ModelBuilder()
        robot = builder.add_mjcf(ARM.format("".join(SITES.values())))
        assert sorted(robot.actuators.values()) == list(range(len(SITES)))
        assert not robot.report.left_out
        model = builder.finalize()
        every = novaphy.ModelBuilder()
        every.replicate(builder, 2)
        worlds = every.finalize()
        bodies = worlds.actuator_body.numpy()
        count = len(SITES)
        assert (
            bodies[count:] == np.where(bodies[:count] < 0, -1, bodies[:count] + model.body_count)
        ).all()
        state, after = worlds.state(), step(model, model.state())
        worlds.ctrl.assign(np.tile(model.ctrl.numpy(), 2))
        both = step(worlds, state).joint_qd.numpy().reshape(2, -1)
        np.testing.assert_array_equal(both[0], after.joint_qd.numpy())
        np.testing.assert_array_equal(both[1], both[0])
        found = worlds.select("rotor*", world=1)
        assert found.actuators.tolist() == [count]

    def test_merged_bodies_keep_their_sites(self):
        text = ARM.format(SITES["servo"]).replace('<joint name="swing" axis="1 0 0"/>', "")
        results = []
        for collapse in (False, True):
            builder = novaphy.ModelBuilder()
            builder.add_mjcf(text, collapse_fixed_joints=collapse)
            model = builder.finalize()
            assert model.body_count == 6 - collapse
            results.append(step(model, model.state()).joint_qd.numpy())
        assert_allclose(results[0], results[1], rtol=1e-4, atol=1e-6)

    def test_sites_of_two_trees_are_left_out_by_name(self):
        text = ARM.format('<motor name="rope" site="rotor" refsite="hip" gear="1"/>')
        with pytest.raises(NotImplementedError, match='"rope".*sites of two trees'):
            novaphy.ModelBuilder().add_mjcf(text)
        robot = novaphy.ModelBuilder().add_mjcf(text, unsupported="warn")
        assert "two trees" in robot.report.left_out[0].text and not robot.actuators
        with pytest.raises(ValueError, match='there is no site "nose"'):
            novaphy.ModelBuilder().add_mjcf(ARM.format('<motor site="nose"/>'))


def test_bad_arguments_are_refused_by_name():
    builder = novaphy.ModelBuilder()
    body = builder.add_body(mass=1.0, inertia=np.eye(3))
    wrench = (1, 0, 0, 0, 0, 0)
    for arguments, options, error, message in (
        ((3,), {}, IndexError, "body: expected -1 to 0, got 3"),
        ((-1,), {}, ValueError, "body, reference_body: expected at least one body"),
        ((body,), {"reference_body": 7}, IndexError, "reference_body: expected -1 to 0, got 7"),
        ((body,), {"wrench": (np.nan, 0, 0, 0, 0, 0)}, ValueError, "wrench: expected finite"),
        ((body,), {"frame": (0, 0, 0, 0, 0, 0, 2)}, ValueError, "frame"),
        ((body,), {"force_range": (1, 0)}, ValueError, "force_range: expected the lower one"),
    ):
        with pytest.raises(error, match=f"add_body_actuator: .*{message}"):
            builder.add_body_actuator(*arguments, **{"wrench": wrench, **options})
    other = builder.add_body(mass=1.0, inertia=np.eye(3))
    builder.add_body_actuator(body, wrench=wrench, reference_body=other, label="rope")
    model = builder.finalize()
    with pytest.raises(NotImplementedError, match=r'\("rope"\): expected two bodies of one artic'):
        step(model, model.state())


@pytest.mark.skipif(not novaphy.has_diff() or not novaphy.has_io(), reason="needs diff and io")
class TestGradients:
    NAMES = ("joint_q", "joint_qd", "ctrl", "act", "wrench", "gain", "bias", "force_range", "com")

    @staticmethod
    def owner(name, model, state, control):
        if name in ("joint_q", "joint_qd", "act"):
            return state, "state", name
        if name == "ctrl":
            return control, "control", name
        return model, "model", "body_com" if name == "com" else f"actuator_{name}"

    @staticmethod
    def scene():
        builder = novaphy.ModelBuilder()
        builder.add_mjcf(ARM.format("".join(SITES.values())))
        model = builder.finalize()
        draw = np.random.default_rng(3)
        q = draw.normal(size=model.joint_coord_count)
        for joint in np.flatnonzero(np.isin(model.joint_type.numpy(), (2, 4))):
            end = model.joint_q_start.numpy()[joint + 1]
            q[end - 4 : end] /= np.linalg.norm(q[end - 4 : end])
        start = {
            "joint_q": q, "joint_qd": draw.normal(size=model.joint_dof_count),
            "ctrl": draw.normal(size=model.actuator_count), "act": draw.normal(size=1),
        }  # fmt: skip
        weights = draw.normal(size=model.joint_dof_count)
        return model, {k: np.float32(v) for k, v in start.items()}, np.float32(weights)

    def loss(self, model, start, weights, names=()):
        from novaphy import diff, nova

        state, after, control = model.state(), model.state(), model.control()
        for name in ("joint_q", "joint_qd", "act"):
            getattr(state, name).assign(start[name])
        control.ctrl.assign(start["ctrl"])
        owners = {n: self.owner(n, model, state, control) for n in names}
        for owner, _, name in owners.values():
            getattr(owner, name).requires_grad = True
        solver = novaphy.solvers.DiffFeatherstoneSolver(model)
        tape = nova.Tape()
        with tape:
            solver.step(state, after, control, None, 0.01)
            value = nova.sum(diff.state_joint_qd_tensor(after) * nova.tensor(weights))
        return tape, value, owners

    def test_gradients_are_differences_and_tangents_are_gradients(self):
        from novaphy import diff, nova

        model, start, weights = self.scene()
        draw = np.random.default_rng(4)
        tape, value, owners = self.loss(model, start, weights, self.NAMES)
        ways, tangents = {}, {}
        with tape:
            for name, (owner, kind, field) in owners.items():
                shape = getattr(owner, field).numpy().shape
                ways[name] = np.float32(draw.normal(size=shape))
                tensor = getattr(diff, f"{kind}_{field}_tensor")(owner)
                tangents[name] = tape.jvp([value], [tensor], [nova.tensor(ways[name])])[0].item()
            tape.backward(value)
        for name, (owner, _, field) in owners.items():
            gradient = getattr(owner, field).grad.numpy().astype(float)
            along = (gradient * ways[name]).sum()
            assert_allclose(tangents[name], along, rtol=1e-3, atol=1e-5, err_msg=name)
            base = start[name] if name in start else getattr(owner, field).numpy().copy()
            ends = []
            for sign in (1, -1):
                moved = np.float32(base + sign * 1e-2 * ways[name])
                if name in start:
                    ends.append(self.loss(model, {**start, name: moved}, weights)[1].item())
                    continue
                getattr(owner, field).assign(moved)
                ends.append(self.loss(model, start, weights)[1].item())
                getattr(owner, field).assign(base)
            assert_allclose(along, (ends[0] - ends[1]) / 2e-2, rtol=2e-2, atol=2e-3, err_msg=name)
