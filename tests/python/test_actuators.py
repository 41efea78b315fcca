"""Actuators and gravity compensation: laws, numbers of MuJoCo, gradients, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import novaphy
from novaphy import ActuatorDynamics

DT = 2e-3


def hinge(actuators=(), gravity=0.0, gravcomp=0.0, **joint) -> novaphy.Model:
    """A wheel of 1 kg m^2 about its center, or a pendulum where there is gravity."""
    builder = novaphy.ModelBuilder(gravity=gravity)
    com = (0.5, 0, 0) if gravity else (0, 0, 0)
    link = builder.add_link(mass=2.0, inertia=np.eye(3), com=com, gravcomp=gravcomp)
    j = builder.add_joint_revolute(-1, link, axis=(0, 1, 0), **joint)
    builder.add_articulation([j])
    for actuator in actuators:
        builder.add_actuator(j, **actuator)
    return builder.finalize()


def run(model, steps, ctrl=None, dt=DT, solver=novaphy.solvers.SolverFeatherstone):
    made, state, control = solver(model), model.state(), model.control()
    if ctrl is not None:
        control.ctrl.assign(ctrl)
    for _ in range(steps):
        made.step(state, state, control, None, dt)
    return state


def test_a_motor_is_a_force_and_its_ranges_cut():
    model = hinge(
        [{"gear": 3.0, "ctrl_range": (-1, 0.5)}, {"gear": -2.0, "force_range": (-0.25, 9)}]
    )
    state = run(model, 100, [2.0, -1.0])
    assert_allclose(state.joint_qd.numpy(), [(3 * 0.5 + 2 * 0.25) * 100 * DT], rtol=1e-5)
    forces = novaphy.eval_actuator_forces(model, state)
    assert forces.tolist() == [0.0, 0.0]


def test_a_servo_of_any_gain_is_stable_and_stands_at_its_control():
    servo = {"gain": (1e6, 0, 0), "bias": (0, -1e6, -1e3), "gear": 2.0}
    state = run(hinge([servo]), 300, [0.8], dt=0.01)
    assert_allclose(state.joint_q.numpy(), [0.4], rtol=1e-5)
    wheel = {"gain": (50.0, 0, 0), "bias": (0, 0, -50.0)}
    assert_allclose(run(hinge([wheel]), 500, [3.0]).joint_qd.numpy(), [3.0], rtol=1e-5)


def test_a_force_range_of_a_servo_is_about_its_middle():
    servo = {"gain": (1e4, 0, 0), "bias": (0, -1e4, 0), "gear": -2.0, "force_range": (-1.0, 3.0)}
    for ctrl, torque in ((9.0, -2 * 3.0), (-9.0, 2 * 1.0)):
        state = run(hinge([servo]), 1, [ctrl])
        assert_allclose(state.joint_qd.numpy(), [torque * DT], rtol=1e-5)


def test_activations_follow_their_controls():
    kinds = (ActuatorDynamics.INTEGRATOR, ActuatorDynamics.FILTER, ActuatorDynamics.FILTER_EXACT)
    model = hinge([{"dynamics": k, "time": 0.1, "gear": 0.0, "ctrl": 0.4} for k in kinds])
    assert (model.actuator_count, model.actuator_state_count) == (3, 3)
    act = run(model, 50).act.numpy()
    assert_allclose(act[0], 0.4 * 50 * DT, rtol=1e-5)
    assert_allclose(act[1], 0.4 * (1 - (1 - DT / 0.1) ** 50), rtol=1e-5)
    assert_allclose(act[2], 0.4 * (1 - np.exp(-50 * DT / 0.1)), rtol=1e-5)
    cut = hinge([{"dynamics": kinds[0], "act_range": (-1, 0.01), "ctrl": 5.0}])
    assert run(cut, 10).act.numpy() == np.float32(0.01)


def test_gravity_compensation_takes_weight_away():
    held = run(hinge(gravity=-9.81, gravcomp=1.0), 100)
    assert_allclose(held.joint_qd.numpy(), [0.0], atol=1e-6)
    half, light = hinge(gravity=-9.81, gravcomp=0.5), hinge(gravity=-9.81 / 2)
    assert_allclose(run(half, 100).joint_q.numpy(), run(light, 100).joint_q.numpy(), rtol=1e-5)
    merged = novaphy.ModelBuilder()
    links = [merged.add_link(mass=1.0, inertia=np.eye(3), gravcomp=g) for g in (0, 0, 1)]
    joints = [merged.add_joint_revolute(-1, links[0])]
    joints += [merged.add_joint_fixed(links[0], link) for link in links[1:]]
    merged.add_articulation(joints)
    merged.collapse_fixed_joints()
    assert merged.body_count == 2


def test_worlds_have_actuators_of_their_own_and_a_restored_model_too():
    import pickle

    one = novaphy.ModelBuilder(gravity=0.0)
    link = one.add_link(mass=1.0, inertia=np.eye(3))
    joint = one.add_joint_revolute(-1, link)
    one.add_articulation([joint])
    one.add_actuator(joint, dynamics=ActuatorDynamics.INTEGRATOR)
    one.add_actuator(joint, label="push")
    every = novaphy.ModelBuilder(gravity=0.0)
    every.replicate(one, 3)
    model = every.finalize()
    assert model.actuator_dof.numpy().tolist() == [0, 0, 1, 1, 2, 2]
    assert model.actuator_state.numpy().tolist() == [0, -1, 1, -1, 2, -1]
    model = pickle.loads(pickle.dumps(model))
    assert model.actuator_label == ["actuator_0", "push"] * 3
    state = run(model, 1, [0, 1, 0, 2, 0, 3])
    assert_allclose(state.joint_qd.numpy(), np.array([1, 2, 3]) * DT, rtol=1e-6)


def test_many_worlds_at_once_have_the_bits_of_each_alone():
    one = novaphy.ModelBuilder()
    link = one.add_link(mass=2.0, inertia=np.eye(3), com=(0.5, 0, 0), gravcomp=0.3)
    joint = one.add_joint_revolute(-1, link, axis=(0, 1, 0))
    one.add_articulation([joint])
    one.add_actuator(joint, gain=(40, 0, 0), bias=(0, -40, -2), ctrl=0.3, force_range=(-6, 5))
    starts = np.float32([0.0, 0.1, 0.9, -0.4, 0.3, 0.7])

    def end(starts, solver):
        every = novaphy.ModelBuilder()
        every.replicate(one, len(starts))
        model = every.finalize()
        model.joint_q.assign(starts)
        state = run(model, 40, solver=solver)
        return np.array([state.joint_q.numpy(), state.joint_qd.numpy()])

    solvers = [novaphy.solvers.SolverFeatherstone]
    if novaphy.has_diff():
        solvers.append(novaphy.solvers.DiffFeatherstoneSolver)
    for solver in solvers:
        alone = np.concatenate([end(starts[k : k + 1], solver) for k in range(6)], axis=1)
        np.testing.assert_array_equal(end(starts, solver), alone)
    assert np.abs(alone[1]).max() > 0.3


REFUSED = {
    "pushes": ({"bias": (0, 1, 0)}, {}, NotImplementedError, "forces per length and rate <= 0"),
    "gain pushes": ({"gain": (0, 1, 0), "ctrl_range": (-1, 1)}, {}, NotImplementedError, "<= 0"),
    "mode": ({"bias": (0, -1, 0)}, {"actuator_mode": 1}, NotImplementedError, "VELOCITY, got 1"),
    "one end": ({"bias": (0, -1, 0), "force_range": (0, 1e10)}, {}, NotImplementedError,
                "two ends"),
    "another drive": ({"bias": (0, -1, 0), "force_range": (0, 1)}, {"target_ke": 1.0},
                      NotImplementedError, "another drive"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_drive_can_be_is_refused_by_name(name):
    actuator, joint, error, message = REFUSED[name]
    model = hinge([actuator], **joint)
    with pytest.raises(error, match=rf'\("actuator_0"\): .*{message}'):
        run(model, 1)


def test_arguments_and_other_solvers_are_refused_by_name():
    builder = novaphy.ModelBuilder()
    body = builder.add_body(mass=1.0, inertia=np.eye(3))
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    joint = builder.add_joint_revolute(body, link)
    for arguments, error, message in (
        ((9,), IndexError, "joint: expected 0 to 1, got 9"),
        ((0,), ValueError, "expected a joint with axes, such as REVOLUTE or D6, got FREE"),
    ):
        with pytest.raises(error, match=message):
            builder.add_actuator(*arguments)
    for options, error, message in (
        ({"axis": 1}, IndexError, "axis: expected 0 to 0"),
        ({"gear": np.nan}, ValueError, "gear"),
        ({"time": 0.0}, ValueError, "time"),
        ({"ctrl_range": (1, 0)}, ValueError, "ctrl_range: expected the lower one first"),
        ({"dynamics": 7}, ValueError, "dynamics: expected an ActuatorDynamics, got 7"),
    ):
        with pytest.raises(error, match=f"add_actuator: .*{message}"):
            builder.add_actuator(joint, **options)
    assert builder.actuator_count == 0
    for model, name in ((hinge([{}]), "actuators"), (hinge(gravcomp=0.1), "body_gravcomp")):
        solver = novaphy.solvers.SolverSemiImplicit(model)
        with pytest.raises((NotImplementedError, ValueError), match=name):
            solver.step(model.state(), model.state(), None, None, DT)
    model = hinge([{}])
    model.actuator_ctrl_range.assign([[1.0, 0.0]])
    with pytest.raises(ValueError, match=r"actuator_ctrl_range\[0\]: expected the lower one"):
        run(model, 1)


MUJOCO = """<mujoco><option timestep="0.002" integrator="implicitfast"><flag contact="disable"/>
</option><worldbody><body pos="0 0 2" gravcomp=".4"><joint name="a" axis="0 1 0" damping=".3"/>
<geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/><body pos=".3 0 0" gravcomp="1">
<joint name="b" axis="0 1 1"/><geom type="capsule" size=".04" fromto="0 0 0 .2 .1 0"/>
<body pos=".2 .1 0"><joint name="c" type="slide" axis="1 0 0"/><geom size=".05"/></body>
</body></body></worldbody><actuator><position joint="a" kp="9" kv="2" timeconst=".1"/>
<intvelocity joint="b" kp="6" kv=".5" actrange="-.5 .5"/><motor joint="c" gear="3"
ctrlrange="-1 .2"/>
<damper joint="c" kv="2" ctrlrange="0 2"/></actuator></mujoco>"""


def test_a_trajectory_is_that_of_mujoco():
    """The error of 0.2 s falls with the step as that of an integrator of first order does."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    if not novaphy.has_io():
        pytest.skip("built with NOVAPHY_WITH_IO=OFF")
    errors = []
    for dt in (1e-3, 2.5e-4):
        exact = mujoco.MjModel.from_xml_string(MUJOCO)
        exact.opt.timestep, ctrl = 1e-5, [0.5, -0.7, 0.6, 1.5]
        data = mujoco.MjData(exact)
        data.ctrl[:] = ctrl
        mujoco.mj_step(exact, data, 20000)
        builder = novaphy.ModelBuilder()
        builder.add_mjcf(MUJOCO)
        state = run(builder.finalize(), round(0.2 / dt), ctrl, dt)
        ours = np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy(), state.act.numpy()])
        errors.append(np.abs(ours - np.concatenate([data.qpos, data.qvel, data.act])).max())
    assert errors[0] < 8e-3 and errors[1] < 0.35 * errors[0], errors


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
class TestGradients:
    NAMES = (
        *tuple(
            f"actuator_{n}"
            for n in ("gear", "gain", "bias", "time", "ctrl_range", "force_range", "act_range")
        ),
        "body_gravcomp",
    )

    @staticmethod
    def model() -> novaphy.Model:
        servo = {
            "gain": (9.0, 0, 0), "bias": (0.1, -8.0, -0.4), "gear": -1.5, "ctrl": 0.9,
            "force_range": (-0.5, 2.0), "ctrl_range": (-2, 0.8),
        }  # fmt: skip
        lag = {"dynamics": ActuatorDynamics.FILTER_EXACT, "time": 0.02, "ctrl": 0.5, "act": 0.1}
        return hinge([servo, lag], gravity=-9.81, gravcomp=0.6)

    def test_a_rollout_has_them_by_controls_of_every_step(self):
        from novaphy import diff, nova

        model, steps = self.model(), 12
        draw = np.random.default_rng(4)
        start = (0.3 * draw.normal(size=(steps, 2))).astype(np.float32)
        weights = draw.normal(size=steps + 1)

        def value(ctrl, checkpoint=1):
            trajectory = diff.Trajectory(model, steps, checkpoint=checkpoint)
            solver = novaphy.solvers.DiffFeatherstoneSolver(model)
            solver.rollout(trajectory, None, None, DT, ctrl=ctrl)
            assert trajectory.act.shape == (len(trajectory.kept_steps), 1)
            loss = nova.sum(diff.state_joint_qd_tensor(trajectory[steps]))
            for t in range(1, steps + 1) if checkpoint == 1 else (steps,):
                loss = loss + float(weights[t]) * nova.sum(diff.state_act_tensor(trajectory[t]))
            return loss

        ctrl = nova.tensor(start, requires_grad=True)
        with nova.Tape() as tape:
            tape.backward(value(ctrl))
        gradient, way = ctrl.grad.numpy().astype(float), draw.normal(size=start.shape)
        ends = [value(nova.tensor((start + s * 0.03 * way).astype(np.float32))).item()
                for s in (1, -1)]  # fmt: skip
        assert_allclose((gradient * way).sum(), (ends[0] - ends[1]) / 0.06, rtol=2e-3)
        found = []
        for checkpoint in (2, 5):
            again = nova.tensor(start, requires_grad=True)
            with nova.Tape() as tape:
                tape.backward(value(again, checkpoint))
            found.append(again.grad.numpy())
        assert (found[0] == found[1]).all() and np.abs(found[0]).max() > 0

    def test_a_tangent_is_the_gradient_along_it(self):
        from novaphy import diff, nova

        model = self.model()
        solver = novaphy.solvers.DiffFeatherstoneSolver(model)
        state, after, control = model.state(), model.state(), model.control()
        places = [(model, "model", name) for name in self.NAMES]
        places += [(control, "control", "ctrl"), (state, "state", "act")]
        for owner, _, name in places:
            getattr(owner, name).requires_grad = True
        draw = np.random.default_rng(5)
        with nova.Tape() as tape:
            solver.step(state, after, control, None, DT)
            loss = nova.sum(diff.state_joint_qd_tensor(after)) + nova.sum(
                diff.state_act_tensor(after)
            )
            along, found = [], []
            for owner, kind, name in places:
                way = draw.normal(size=getattr(owner, name).numpy().shape).astype(np.float32)
                one = getattr(diff, f"{kind}_{name}_tensor")(owner)
                along.append(way)
                found.append(tape.jvp([loss], [one], [nova.tensor(way)])[0].item())
            tape.backward(loss)
        for (owner, _, name), way, value in zip(places, along, found, strict=True):
            gradient = getattr(owner, name).grad.numpy().astype(float)
            assert_allclose(value, (gradient * way).sum(), rtol=1e-4, atol=1e-6, err_msg=name)
        assert np.abs(found).min() > 0 or found.count(0.0) <= 2

    def test_gravity_compensation_of_none_has_a_gradient(self):
        from novaphy import diff, nova

        model = hinge(gravity=-9.81)
        model.body_gravcomp.requires_grad = True
        state, after = model.state(), model.state()
        with nova.Tape() as tape:
            novaphy.solvers.DiffFeatherstoneSolver(model).step(state, after, None, None, DT)
            tape.backward(nova.sum(diff.state_joint_qd_tensor(after)))
        # The weight falls by 2 kg at 0.5 m, with 1 + 2 0.5^2 kg m^2.
        expected = -2 * 0.5 * 9.81 * DT / 1.5
        assert_allclose(model.body_gravcomp.grad.numpy(), [expected], rtol=1e-5)


