"""Forces of a fluid on articulations: closed forms, MuJoCo's qfrc_fluid, gradients, files."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

SIDES = np.array([0.3, 0.2, 0.5])
MASS = 2.0
COM = np.array([0.1, 0.0, -0.2])
needs_io = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")


def builder_of_block(gravity=0.0, turn=None, **fluid) -> novaphy.ModelBuilder:
    """A free box of uniform density in a fluid; `turn` is the rotation of the box in its body."""
    axes = np.eye(3) if turn is None else turn
    inertia = axes @ np.diag(MASS / 12 * ((SIDES**2).sum() - SIDES**2)) @ axes.T
    builder = novaphy.ModelBuilder(gravity=gravity)
    builder.set_fluid(**fluid)
    builder.add_body(mass=MASS, inertia=inertia, com=COM)
    return builder


def block(**options) -> novaphy.Model:
    return builder_of_block(**options).finalize()


def run(model, rates, steps, dt) -> np.ndarray:
    """The velocities of the centers of mass and the angular velocities {bodies, 6}."""
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    state.joint_qd.assign(np.float32(rates))
    for _ in range(steps):
        solver.step(state, after, None, None, dt)
        state, after = after, state
    return state.body_qd.numpy()


def test_a_block_falls_at_the_speed_where_its_drag_is_its_weight():
    density = 80.0
    model = block(gravity=-9.81, density=density)
    assert_allclose(model.body_fluid_box.numpy(), [SIDES], rtol=1e-6)
    speed = np.sqrt(2 * MASS * 9.81 / (density * SIDES[0] * SIDES[1]))
    got = run(model, np.zeros(6), 2000, 1e-3)[0]
    assert_allclose(got, [0, 0, -speed, 0, 0, 0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("axis", range(3))
def test_a_viscous_fluid_stops_a_block_exponentially(axis):
    viscosity, dt, steps = 0.7, 1e-3, 300
    model, unit = block(viscosity=viscosity), np.eye(3)[axis]
    inertia = MASS / 12 * ((SIDES**2).sum() - SIDES[axis] ** 2)
    turning = (1 - dt * np.pi * SIDES.mean() ** 3 * viscosity / inertia) ** steps
    moving = (1 - dt * 3 * np.pi * SIDES.mean() * viscosity / MASS) ** steps
    for rates, left in (([0, 0, 0, *unit], turning), ([*unit, 0, 0, 0], moving)):
        got = run(model, rates, steps, dt)[0]
        assert_allclose(got, left * np.array(rates), rtol=1e-4, atol=1e-6)


def test_a_spinning_block_slows_by_the_square_of_its_rate():
    density, dt, rate = 60.0, 1e-3, 5.0
    got = run(block(density=density), [0, 0, 0, 0, 0, rate], 1, dt)[0]
    moment = density / 64 * SIDES[2] * (SIDES[0] ** 4 + SIDES[1] ** 4) * rate**2
    inertia = MASS / 12 * (SIDES[0] ** 2 + SIDES[1] ** 2)
    assert_allclose(rate - got[5], dt * moment / inertia, rtol=1e-3)
    assert_allclose(got[:5], 0, atol=1e-6)


def test_only_the_velocity_relative_to_the_wind_counts():
    wind = np.array([0.5, -2.0, 1.0])
    fluid = {"density": 90.0, "viscosity": 0.4}
    still = block(**fluid, wind=wind)
    assert_allclose(run(still, [*wind, 0, 0, 0], 5, 1e-2)[0, :3], wind, rtol=1e-6)
    carried = run(still, np.zeros(6), 5, 1e-2)[0, :3]
    driven = run(block(**fluid), [*-wind, 0, 0, 0], 5, 1e-2)[0, :3]
    assert_allclose(carried - wind, driven, atol=1e-6)


def test_the_box_has_the_principal_axes_of_the_inertia():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    model = block(turn=turn, density=50.0)
    x, y, z, w = model.body_fluid_frame.numpy()[0]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    frame = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    order = np.argsort(model.body_fluid_box.numpy()[0])
    assert_allclose(model.body_fluid_box.numpy()[0][order], np.sort(SIDES), rtol=1e-5)
    alike = np.abs(frame[:, order].T @ turn[:, np.argsort(SIDES)])
    assert_allclose(alike, np.eye(3), atol=1e-5)
    rates = np.random.default_rng(1).normal(size=3)
    turned = run(model, [*(turn @ rates), 0, 0, 0], 1, 1e-2)[0, :3]
    straight = run(block(density=50.0), [*rates, 0, 0, 0], 1, 1e-2)[0, :3]
    assert_allclose(turn.T @ turned, straight, rtol=1e-5)


def test_worlds_have_fluids_of_their_own():
    every = novaphy.ModelBuilder(gravity=0.0)
    fluids = ({"density": 90.0}, {}, {"viscosity": 0.4, "wind": (1, 0, 0)})
    for fluid in fluids:
        every.add_world(builder_of_block(**fluid))
    model, rates = every.finalize(), [0.5, -1.0, 2.0, 3.0, 1.0, -2.0]
    assert model.fluid_density.numpy().tolist() == [90, 0, 0]
    assert model.fluid_wind.numpy()[:, 0].tolist() == [0, 0, 1]
    got = run(model, np.tile(rates, 3), 3, 1e-2)
    for world, fluid in enumerate(fluids):
        assert (got[world] == run(block(**fluid), rates, 3, 1e-2)[0]).all()


def test_a_fluid_that_a_model_gets_later_acts():
    model = block()
    before = run(model, [1, 0, 0, 0, 0, 0], 1, 1e-2)
    assert before[0, 0] == 1.0
    model.fluid_density.fill_(70.0)
    expected = run(block(density=70.0), [1, 0, 0, 0, 0, 0], 1, 1e-2)
    assert (run(model, [1, 0, 0, 0, 0, 0], 1, 1e-2) == expected).all()


def test_links_without_a_mass_feel_no_fluid():
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.set_fluid(density=100.0, viscosity=1.0)
    links = [builder.add_link(), builder.add_link(mass=1.0, inertia=np.eye(3))]
    joints = [
        builder.add_joint_revolute(-1, links[0], axis=(0, 0, 1)),
        builder.add_joint_revolute(links[0], links[1], axis=(0, 1, 0)),
    ]
    builder.add_articulation(joints)
    model = builder.finalize()
    assert model.body_fluid_box.numpy()[0].tolist() == [0, 0, 0]
    assert np.isfinite(run(model, [1, 1], 2, 1e-2)).all()


def test_bad_fluids_and_solvers_without_one_are_refused_by_name():
    for fluid, message in (
        ({"density": -1.0}, "fluid.density: expected .*>= 0, got -1"),
        ({"viscosity": np.nan}, "fluid.viscosity: expected a finite"),
        ({"wind": (np.inf, 0, 0)}, "fluid.wind: expected finite"),
    ):
        builder = builder_of_block(**fluid)
        for refused in (builder.finalize, builder.begin_world):
            with pytest.raises(ValueError, match=message):
                refused()
    model = block()
    for name in ("fluid_density", "fluid_viscosity"):
        getattr(model, name).fill_(0.5)
        other = novaphy.solvers.SolverSemiImplicit(model)
        with pytest.raises((ValueError, NotImplementedError), match=name):
            other.step(model.state(), model.state(), None, None, 1e-3)
        getattr(model, name).fill_(-0.5)
        with pytest.raises(ValueError, match=rf"{name}\[0\]: expected .*>= 0"):
            run(model, np.zeros(6), 1, 1e-3)
        getattr(model, name).fill_(0.0)
    every = novaphy.ModelBuilder()
    every.add_body(mass=1.0, inertia=np.eye(3))
    every.add_world(builder_of_block(gravity=-9.81, density=1.0))
    with pytest.raises(ValueError, match="same fluid of the builder and of the last world"):
        every.finalize()


FISH = """<mujoco><option gravity="0 0 0" density="{}" viscosity="{}" wind="{}"><flag
contact="disable"/></option><worldbody>
<body name="base" pos="0 .1 1"><freejoint name="root"/>
<geom type="capsule" size=".05" fromto="0 0 0 .3 .1 0"/>
<body name="left" pos=".3 .1 0" euler="0 30 0"><joint name="lift" axis="0 1 1"/>
<joint name="slide" type="slide" axis="1 0 .2"/><geom type="box" size=".1 .04 .03" pos=".1 0 0"/>
<geom type="sphere" size=".05" pos="0 .1 .1"/>
<body name="tip" pos=".2 0 .1"><joint name="wrist" type="ball"/>
<inertial mass=".4" pos=".05 0 .02" diaginertia=".002 .002 .0008" euler="10 20 30"/>
</body></body>
<body name="right" pos="-.1 .2 0"><joint name="swing" axis="1 0 0"/>
<geom type="ellipsoid" size=".1 .04 .03" pos="0 .1 0" euler="40 -20 70"/>
</body></body></worldbody></mujoco>"""
FLUIDS = {
    "water": (1000, 0, "0 0 0"),
    "oil": (0, 5, "0 0 0"),
    "flow": (900, 3, "1 -2 .5"),
}


@needs_io
@pytest.mark.parametrize("name", FLUIDS)
def test_forces_at_random_states_are_those_of_mujoco(name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    text, dt = FISH.format(*FLUIDS[name]), 0.125
    exact = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(exact)
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(text)
    assert not robot.report.left_out
    model = builder.finalize()
    draw = np.random.default_rng(7)
    for _ in range(10):
        data.qpos[:] = np.float32(draw.normal(size=exact.nq))
        data.qvel[:] = draw.normal(size=exact.nv)
        q, change = data.qpos.copy(), np.eye(exact.nv)
        for at, dof in ((3, 3), (9, 8)):
            data.qpos[at : at + 4] /= np.linalg.norm(data.qpos[at : at + 4])
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, data.qpos[at : at + 4])
            change[dof : dof + 3, dof : dof + 3] = turn.reshape(3, 3)
            q[at : at + 4] = np.roll(data.qpos[at : at + 4], -1)
        x, y, z = change[3:6, 3:6] @ model.body_com.numpy()[robot.links["base"]]
        change[:3, 3:6] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ change[3:6, 3:6]
        mujoco.mj_forward(exact, data)
        rates = []
        for acts in (True, False):
            model.fluid_density.fill_(exact.opt.density * acts)
            model.fluid_viscosity.fill_(exact.opt.viscosity * acts)
            state, after = model.state(), model.state()
            state.joint_q.assign(np.float32(q))
            state.joint_qd.assign(np.float32(change @ data.qvel))
            novaphy.solvers.SolverFeatherstone(model).step(state, after, None, None, dt)
            rates.append(after.joint_qd.numpy().astype(float))
        found = np.zeros(exact.nv)
        moved = np.linalg.solve(change, rates[0] - rates[1]) / dt
        mujoco.mj_mulM(exact, data, found, moved)
        assert np.abs(found - data.qfrc_fluid).max() < 1e-5 * np.abs(data.qfrc_fluid).max()


@needs_io
def test_files_set_the_fluid_of_an_empty_builder():
    builder = novaphy.ModelBuilder()
    report = builder.add_mjcf(FISH.format(*FLUIDS["flow"])).report
    assert not report.left_out
    model = builder.finalize()
    assert model.fluid_density.numpy() == [900] and model.fluid_viscosity.numpy() == [3]
    assert model.fluid_wind.numpy().tolist() == [[1, -2, 0.5]]
    report = builder.add_mjcf(FISH.format(*FLUIDS["oil"]).replace('name="', 'name="b')).report
    kept = "density, viscosity, wind: that of the builder stays"
    assert any(kept in note.text for note in report.ignored)
    assert builder.finalize().fluid_density.numpy() == [900]
    with pytest.raises(ValueError, match="density: expected >= 0"):
        novaphy.ModelBuilder().add_mjcf(FISH.format(-1, 0, "0 0 0"))
    box, ellipsoid = 'type="box"', 'type="box" fluidshape="ellipsoid"'
    shaped = FISH.format(*FLUIDS["water"]).replace(box, ellipsoid)
    with pytest.raises(NotImplementedError, match="fluidshape"):
        novaphy.ModelBuilder().add_mjcf(shaped)
    left = novaphy.ModelBuilder().add_mjcf(shaped, unsupported="warn").report.left_out
    assert len(left) == 1 and "fluidshape" in left[0].text
    dry = FISH.format(0, 0, "0 0 0").replace(box, ellipsoid)
    assert not novaphy.ModelBuilder().add_mjcf(dry).report.left_out
