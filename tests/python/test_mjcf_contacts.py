"""Materials of contacts of MJCF files: friction, priority, softness and margins as in MuJoCo."""

from __future__ import annotations

import math

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")

BOX = 'type="box" size=".1 .1 .05"'
BALL = 'type="sphere" size=".1"'


def scene(floor="", geom=BOX, height=0.05, slope=0.0, gravity=9.81, joint="<freejoint/>"):
    """What lies on a plane, whose slope is that of gravity."""
    down = f"{gravity * math.sin(slope):.9g} 0 {-gravity * math.cos(slope):.9g}"
    return (
        f'<mujoco><option timestep="0.001" gravity="{down}"/><worldbody>'
        f'<geom type="plane" size="5 5 1" {floor}/>'
        f'<body pos="0 0 {height}">{joint}<geom {geom}/></body></worldbody></mujoco>'
    )


def run(text, steps, dt=1e-3, speed=0.0, **options):
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(text)
    model = builder.finalize()
    state, pipeline = model.state(), novaphy.CollisionPipeline(model)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = pipeline.contacts()
    solver = novaphy.solvers.SolverFeatherstone(model, **options)
    for _ in range(steps):
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, dt)
    return state.joint_q.numpy()


# Coefficients and priorities of the plane and the box, and the one that counts. `slides`: where
# MuJoCo 4.0 has the box after 1 s at 1.05 times the angle of friction (elliptic cone, impratio 10).
SLOPES = {
    "the larger one, of the box": (("0.3", 0), ("0.6", 0), 0.6, 0.15472),
    "the larger one, of the plane": (("0.6", 0), ("0.3", 0), 0.6, 0.15472),
    "the plane decides": (("0.3", 1), ("0.6", 0), 0.3, 0.07471),
    "the box decides": (("0.6", -2), ("0.3", -1), 0.3, 0.07471),
}


@pytest.mark.parametrize("name", SLOPES)
def test_a_box_on_a_slope_slides_and_holds_as_in_mujoco(name):
    floor, box, mu, slides = SLOPES[name]
    surfaces = [f'friction="{f}" priority="{p}"' for f, p in (floor, box)]
    angle = math.atan(mu)
    for factor in (0.95, 1.05):
        at = run(scene(surfaces[0], f"{BOX} {surfaces[1]}", slope=factor * angle), 200, 0.005)
        if factor < 1.0:
            assert abs(at[0]) < 1e-5  # in MuJoCo it creeps by 0.1 mm to 0.2 mm
        else:
            pull = math.sin(factor * angle) - mu * math.cos(factor * angle)
            assert at[0] == pytest.approx(0.5 * 9.81 * pull, rel=0.01)
            assert at[0] == pytest.approx(slides, rel=0.01)


def material(floor, geom):
    """Of a ball on the plane, in one step: the change of its speed is that of its friction."""
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(scene(floor, f"{BALL} {geom}", 0.0999))
    return sliding(builder)


def sliding(builder):
    builder.joint_qd[0] = 2.0
    model = builder.finalize()
    state, after, pipeline = model.state(), model.state(), novaphy.CollisionPipeline(model)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    novaphy.solvers.SolverFeatherstone(model, pgs_slop=1e-3).step(
        state, after, None, contacts, 1e-3
    )
    return (2.0 - after.joint_qd.numpy()[0]) / 9.81e-3


def test_condim_of_a_pair_is_the_larger_one():
    # MuJoCo documentation, contact parameters. The friction of a frictionless geom counts then.
    smooth, rough = 'friction="0.5" condim="1"', 'friction="0.2" condim="3"'
    assert material(smooth, smooth) == 0.0
    assert material(smooth, rough) == pytest.approx(0.5, rel=1e-3)
    assert material(rough, smooth) == pytest.approx(0.5, rel=1e-3)
    assert material(smooth + ' priority="1"', rough) == 0.0
    assert material(smooth, rough + ' priority="1"') == pytest.approx(0.2, rel=1e-3)


