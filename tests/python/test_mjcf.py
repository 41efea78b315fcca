"""Robots from MJCF files: against MuJoCo's numbers, and what is refused."""

from __future__ import annotations

import contextlib
import random
import re

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)
ANT = novaphy.assets.path("ant.xml")


def loaded(source: object, **options: object):
    builder = novaphy.ModelBuilder()
    result = builder.add_mjcf(source, **options)
    model = builder.finalize()
    return model, model.state(), result


def mjcf(inside: str, before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{inside}</worldbody>{after}</mujoco>"


def hinged(joint: str = "", geom: str = 'size="0.1"', body: str = "") -> str:
    return f"<body {body}><joint {joint}/><geom {geom}/></body>"


@pytest.mark.parametrize(("name", "factor"), [("ant.xml", 1.0), ("ant_heavy.xml", 200.0)])
def test_the_ant_has_its_masses_and_inertias(name, factor):
    model, _, result = loaded(novaphy.assets.path(name))
    assert model.body_count == 9 and model.joint_dof_count == 14 and model.joint_coord_count == 15
    mass, inertia = model.body_mass.numpy(), model.body_inertia.numpy()
    # Closed forms, overlaps counted twice; as MuJoCo's.
    bodies = {
        "torso": (0.483880, [2.22407, 2.22407, 2.71714], [0, 0, 0]),
        "front_left_leg": (0.0391578, [0.0236884, 0.1135932, 0.1135932], [0.1, 0.1, 0]),
        "back_right_foot": (0.0675922, [0.0418864, 0.5349581, 0.5349581], [0.2, -0.2, 0]),
    }
    for body, (kilograms, moments, com) in bodies.items():
        k = result.links[body]
        assert_allclose(mass[k], factor * kilograms, rtol=2e-5)
        got = np.linalg.eigvalsh(inertia[k].astype(float))
        assert_allclose(got, factor / 200 * np.array(moments), rtol=2e-5)
        assert_allclose(model.body_com.numpy()[k], com, atol=1e-6)
    assert_allclose(mass.sum(), factor * 0.910880, rtol=1e-5)


def test_the_ant_starts_within_its_ranges_and_has_its_motors():
    model, _, result = loaded(ANT)
    q = np.array(model.joint_q.numpy())
    assert_allclose(q, [0, 0, 0.75, 0, 0, 0, 1, 0, 1, 0, -1, 0, -1, 0, 1])
    hinges = [f"{n}_{k}" for k in (1, 2, 3, 4) for n in ("hip", "ankle")]
    assert [result.joint_dofs[n] for n in hinges] == list(range(6, 14))
    assert [result.joint_coords[n] for n in hinges] == list(range(7, 15))
    lower, upper = model.joint_limit_lower.numpy()[6:], model.joint_limit_upper.numpy()[6:]
    assert (lower <= q[7:]).all() and (q[7:] <= upper).all()
    assert_allclose(np.rad2deg(lower[:4]), [-30, 30, -30, -70], rtol=1e-6)
    assert model.actuator_label[:3] == ["hip_4", "ankle_4", "hip_1"]
    assert result.actuators["hip_1"] == 2
    assert model.actuator_dof.numpy().tolist() == [12, 13, 6, 7, 8, 9, 10, 11]
    assert (model.actuator_gear.numpy() == 150).all()
    assert (model.actuator_ctrl_range.numpy() == [-1, 1]).all()
    armature = model.joint_armature.numpy()
    assert armature[:6].tolist() == [0] * 6 and armature[6:].tolist() == [1] * 8
    # Only the floor meets the geoms.
    assert model.shape_contact_pair_count == model.shape_count - 1 == 13


def test_poses_of_the_start_are_those_of_forward_kinematics():
    for name in ("ant.xml", "humanoid.xml"):
        model, state, _ = loaded(novaphy.assets.path(name))
        start = state.body_q.numpy().copy()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        assert_allclose(state.body_q.numpy(), start, atol=2e-6, rtol=0)


@pytest.mark.parametrize("name", ["ant.xml", "ant_heavy.xml", "humanoid.xml"])
def test_mass_matrices_are_those_of_mujoco(name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    path = novaphy.assets.path(name)
    exact = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(exact)
    model, state, _ = loaded(path)
    hinges = model.joint_dof_count - 6
    draw = np.random.default_rng(0)
    for _ in range(5):
        angles = draw.uniform(-1, 1, hinges).astype(np.float32)
        q = np.float32([0.3, -0.2, 1.0, 0, 0, 0, 1, *angles])
        state.joint_q.assign(q)
        state.joint_qd.zero_()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        data.qpos[:] = [*q[:3], 1, 0, 0, 0, *angles]
        mujoco.mj_forward(exact, data)
        for body in range(model.body_count):
            k = mujoco.mj_name2id(exact, mujoco.mjtObj.mjOBJ_BODY, model.body_label[body])
            assert_allclose(state.body_q.numpy()[body, :3], data.xpos[k], atol=2e-6, rtol=0)
            assert_allclose(model.body_mass.numpy()[body], exact.body_mass[k], rtol=1e-5)
        h_exact = np.zeros((exact.nv, exact.nv))
        mujoco.mj_fullM(exact, data, h_exact)
        h = np.asarray(novaphy.eval_mass_matrix(model, state)).reshape(exact.nv, exact.nv)
        scale = np.abs(h_exact[6:, 6:]).max()
        assert_allclose(h[6:, 6:], h_exact[6:, 6:], atol=1e-5 * scale, rtol=0)


def pairs_of_mujoco(text: str) -> set[tuple[str, str]]:
    """The geoms that meet, by MuJoCo's own search with a margin that reaches all of them."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    exact = mujoco.MjModel.from_xml_string(text)
    exact.geom_margin[:] = 1e3
    data = mujoco.MjData(exact)
    mujoco.mj_forward(exact, data)
    names = [mujoco.mj_id2name(exact, mujoco.mjtObj.mjOBJ_GEOM, g) for g in range(exact.ngeom)]
    return {tuple(sorted(names[g] for g in pair)) for pair in data.contact.geom}


def pairs_of(text: str, **options: object) -> set[tuple[str, str]]:
    model, _, _ = loaded(text, **options)
    pairs = model.shape_contact_pairs.numpy()
    return {tuple(sorted(model.shape_label[s] for s in pair)) for pair in pairs}


def test_a_door_meets_its_frame_that_is_fixed_to_the_world():
    """In MuJoCo parent and child do not meet, unless the parent is a part of the world."""
    geom = '<geom name="{}" size="0.1"/>'.format
    door = f'<body pos="0 0 1"><joint type="slide"/>{geom("door")}</body>'
    frame = f"<body>{geom('frame')}<body>{geom('hinge')}{door}</body></body>"
    fixed = mjcf(geom("floor") + frame + f"<body>{geom('wall')}</body>")
    expected = {("door", "floor"), ("door", "frame"), ("door", "hinge"), ("door", "wall")}
    for collapse in (False, True):
        assert pairs_of(fixed, collapse_fixed_joints=collapse) == expected
    free = fixed.replace("<body><geom", '<body pos="0 0 1"><freejoint/><geom', 1)
    assert pairs_of(free) == {
        ("door", "floor"), ("door", "wall"), ("floor", "frame"), ("floor", "hinge"),
        ("frame", "wall"), ("hinge", "wall"),
    }  # fmt: skip
    assert pairs_of_mujoco(fixed) == expected and pairs_of_mujoco(free) == pairs_of(free)


def test_pairs_of_random_trees_are_those_of_mujoco():
    draw = random.Random(3)
    for _ in range(150):
        names = ["world"]

        def geoms(body: str, draw: random.Random = draw) -> str:
            text = ""
            for k in range(draw.randrange(3)):
                bits = draw.choice(["", 'contype="2"', 'conaffinity="0"', 'contype="0"'])
                text += f'<geom name="{body}{k}" size="0.1" mass="1" {bits}/>'
            return text

        def body(depth: int, draw: random.Random = draw, names: list[str] = names) -> str:
            name = f"b{len(names)}"
            names.append(name)
            joint = draw.choice(["", "", "<joint/>", '<joint type="slide"/>'])
            if depth == 0 and draw.random() < 0.3:
                joint = "<freejoint/>"
            below = "".join(body(depth + 1) for _ in range(draw.randrange(3)) if depth < 4)
            mass = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
            return f'<body name="{name}">{joint}{mass}{geoms(name)}{below}</body>'

        inside = geoms("world") + "".join(body(0) for _ in range(3))
        excluded = {tuple(sorted(draw.sample(names, 2))) for _ in range(2)}
        text = mjcf(
            inside,
            after="<contact>"
            + "".join(f'<exclude body1="{a}" body2="{b}"/>' for a, b in excluded)
            + "</contact>",
        )
        expected = pairs_of_mujoco(text)
        assert pairs_of(text) == expected
        assert pairs_of(text, collapse_fixed_joints=True) == expected


def test_defaults_and_classes():
    before = (
        '<compiler angle="radian"/><default><joint damping="3" axis="1 0 0"/>'
        '<default class="soft"><joint damping="1"/><geom density="10"/></default></default>'
    )
    text = mjcf(
        hinged('name="a"') + hinged('name="b" class="soft" range="-1 2"')
        + '<body childclass="soft"><joint name="c" damping="7"/>'
        '<geom type="box" size="0.5 0.5 0.5"/></body>',
        before,
    )  # fmt: skip
    model, _, result = loaded(text)
    rows = [result.joint_dofs[n] for n in "abc"]
    assert model.joint_damping.numpy()[rows].tolist() == [3, 1, 7]
    assert model.joint_limit_upper.numpy()[rows].tolist() == [1e10, 2, 1e10]
    assert model.joint_axis.numpy()[rows].tolist() == [[1, 0, 0]] * 3
    assert_allclose(model.body_mass.numpy()[2], 10)


def test_orientations_sizes_and_inertials():
    quarter = np.sqrt(0.5)
    for how in ('quat="1 0 0 1"', 'axisangle="0 0 2 90"', 'euler="0 0 90"',
                'xyaxes="0 1 0 -1 0 0"'):  # fmt: skip
        builder = novaphy.ModelBuilder()
        builder.add_mjcf(mjcf(hinged(body=how)))
        assert_allclose(builder.body_q[0][3:], [0, 0, quarter, quarter], atol=1e-6)
    geoms = {
        'type="capsule" size="0.1" fromto="0 0 0 0 0 2"': 1000 * np.pi * 0.01 * (2 + 0.4 / 3),
        'type="cylinder" size="0.1 1"': 1000 * np.pi * 0.01 * 2,
        'type="ellipsoid" size="0.1 0.2 0.3"': 1000 * 4 / 3 * np.pi * 0.006,
        'type="box" size="0.1 0.2 0.3" mass="5"': 5.0,
    }
    for geom, mass in geoms.items():
        assert_allclose(loaded(mjcf(hinged(geom=geom)))[0].body_mass.numpy()[0], mass, rtol=1e-6)
    inertial = '<inertial pos="1 2 3" mass="4" diaginertia="1 2 2.5"/>'
    model, _, _ = loaded(mjcf(f'<body>{inertial}<joint/><geom size="1"/></body>'))
    assert model.body_mass.numpy()[0] == 4 and model.body_com.numpy()[0].tolist() == [1, 2, 3]


def test_friction_has_as_many_directions_as_condim_says():
    # MuJoCo's documentation, XML reference, geom/condim.
    for condim, expected in {
        1: (0, 0, 0),
        3: (0.7, 0, 0),
        4: (0.7, 0.5, 0),
        6: (0.7, 0.5, 0.25),
    }.items():
        geom = f'size="0.1" friction="0.7 0.5 0.25" condim="{condim}"'
        model, _, _ = loaded(mjcf(hinged(geom=geom)))
        names = ("mu", "mu_torsional", "mu_rolling")
        got = [getattr(model, f"shape_material_{n}").numpy()[0] for n in names]
        assert_allclose(got, expected)


@pytest.mark.parametrize("size", ["0 0 1", "40 40 40", "0 3 1"])
def test_planes_end_only_in_pictures(size):
    ball = '<body pos="100 -70 0.3"><freejoint/><geom size="0.1"/></body>'
    model, state, _ = loaded(mjcf(f'<geom type="plane" size="{size}"/>{ball}'))
    assert model.shape_scale.numpy()[-1].tolist() == [0, 0, 0]
    assert_allclose(fallen(model, state, 240).body_q.numpy()[0, :3], [100, -70, 0.1], atol=2e-3)


@pytest.mark.parametrize("name", ["ant.xml", "ant_heavy.xml"])
def test_the_ant_drops_and_stands(name):
    model, state, _ = loaded(novaphy.assets.path(name))
    stands = fallen(model, state, 480)
    height = stands.body_q.numpy()[0, 2]
    assert 0.5 < height < 0.6  # its legs are at their limits, its feet on the floor
    assert np.abs(stands.joint_qd.numpy()).max() < 0.02
    # The robot stays there: its feet carry it, and friction holds it in place.
    later = fallen(model, stands, 240).body_q.numpy()[0, :3]
    assert_allclose(later, stands.body_q.numpy()[0, :3], atol=1e-3)


def fallen(model: novaphy.Model, state: novaphy.SimState, steps: int) -> novaphy.SimState:
    """The state after steps of 1/240 s with contact."""
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.05)
    pipeline = novaphy.CollisionPipeline(model)
    contacts, after = pipeline.contacts(), model.state()
    for _ in range(steps):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, 1 / 240)
        state, after = after, state
    return state


def test_options_place_a_robot_and_keep_its_shapes_apart():
    half = np.sqrt(0.5)
    _, state, result = loaded(ANT, xform=(1, 2, 3, 0, 0, half, half))
    torso = state.body_q.numpy()[result.links["torso"]]
    assert_allclose(torso, [1, 2, 3.75, 0, 0, half, half], atol=1e-6)
    foot = state.body_q.numpy()[result.links["front_left_leg"], :3]
    assert_allclose(foot, [0.8, 2.2, 3.75], atol=1e-6)  # (0.2, 0.2, 0) turned
    assert_allclose(state.joint_q.numpy()[:3], [1, 2, 3.75])
    robot = novaphy.assets.path("humanoid.xml")
    pairs = {on: loaded(robot, enable_self_collisions=on)[0] for on in (True, False)}
    body = pairs[True].shape_body.numpy()
    own = [p for p in pairs[True].shape_contact_pairs.numpy() if (body[p] >= 0).all()]
    left = pairs[False].shape_contact_pairs.numpy()
    assert len(own) > 50 and len(left) == pairs[True].shape_contact_pair_count - len(own)
    assert (body[left] < 0).any(axis=1).all()
    for bad, message in (((0,), "xform: expected 7 numbers"), ((0,) * 7, "xform.q: expected a q")):
        with pytest.raises(ValueError, match=message):
            novaphy.ModelBuilder().add_mjcf(ANT, xform=bad)


def test_stiffness_frames_and_merged_bodies():
    text = mjcf(
        '<body pos="0 0 1">'
        '<joint name="j" pos="0.5 0 0" stiffness="3" springref="90" axis="0 1 0"/>'
        '<geom size="0.1"/><body pos="0 0 2"><geom size="0.1"/></body></body>'
    )
    model, _, result = loaded(text)
    assert model.joint_target_ke.numpy()[0] == 3 and model.body_count == 2
    assert_allclose(model.joint_target_q.numpy()[0], np.pi / 2)
    assert_allclose(model.joint_X_p.numpy()[0, :3], [0.5, 0, 1])
    merged, _, result = loaded(text, collapse_fixed_joints=True)
    assert merged.body_count == 1 and result.joints["body_1_fixed"] == -1
    assert_allclose(merged.body_com.numpy()[0], [0, 0, 1])


BAD = {
    "root": ("<robot/>", "expected the root element <mujoco>"),
    "empty": ("<mujoco/>", "expected a body or a geom"),
    "include": ('<mujoco><include file="ant.xml"/></mujoco>', "needs package_dirs"),
    "section": ("<mujoco><world/></mujoco>", "<world>: this element is not read"),
    "doctype": ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "entities are not read"),
    "deep": (mjcf("<body>" * 100_000), "expected XML"),
    "many bodies": (mjcf(hinged() * 100_000), "expected at most 10000 bodies"),
    "laughs": ('<!DOCTYPE m [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
               '<mujoco model="&b;"/>', "entities are not read"),
    "global": (mjcf(hinged(), '<compiler coordinate="global"/>'), 'coordinate="global" is not'),
    "gravity": (mjcf(hinged(), '<option gravity="0 0"/>'), "gravity: expected 3 number"),
    "euler": (mjcf(hinged(), '<compiler eulerseq="xyw"/>'), "eulerseq: expected three of x"),
    "flag": (mjcf(hinged(), '<option><flag limit="off"/></option>'), "expected enable or disable"),
    "water": (mjcf(hinged(), '<option density="-1000"/>'), "density: expected >= 0"),
    "mesh": (mjcf(hinged(geom='type="mesh" mesh="m"')), 'there is no mesh "m"'),
    "mesh file": (mjcf(hinged(geom='type="mesh" mesh="m"'),
                       '<asset><mesh name="m" file="../../etc/m.obj"/></asset>'), "needs "
                                                                                  "package_d"),
    "vertices": (mjcf(hinged(geom='type="mesh" mesh="m"'),
                      '<asset><mesh name="m" vertex="0 0 0 1"/></asset>'), "3 numbers a vertex"),
    "faces": (mjcf(hinged(geom='type="mesh" mesh="m"'),
                   '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 4"/></asset>'),
              "face: expected numbers of vertices"),
    "copies": (mjcf('<replicate count="1e9">' + hinged() + "</replicate>"), "count: expected a"),
    "many copies": (mjcf('<replicate count="999999">' * 3 + "<site/>" + "</replicate>" * 3),
                    "expected at most 1000000 elements"),
    "size": (mjcf(hinged(geom='type="box" size="1 1"')), "size: expected 3 numbers of a box"),
    "no size": (mjcf(hinged(geom="")), "size: expected 1 numbers"),
    "negative": (mjcf(hinged(geom='size="-1"')), "size: expected numbers > 0"),
    "nan": (mjcf(hinged(geom='size="nan"')), "size: expected finite numbers"),
    "friction": (mjcf(hinged(geom='size="1" friction="-1"')), "friction: expected numbers >= 0"),
    "fluid": (mjcf(hinged(geom='size="1" wings="2"')), "the attribute wings is not read"),
    "joint type": (mjcf(hinged('type="screw"')), 'got "screw"'),
    "orientations": (mjcf('<body zaxis="1 0 0" euler="0 0 9"><geom size="1"/></body>'),
                     "expected one orientation"),
    "axis": (mjcf(hinged('axis="0 0 0"')), "axis: expected a vector"),
    "range": (mjcf(hinged('range="2 1"')), "range: expected two numbers, the lower one first"),
    "limited": (mjcf(hinged('limited="true"')), "range: expected two numbers"),
    "armature": (mjcf(hinged('armature="-1"')), "armature: expected >= 0"),
    "names": (mjcf(hinged('name="a"') * 2), 'different names, got "a" twice'),
    "class": (mjcf(hinged('class="x"')), 'there is no default class "x"'),
    "below": (mjcf('<body><geom size="1"/><body><freejoint/><geom size="1"/></body></body>'),
              "a free joint of a body in the world"),
    "massless": (mjcf(hinged(geom='size="1" density="0"')), "expected a mass"),
    "inertia": (mjcf('<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 -1"/><joint/></body>'),
                "positive definite"),
    "muscle": (mjcf(hinged('name="a"'), after='<actuator><muscle joint="a"/></actuator>'),
               "an actuator of the kind <muscle>"),
    "early": (mjcf(hinged('name="a"'), after='<actuator><position joint="a" timeconst="1" '
                   'actearly="true"/></actuator>'), "an actuator with actearly"),
    "gear": (mjcf(hinged('name="a" stiffness="1"'), after='<actuator><position joint="a" '
                  'forcerange="-1 1"/></actuator>'), "forcerange: the drive of the joint has "
                                                     "other"),
    "motor": (mjcf(hinged(), after='<actuator><motor joint="a"/></actuator>'),
              'there is no joint "a"'),
    "mocap": (mjcf(hinged(body='mocap="true"')), "mocap: expected a body in the world without j"),
    "attach": (mjcf('<body><attach model="m"/></body>'), '<attach>: there is no model "m"'),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_and_the_builder_stays(name):
    text, message = BAD[name]
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(mjcf(hinged()))
    with pytest.raises((ValueError, NotImplementedError), match=re.compile(message, re.S)):
        builder.add_mjcf(text)
    assert (builder.body_count, builder.shape_count, builder.joint_count) == (1, 1, 1)


# Described, and refused when the model is made.
LATER = {
    "tendon": (
        mjcf(
            hinged('name="j"'),
            after='<tendon><fixed stiffness="1"><joint joint="j" coef="1"/></fixed></tendon>',
        ),
        "<fixed>: a tendon that has forces",
    ),
    "equality": (
        mjcf(hinged('name="j"'), after='<equality><joint joint1="j"/></equality>'),
        "<joint>: an equality of the kind joint",
    ),
    "field": (mjcf(hinged() + '<geom type="hfield" hfield="h"/>'), "<geom>: a height field"),
}


@pytest.mark.parametrize("name", LATER)
def test_parts_without_a_solver_are_refused_by_finalize(name):
    text, message = LATER[name]
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(text)
    with pytest.raises(NotImplementedError, match="finalize: <text>:.*" + message):
        builder.finalize()


@pytest.mark.parametrize("source", [None, 3, b"<mujoco/>"])
def test_a_source_that_is_no_text_is_named(source):
    builder = novaphy.ModelBuilder()
    for add in (builder.add_mjcf, builder.add_urdf):
        message = f"{add.__name__}: source: expected a path .* got {type(source).__name__}"
        with pytest.raises(TypeError, match=message):
            add(source)
    for folders, got in (("folder", "str"), (3, "int"), ([3], "int")):
        with pytest.raises(TypeError, match=rf"add_urdf: package_dirs.*: expected a .* got {got}"):
            builder.add_urdf("<robot/>", package_dirs=folders)


def test_what_belongs_to_the_simulation_is_said():
    with pytest.warns(UserWarning, match="not of the file: integrator"):
        loaded(mjcf(hinged(), '<option timestep="0.01" integrator="RK4"/>'))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_mutated_files_are_read_or_refused():
    from test_urdf import mutated

    draw = random.Random(2)
    base = re.sub(r"<!--.*?-->", "", ANT.read_text("utf-8"), flags=re.S)
    read = 0
    for _ in range(1000):
        builder = novaphy.ModelBuilder()
        try:
            builder.add_mjcf(mutated(draw, base))
        except (ValueError, NotImplementedError, OSError):
            assert builder.body_count == builder.shape_count == builder.joint_count == 0
            continue
        read += 1
        with contextlib.suppress(ValueError):
            builder.finalize()
    assert 10 < read < 900