def test_names_select_sites_and_the_shapes_of_bodies():
    one = novaphy.ModelBuilder(gravity=0.0)
    link = one.add_link(mass=1.0, inertia=np.eye(3), label="arm")
    one.add_articulation([one.add_joint_revolute(-1, link)], label="robot")
    one.add_shape_sphere(link, radius=0.1, label="hull")
    site = one.add_site(link, xform=((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)), label="tip")
    every = novaphy.ModelBuilder(gravity=0.0)
    every.replicate(one, 2)
    every.add_site(-1, label="goal")
    model = every.finalize()
    tips = model.select("robot/tip")
    assert tips.sites.tolist() == tips.shapes.tolist() == [site, site + 2]
    assert tips.get(model, "shape_transform")[:, 0, 2].tolist() == [0.5, 0.5]
    assert model.select("*", world=1).sites.tolist() == [site + 2]
    assert model.select("hull").sites.tolist() == []
    assert model.select("goal").get(model, "shape_body").tolist() == [-1]
    # A site has no mass and meets nothing: only the pair of the two hulls could, of two worlds.
    assert model.body_mass.numpy()[0] == np.float32(1.0 + 1000.0 * 4.0 / 3.0 * np.pi * 0.1**3)
    flags = model.shape_flags.numpy()
    assert flags[site] == novaphy.ShapeFlags.SITE and not flags[0] & novaphy.ShapeFlags.SITE