def test_shapes_that_are_not_of_a_file_keep_the_mean():
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.3))
    ball = f'<body pos="0 0 .0999"><freejoint/><geom {BALL} friction="0.8"/></body>'
    builder.add_mjcf(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    assert sliding(builder) == pytest.approx(0.55, rel=1e-3)
    mixing = builder.finalize().shape_mixing.numpy()
    assert mixing[0].tolist() == [0, 0, 0, 0] and mixing[1, 1] == 1.0
    builder = novaphy.ModelBuilder()
    asks = novaphy.ShapeConfig(mu=0.3, mixing=(0, 1, 0, 0))
    assert asks.mixing == (0, 1, 0, 0)
    builder.add_ground_plane(cfg=asks)
    body = builder.add_body(xform=(0, 0, 0.0999, 0, 0, 0, 1))
    builder.add_shape_sphere(body, radius=0.1, cfg=novaphy.ShapeConfig(mu=0.8, mixing=(0, 1, 1, 0)))
    assert sliding(builder) == pytest.approx(0.8, rel=1e-3)
    with pytest.raises(ValueError, match="cfg.mixing weight"):
        builder.add_shape_sphere(-1, cfg=novaphy.ShapeConfig(mixing=(0, -1, 0, 0)))


# The settings of the contact of a ball.
SOFT = {
    "default": "",
    "soft": 'solref="0.05 1"',
    "dampratio": 'solref="0.03 1.5"',
    "stiffness": 'solref="-3000 -150"',
    "impedance": 'solimp="0.5 0.8 0.01 0.3 3"',
    "constant impedance": 'solimp="0.7 0.7 0.001 0.5 1"',
}


@pytest.mark.parametrize("name", SOFT)
def test_springs_of_contacts_are_as_soft_as_those_of_mujoco(name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")

    def heights(text, steps):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, steps)
        here = run(text, steps, compliant_contacts=True, max_depenetration_velocity=10.0)
        return data.qpos[2], here[2]

    soft = f"{BALL} {SOFT[name]}"
    exact, here = heights(scene(SOFT[name], soft, 0.1), 1500)
    assert 0.1 - exact > 1e-5 and 0.1 - here == pytest.approx(0.1 - exact, rel=0.02)
    # An overlap of 2 mm shrinks to the same part after 15 ms in both engines, within 25 %.
    exact, here = heights(scene(SOFT[name], soft, 0.098, gravity=0.0), 15)
    assert here == pytest.approx(exact, abs=5e-4)


# With one impedance at all depths, the springs are those of MuJoCo. Otherwise the springs are
# softer or harder if a contact carries less than its mass, as a corner of a box does.
BOXES = {
    "one impedance": ('solimp="0.9 0.9 0.001 0.5 2"', 1e-3),
    "of the plane": ('priority="1" solimp="0.8 0.8 1 0.5 2" solref="0.05 1"', 1e-3),
    "default": ("", 0.2),
}


@pytest.mark.parametrize("name", BOXES)
def test_a_box_lies_as_deep_as_in_mujoco(name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    floor, tolerance = BOXES[name]
    own = floor if "priority" not in floor else ""
    text = scene(floor, f"{BOX} {own}")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1500)
    here = run(text, 300, 0.005, compliant_contacts=True)[2]
    assert 0.05 - here == pytest.approx(0.05 - data.qpos[2], rel=tolerance)


@pytest.mark.parametrize("name", ["humanoid.xml", "ant.xml"])
def test_inverse_masses_are_those_of_mujoco(name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(novaphy.assets.path(name))
    model = builder.finalize()
    exact = mujoco.MjModel.from_xml_path(str(novaphy.assets.path(name)))
    of_body = {exact.body(b).name: exact.body_invweight0[b, 0] for b in range(exact.nbody)}
    owners = [model.body_label[b] if b >= 0 else "world" for b in model.shape_body.numpy()]
    expected = np.array([of_body.get(owner, np.nan) for owner in owners])
    known = np.isfinite(expected)
    assert known.sum() > 3
    np.testing.assert_allclose(model.shape_mixing.numpy()[known, 2], expected[known], rtol=1e-5)


def test_margins_move_the_surfaces():
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    text = scene('margin="0.01"', f'{BOX} margin="0.02"', 0.1)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    assert data.qpos[2] == pytest.approx(0.08, abs=2e-4)
    assert run(text, 200, 0.005)[2] == pytest.approx(0.08, abs=1e-4)


# The parts of the ball and the plane.
PARTS = {
    "mu of the larger": ('friction="0.2"', 'friction="0.5"', {}, "mu", (1, 0)),
    "mu of the higher": ('friction="0.2" priority="3"', 'friction="0.5"', {}, "mu", (0, 1)),
    "mu of both": ('friction="0.5"', 'friction="0.5"', {}, "mu", (0.5, 0.5)),
    "ke by weight": ("", 'solmix="3"', {"compliant_contacts": True}, "ke", (0.75, 0.25)),
    "kd of the higher": ("", 'priority="1"', {"compliant_contacts": True}, "kd", (1, 0)),
}


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
@pytest.mark.parametrize("name", PARTS)
def test_gradients_go_to_the_shape_that_counts(name):
    """Adjoint, tangent and differences of the speed of a sliding ball."""
    from novaphy import nova
    from novaphy.diff import state_joint_qd_tensor

    floor, geom, options, which, parts = PARTS[name]
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(scene(floor, f"{BALL} {geom}", 0.0995))
    builder.joint_qd[0:3] = [2.0, 0.5, -0.3]
    model = builder.finalize()
    array = getattr(model, f"shape_material_{which}")
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=500, **options, contact_gradient="code"
    )
    state, pipeline = model.state(), novaphy.CollisionPipeline(model)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    weights = np.random.default_rng(1).normal(size=6).astype(np.float32)

    def value(change):
        before = array.numpy().copy()
        array.assign((before + change).astype(np.float32))
        after = model.state()
        solver.step(state, after, None, contacts, 0.005)
        array.assign(before)
        return float(after.joint_qd.numpy().astype(float) @ weights)

    array.requires_grad = True
    after = model.state()
    with nova.Tape() as tape:
        solver.step(state, after, None, contacts, 0.005)
        loss = nova.sum(state_joint_qd_tensor(after) * nova.tensor(weights))
    tape.backward(loss)
    assert solver.gradient_info()["label"] in ("frozen", "exact of the code")
    got = array.grad.numpy()
    array.requires_grad = False
    size = 0.02 * float(array.numpy().mean())
    together = (value(size) - value(-size)) / (2 * size)
    assert abs(together) > 1e-9
    np.testing.assert_allclose(
        got, together * np.array(parts), rtol=5e-3, atol=1e-3 * abs(together)
    )
    if 0.5 not in parts:  # with equal weights the derivative with respect to one of them jumps
        for k in range(2):
            one = np.eye(2)[k] * size
            assert (value(one) - value(-one)) / (2 * size) == pytest.approx(
                got[k], rel=5e-3, abs=1e-3 * abs(together)
            )


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
def test_a_tape_notices_that_the_mixing_was_written():
    from novaphy import nova
    from novaphy.diff import state_joint_qd_tensor

    builder = novaphy.ModelBuilder()
    builder.add_mjcf(scene("", BALL, 0.0995))
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    state, after, pipeline = model.state(), model.state(), novaphy.CollisionPipeline(model)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    with nova.Tape() as tape:
        solver.step(state, after, None, contacts, 0.001)
        loss = nova.sum(state_joint_qd_tensor(after))
    model.shape_mixing.fill_(0.0)
    with pytest.raises(novaphy.Error, match="modified after recording"):
        tape.backward(loss)
    model.shape_mixing.requires_grad = True
    with pytest.raises(NotImplementedError, match="shape_mixing"), nova.Tape():
        solver.step(state, after, None, contacts, 0.001)