def test_names_select_joints_bodies_and_actuators_over_worlds():
    one = novaphy.ModelBuilder(gravity=0.0)
    parent = -1
    for k, name in enumerate(("hip", "knee_l", "knee_r")):
        link = one.add_link(mass=1.0, inertia=np.eye(3), label=name)
        joint = one.add_joint_revolute(parent, link, label=name)
        parent = link if k == 0 else parent
    one.add_articulation([0, 1, 2], label="leg")
    for joint in (2, 1):
        one.add_actuator(joint, label=f"push_{joint}")
    every = novaphy.ModelBuilder(gravity=0.0)
    every.replicate(one, 2)
    model = every.finalize()
    knees = model.select("leg/knee*")
    assert knees.joints.tolist() == knees.dofs.tolist() == knees.coords.tolist() == [1, 2, 4, 5]
    assert knees.bodies.tolist() == [1, 2, 4, 5] and knees.actuators.tolist() == []
    assert model.select("push_?", world=1).actuators.tolist() == [2, 3]
    state, control = model.state(), model.control()
    knees.set(state, "joint_q", [[1, 2], [3, 4]])
    assert state.joint_q.numpy().tolist() == [0, 1, 2, 0, 3, 4]
    assert knees.get(state, "joint_q").tolist() == [[1, 2], [3, 4]]
    assert knees.get(state, "body_q").shape == (2, 2, 7)
    model.select("*/push_1").set(control, "ctrl", 7.0)
    assert control.ctrl.numpy().tolist() == [0, 7, 0, 7]
    assert model.select("hip", world=0).get(state, "joint_qd").tolist() == [0.0]
    for arguments, error, message in (
        ({"pattern": "toe"}, ValueError, "name of a joint, body, shape or actuator, got 'toe'"),
        ({"pattern": None}, TypeError, "pattern: expected a str, got None"),
        ({"pattern": "*", "world": 2}, IndexError, "world: expected -1 to 1, got 2"),
    ):
        with pytest.raises(error, match=message):
            model.select(**arguments)
    with pytest.raises(ValueError, match="field: expected one of joints, .* got 'particle_q'"):
        knees.get(state, "particle_q")


def test_fields_of_joints_are_selected_by_joint():
    builder = novaphy.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(3)]
    joints = [builder.add_joint_free(links[0], label="root")]
    for k in (1, 2):
        joints.append(
            builder.add_joint_revolute(
                links[k - 1], links[k], label=f"hinge_{k}", parent_xform=((k, 0, 0), (0, 0, 0, 1))
            )
        )
    builder.add_articulation(joints)
    model = builder.finalize()
    hinge = model.select("hinge_1")
    assert hinge.get(model, "joint_X_p")[0, 0] == 1.0
    assert hinge.get(model, "joint_child").tolist() == [links[1]]
    hinge.set(model, "joint_enabled", 0)
    assert model.joint_enabled.numpy().tolist() == [1, 0, 1]
    with pytest.raises(ValueError, match="a row for each of the 8 dofs, got 'joint_q_start'"):
        hinge.get(model, "joint_q_start")


def test_a_view_of_selected_rows_reads_and_writes_in_place():
    one = novaphy.ModelBuilder(gravity=0.0)
    links = [one.add_link(mass=1.0, inertia=np.eye(3), label=name) for name in "abc"]
    joints = [one.add_joint_revolute(-1, link, label=f"knee_{link}") for link in links]
    for joint in joints:
        one.add_articulation([joint], label="leg")
        one.add_actuator(joint, label=f"push_{joint}")
    every = novaphy.ModelBuilder(gravity=0.0)
    every.replicate(one, 3)
    model = every.finalize()
    state, control = model.state(), model.control()
    legs, push = model.select("*/knee_[02]"), model.select("push_[02]")
    q, force, poses = (legs.view(state, "joint_q"), push.view(control, "ctrl"),
                       model.select("[ac]").view(state, "body_q"))  # fmt: skip
    assert q.shape == force.shape == (3, 2) and poses.shape == (3, 2, 7) and len(q) == 3
    state.joint_q.assign(np.arange(9.0))  # after the view was made
    assert_array_equal(np.asarray(q), [[0, 2], [3, 5], [6, 8]])
    q[1] = -1.0
    q[:, 1] += 10.0
    assert state.joint_q.numpy().tolist() == [0, 1, 12, -1, 4, 9, 6, 7, 18]
    force[2, 0] = 5.0
    force[q[...] > 15.0] = 7.0
    assert control.ctrl.numpy().tolist() == [0, 0, 0, 0, 0, 0, 5, 0, 7]
    poses[..., 2] = [[1.0], [2.0], [3.0]]
    assert state.body_q.numpy()[:, 2].tolist() == [1, 0, 1, 2, 0, 2, 3, 0, 3]
    with pytest.raises(ValueError, match=r"values: expected the shape \(3, 2\), got \(3,\)"):
        q[...] = [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="copy=False"):
        np.array(q, copy=False)
    alone = model.select("knee_0", world=0).view(state, "joint_qd")
    alone[...] = 3.0
    assert state.joint_qd.numpy().tolist() == [3.0] + 8 * [0.0]


def test_a_tape_sees_what_a_view_of_selected_rows_writes():
    diff = pytest.importorskip("novaphy.diff")
    from novaphy import nova

    model = hinge([{"gain": (0, -3, 0), "ctrl_range": (0, 10), "label": "spring"}])
    state, after, control = model.state(), model.state(), model.control()
    control.ctrl.requires_grad = True
    state.joint_q.assign([0.5])
    solver = novaphy.solvers.DiffFeatherstoneSolver(model)
    with nova.Tape() as tape:
        solver.step(state, after, control, None, 0.1)
        loss = nova.sum(diff.state_joint_qd_tensor(after))
        model.select("spring").view(control, "ctrl")[...] = 9.0
        with pytest.raises(novaphy.Error, match="modified after recording"):
            tape.backward(loss)


def test_a_step_names_a_control_or_activation_that_is_not_finite():
    lag = {"dynamics": ActuatorDynamics.FILTER, "time": 0.1, "label": "lag"}
    model = hinge([{"label": "motor"}, lag])
    solver, state, control = (
        novaphy.solvers.SolverFeatherstone(model),
        model.state(),
        model.control(),
    )
    control.ctrl.assign([np.nan, 0.0])
    with pytest.raises(ValueError, match=r'control.ctrl\[0\] \("motor"\): .*got nan'):
        solver.step(state, state, control, None, DT)
    model.ctrl.assign([np.nan, 0.0])
    with pytest.raises(ValueError, match=r'model.ctrl\[0\] \("motor"\): .*got nan'):
        solver.step(model.state(), state, None, None, DT)
    model.ctrl.assign([0.0, 0.0])
    start = model.state()
    start.act.assign([np.nan])
    with pytest.raises(ValueError, match=r'state_in.act\[0\] \("lag"\): .*got nan'):
        solver.step(start, state, None, None, DT)
